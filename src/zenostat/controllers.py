"""The public names of `zenostat.agent_sdk.controllers`."""

from zenostat.agent_sdk.controllers import *  # noqa: F403
from zenostat.agent_sdk.controllers import __all__ as __all__
