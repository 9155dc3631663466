"""The public names of `zenostat.agent_sdk.recording`."""

from zenostat.agent_sdk.recording import *  # noqa: F403
from zenostat.agent_sdk.recording import __all__ as __all__
