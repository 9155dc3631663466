"""The programs around a node: who they are, and what can be done to them."""

import json
import os
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

from chaos.controller import LOST

_TESTS = str(Path(__file__).parents[1])
_ROOT = str(Path(__file__).parents[2])
_PATIENCE_S = 60.0


def environment() -> dict[str, str]:
    """Environment variables of programs of this package."""
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, [_ROOT, _TESTS, os.environ.get("PYTHONPATH", "")]))}


class Member:
    """One place in the crew, held by one program after the other.

    Attributes:
        ended: how those ended that nobody had ended: exit codes and what they said.
        lost: how many took the node for gone.
    """

    def __init__(self, module: str, settings: dict[str, Any], log: Path, **popen: Any) -> None:
        self.settings = settings
        self._command = [sys.executable, "-P", "-m", f"chaos.{module}", json.dumps(settings)]
        self._log, self._popen = log, popen
        self._lock = threading.RLock()
        self._process: subprocess.Popen[str] | None = None
        self._said_ready: subprocess.Popen[str] | None = None
        self.frozen = False
        self.ended: list[str] = []
        self.lost = 0
        self.start()

    @property
    def process(self) -> subprocess.Popen[str]:
        """The program that holds the place now."""
        assert self._process is not None
        return self._process

    def start(self) -> None:
        """A program takes the place, if it is free."""
        with self._lock:
            if self._process is not None:
                return
            self.frozen = False
            with self._log.open("a") as log:
                self._process = subprocess.Popen(
                    self._command, env=environment(), text=True, stderr=log, process_group=0, **self._popen
                )

    def await_ready(self) -> None:
        """Until its program has said its first line, that it is ready; at once if that was heard before."""
        if self._said_ready is not self.process:
            assert self.process.stdout is not None
            self.process.stdout.readline()
            self._said_ready = self.process

    @property
    def up(self) -> bool:
        """Whether it runs, unfrozen."""
        with self._lock:
            return self._process is not None and self._process.poll() is None and not self.frozen

    def end(self, number: signal.Signals) -> None:
        """Kills the program, or has it end, and waits for that; the place is free then."""
        with self._lock:
            if self._process is not None:
                self.thaw()
                self._process.send_signal(number)
                try:
                    self._process.wait(_PATIENCE_S)
                except subprocess.TimeoutExpired:
                    self.ended.append(
                        f"{self._command[3]} did not end on {number.name}: {self._log.read_text()[-2000:]}"
                    )
                    self._process.kill()
                    self._process.wait()
                self._let_go()

    def _let_go(self) -> None:
        assert self._process is not None
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with suppress(BrokenPipeError):
                    pipe.close()
        self._process = None

    def freeze(self) -> None:
        """It stands still until `thaw`."""
        with self._lock:
            if self._process is not None:
                self._process.send_signal(signal.SIGSTOP)
                self.frozen = True

    def thaw(self) -> None:
        """It goes on."""
        with self._lock:
            if self._process is not None and self.frozen:
                self._process.send_signal(signal.SIGCONT)
                self.frozen = False

    def look(self) -> None:
        """Start another program in place of one that ended by itself."""
        with self._lock:
            if self._process is None or self._process.poll() is None:
                return
            code = self._process.returncode
            self._let_go()
            if code == LOST:
                self.lost += 1
            else:
                self.ended.append(f"{self._command[3]} ended with {code}: {self._log.read_text()[-2000:]}")
            self.start()

    def finish(self) -> int | None:
        """Waits for its own end; its exit code, None if there was none."""
        with self._lock:
            if self._process is None:
                return None
            self.thaw()
            try:
                return self._process.wait(_PATIENCE_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
                return None
            finally:
                self._let_go()
