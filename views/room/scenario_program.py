"""The program that answers questions about scenarios: it reads models and runs EnergyPlus, which this package does not.

It runs beside the server, so neither a model that takes long nor one that ends the program disturbs the page.
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from zenostat.topics.errors import PeerError, RequestRejected, from_wire

MODULE = "zenostat.cli.scenario_answers"

_ANSWER_S = 180.0
_MAX_WAITING = 6
_END_S = 5.0


class ScenarioProgram:
    """Questions to `zenostat.cli.scenario_answers`, one at a time; the program starts with the first one.

    Args:
        folder: of scenarios; None for none.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._process: subprocess.Popen[str] | None = None
        self._lock, self._waiting, self._count = threading.Lock(), 0, threading.Lock()
        self._is_closed = False

    def ask(self, question: str, **arguments: Any) -> Any:
        """Return the answer to a question; waits for those before it, from any thread.

        Raises:
            ZenostatError: the program's error.
            RequestRejected: too many questions wait.
            PeerError: the program ended, or gave no answer in time.
        """
        with self._count:
            if self._waiting >= _MAX_WAITING:
                raise RequestRejected(f"{_MAX_WAITING} questions about scenarios wait for an answer; try again later")
            self._waiting += 1
        try:
            with self._lock:
                return self._ask({"ask": question, **arguments})
        finally:
            with self._count:
                self._waiting -= 1

    def _ask(self, question: dict[str, Any]) -> Any:
        process = self._running()
        assert process.stdin is not None
        assert process.stdout is not None
        watch = threading.Timer(_ANSWER_S, process.kill)
        watch.start()
        try:
            process.stdin.write(json.dumps(question) + "\n")
            process.stdin.flush()
            line = process.stdout.readline()
        except (OSError, ValueError):  # it has ended
            line = ""
        finally:
            watch.cancel()
        if not line:
            self._end()
            raise PeerError("the program that reads scenarios ended, or took too long; try again")
        content = json.loads(line)
        if "error" in content:
            raise from_wire(content)
        return content["answer"]

    def _running(self) -> subprocess.Popen[str]:
        """Return the program, which is started if it is not running."""
        if self._is_closed:
            raise PeerError("the control room is ending")
        if self._process is not None and self._process.poll() is not None:
            self._end()
        if self._process is None:
            # A process group of its own: Ctrl-C in the terminal is for the server, whose end ends its input.
            command = [sys.executable, "-P", "-m", MODULE, *([] if self._folder is None else [str(self._folder)])]
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, encoding="utf-8", process_group=0
            )
        return self._process

    def close(self) -> None:
        """End the program; an answer that is awaited fails."""
        self._is_closed = True
        process = self._process
        if process is not None:
            process.kill()
        with self._lock:
            self._end()

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        process.kill()
        process.wait(_END_S)
        for pipe in (process.stdin, process.stdout):
            _close(pipe.close if pipe is not None else lambda: None)


def _close(close: Callable[[], None]) -> None:
    try:
        close()
    except OSError:  # what was not written yet
        return
