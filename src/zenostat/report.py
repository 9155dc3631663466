"""The public names of `zenostat.agent_sdk.report`."""

from zenostat.agent_sdk.report import *  # noqa: F403
from zenostat.agent_sdk.report import __all__ as __all__
