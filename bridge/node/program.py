"""A node, or the replay of one, as a program for another program.

Standard input: one line of JSON with the settings; the node ends when standard input is closed. Standard output: one
line of JSON, `{"ready": name, "manifest": {...}}` or `{"error": class, "message": text}`.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from typing import Any, Protocol

from zenostat.bridge.runtime.signals import TERMINATION_SIGNALS
from zenostat.topics.errors import ZenostatError, to_wire
from zenostat.topics.messages import Manifest


class _Settings(Protocol):
    @property
    def name(self) -> str: ...
    @property
    def check(self) -> bool: ...


class RunnableNode(AbstractContextManager[Any], Protocol):
    """A node that is on the bus while it is entered."""

    @property
    def settings(self) -> _Settings:
        """Its name, and whether it is only checked."""

    @property
    def manifest(self) -> Manifest:
        """Its manifest; only while it is entered."""

    def check(self) -> None:
        """Check everything without starting it."""

    def serve(self) -> object:
        """Serve until its end."""


def _end_with_owner() -> None:
    while os.read(0, 4096):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


def _print_line(**fields: Any) -> None:
    try:
        print(json.dumps(fields), flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the owner has ended, which the lifeline detects as well


def run(create: Callable[[Mapping[str, Any]], RunnableNode]) -> int:
    """Run a node until it ends.

    Args:
        create: checks the settings and returns the node, which is not started yet.

    Returns:
        0 after a request or signal to stop, or a successful check; 1 if the node could not start.
    """
    for number in TERMINATION_SIGNALS:
        signal.signal(number, lambda *_: sys.exit(0))
    line = b""
    while not line.endswith(b"\n"):
        more = os.read(0, 65536)
        if not more:
            return 1
        line += more
    threading.Thread(target=_end_with_owner, daemon=True, name="lifeline").start()
    try:
        node = create(json.loads(line))
        if node.settings.check:
            node.check()
            _print_line(ready=node.settings.name)
            return 0
        with node:
            _print_line(ready=node.settings.name, manifest=node.manifest.model_dump(mode="json"))
            node.serve()
    except ZenostatError as error:
        _print_line(**to_wire(error))
        return 1
    except Exception as error:
        _print_line(**to_wire(error))
        raise
    return 0


def main(create: Callable[[Mapping[str, Any]], RunnableNode]) -> None:
    """Run a node and exit; see `run`."""
    code = run(create)
    for ignored in TERMINATION_SIGNALS:  # everything is closed; a signal would only change the exit code
        signal.signal(ignored, signal.SIG_IGN)
    sys.exit(code)
