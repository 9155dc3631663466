"""The public names of `zenostat.lab.training`."""

from zenostat.lab.training import *  # noqa: F403
from zenostat.lab.training import __all__ as __all__
