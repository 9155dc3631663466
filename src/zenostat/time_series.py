"""The public names of `zenostat.agent_sdk.time_series`."""

from zenostat.agent_sdk.time_series import *  # noqa: F403
from zenostat.agent_sdk.time_series import __all__ as __all__
