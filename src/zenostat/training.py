"""The public names of `zenostat.agent_sdk.training`."""

from zenostat.agent_sdk.training import *  # noqa: F403
from zenostat.agent_sdk.training import __all__ as __all__
