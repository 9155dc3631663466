"""The public names of `zenostat.lab.benchmark`."""

from zenostat.lab.benchmark import *  # noqa: F403
from zenostat.lab.benchmark import __all__ as __all__
