"""The public names of `zenostat.agent_sdk.testing`."""

from zenostat.agent_sdk.testing import *  # noqa: F403
from zenostat.agent_sdk.testing import __all__ as __all__
