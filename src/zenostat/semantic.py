"""The public names of `zenostat.agent_sdk.semantic`."""

from zenostat.agent_sdk.semantic import *  # noqa: F403
from zenostat.agent_sdk.semantic import __all__ as __all__
