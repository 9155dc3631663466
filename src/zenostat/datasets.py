"""The public names of `zenostat.agent_sdk.datasets`."""

from zenostat.agent_sdk.datasets import *  # noqa: F403
from zenostat.agent_sdk.datasets import __all__ as __all__
