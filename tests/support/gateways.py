"""Gateways as programs."""

from __future__ import annotations

import signal
import subprocess
from subprocess import PIPE

from support.run_cli import ZENOSTAT


class RunningGateway:
    """A gateway of a node as a program, which is ready.

    Args:
        words: after `zenostat gateway`.

    Attributes:
        description: its first line.
    """

    def __init__(self, *words: str) -> None:
        self.program = subprocess.Popen([*ZENOSTAT, "gateway", *words], stdout=PIPE, stderr=PIPE, text=True)
        self.description = self.program.stdout.readline()
        if not self.description.startswith("ready: "):
            raise AssertionError(self.description + self.program.communicate()[1])

    def __enter__(self) -> RunningGateway:
        return self

    def __exit__(self, *_: object) -> None:
        self.program.kill()
        self.program.communicate()

    @property
    def port(self) -> int:
        """The port of an address 127.0.0.1:PORT in its first line."""
        return int(self.description.partition("127.0.0.1:")[2].split(",")[0].split(" ")[0])

    def end(self, number: signal.Signals = signal.SIGTERM) -> tuple[int, str, str]:
        """Send a signal; return the exit code, and what it wrote to standard output and to standard error since."""
        self.program.send_signal(number)
        out, err = self.program.communicate(timeout=60)
        return self.program.returncode, out, err
