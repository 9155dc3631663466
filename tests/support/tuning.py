"""Tuning files, and tunings whose processes end."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import TYPE_CHECKING

from zenostat.lab.config_file import read_file
from zenostat.lab.tuning.study_config import StudyConfig
from zenostat.lab.tuning.tuning_file import read_tuning
from zenostat.topics.file_kinds import FileKind

if TYPE_CHECKING:
    from zenostat.lab.tuning.study import Tuning


def load_tuning(path: Path) -> StudyConfig:
    """The study of a tuning file."""
    return read_tuning(read_file(path, FileKind.TUNING), str(path), path.parent)


def kill_first_process(tuning: Tuning) -> None:
    """Have a tuning's first process killed once it has started."""
    start = tuning._start

    def start_and_kill() -> None:
        start()
        tuning._start = start  # type: ignore[method-assign]
        os.kill(tuning.processes[0], signal.SIGKILL)

    tuning._start = start_and_kill  # type: ignore[method-assign]
