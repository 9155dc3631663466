"""The public names of `zenostat.agent_sdk.ray`."""

from zenostat.agent_sdk.ray import *  # noqa: F403
from zenostat.agent_sdk.ray import __all__ as __all__
