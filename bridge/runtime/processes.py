"""Other programs in processes of their own: the command line of `zenostat`, and their end."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Collection
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
