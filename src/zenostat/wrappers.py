"""The public names of `zenostat.agent_sdk.wrappers`."""

from zenostat.agent_sdk.wrappers import *  # noqa: F403
from zenostat.agent_sdk.wrappers import __all__ as __all__
