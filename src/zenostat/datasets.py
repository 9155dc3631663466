"""The public names of `zenostat.lab.datasets`."""

from zenostat.lab.datasets import *  # noqa: F403
from zenostat.lab.datasets import __all__ as __all__
