"""The public names of `zenostat.views.report`."""

from zenostat.views.report import *  # noqa: F403
from zenostat.views.report import __all__ as __all__
