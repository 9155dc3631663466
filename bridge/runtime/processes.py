"""Other programs in processes of their own: the command line of `zenostat`, and their end."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Collection
from pathlib import Path
from typing import Any

ZENOSTAT = (sys.executable, "-P", "-m", "zenostat.cli.main")
"""The command that runs `zenostat`, before its arguments."""


def end_processes(processes: Collection[subprocess.Popen[Any]], timeout_s: float) -> None:
    """Let processes end at the same time, and wait for them; kill those that have not ended after that time."""
    for process in processes:
        process.terminate()
    deadline_s = time.monotonic() + timeout_s
    for process in processes:
        try:
            process.wait(max(deadline_s - time.monotonic(), 0.1))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


class Monitor:
    """A live view of a bus in a process of its own: Rerun's viewer if there is a display, else its web page."""

    def __init__(self, endpoint: str, keys: Path | None = None) -> None:
        display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        program = [*ZENOSTAT, "monitor", "--connect", endpoint, *(["--keys", str(keys)] if keys is not None else [])]
        self._process = subprocess.Popen([*program, *([] if display else ["--web"])], stdin=subprocess.DEVNULL)
        self._owner = os.getpid()

    def close(self) -> None:
        """Close the view and end its process."""
        if os.getpid() != self._owner:
            return  # the exit of a forked child must not end its parent's monitor
        end_processes([self._process], 5.0)
