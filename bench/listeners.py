"""Monitors for a measurement: processes of `zenostat monitor --save`."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def listening(endpoint: str, count: int) -> Iterator[None]:
    """Run `count` monitors on the bus, each writing a Rerun recording."""
    with tempfile.TemporaryDirectory(prefix="zenostat-bench-") as folder:
        monitors = []
        for number in range(count):
            target = Path(folder) / f"{number}.rrd"
            command = [
                sys.executable,
                "-P",
                "-m",
                "zenostat.cli.main",
                "monitor",
                "--connect",
                endpoint,
                "--save",
                str(target),
            ]
            monitors.append(subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True))
        for monitor in monitors:
            assert monitor.stdout is not None
            monitor.stdout.readline()  # it prints a line once it is listening
        try:
            yield
        finally:
            for monitor in monitors:
                monitor.terminate()
            for monitor in monitors:
                monitor.wait()
