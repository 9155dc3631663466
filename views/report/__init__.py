"""Reports: one HTML file with results and figures, and the figures as files for papers."""

from zenostat.views.report.files import check_figures_folder, check_report_file, write_figures, write_report
from zenostat.views.report.recordings import compare_recordings
from zenostat.views.report.runs import Comparison, Run

__all__ = [
    "Comparison",
    "Run",
    "check_figures_folder",
    "check_report_file",
    "compare_recordings",
    "write_figures",
    "write_report",
]
