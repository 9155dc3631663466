"""The public names of `zenostat.agent_sdk.benchmark`."""

from zenostat.agent_sdk.benchmark import *  # noqa: F403
from zenostat.agent_sdk.benchmark import __all__ as __all__
