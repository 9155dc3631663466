"""The public names of `zenostat.agent_sdk.evaluation`."""

from zenostat.agent_sdk.evaluation import *  # noqa: F403
from zenostat.agent_sdk.evaluation import __all__ as __all__
