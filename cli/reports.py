"""Options `--report` and `--figures`, shared by the commands that run episodes."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from zenostat.cli.console import out
from zenostat.topics.printable import replace_controls_in_lines

if TYPE_CHECKING:
    from zenostat.views.report import Comparison

REPORT_HELP = "Write a report with figures to FILE.html, one file that loads nothing else."
FIGURES_HELP = "Write the figures of the report to a folder as PNG, SVG and CSV."


@dataclass(frozen=True)
class ReportOutputs:
    """Files to which a report and its figures are written; checked before anything is simulated.

    Attributes:
        report, figures: the paths; None if not asked for.
        option: of the report, for errors.

    Raises:
        InvalidConfig: nothing can be written there, or Matplotlib is missing.
    """

    report: Path | None
    figures: Path | None
    option: str = "--report"

    def __post_init__(self) -> None:
        if self.wanted:
            from zenostat.views.report import check_figures_folder, check_report_file

            if self.report is not None:
                check_report_file(self.report, self.option)
            if self.figures is not None:
                check_figures_folder(self.figures, "--figures")

    @property
    def wanted(self) -> bool:
        """Whether any output is asked for."""
        return self.report is not None or self.figures is not None

    def write(self, comparison: Comparison) -> None:
        """Write what is asked for."""
        from zenostat.views.report import write_figures, write_report

        if self.report is not None:
            write_report(comparison, self.report)
        if self.figures is not None:
            write_figures(comparison, self.figures)

    def show(self) -> None:
        """Print the paths."""
        for name, path in (("report", self.report), ("figures", self.figures)):
            if path is not None:
                out.print(f"{name}: {path}")


def command_line() -> str:
    """Return the command line of this program, quoted for a shell, with U+FFFD for what is not UTF-8 in it."""
    return replace_controls_in_lines(shlex.join(["zenostat", *sys.argv[1:]]))
