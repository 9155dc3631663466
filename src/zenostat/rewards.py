"""The public names of `zenostat.agent_sdk.rewards`."""

from zenostat.agent_sdk.rewards import *  # noqa: F403
from zenostat.agent_sdk.rewards import __all__ as __all__
