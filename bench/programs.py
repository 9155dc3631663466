"""Modules of the benchmarks, and commands of `zenostat`, as programs of their own."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from zenostat.bridge.runtime.processes import ZENOSTAT


def command(module: str, *arguments: str) -> list[str]:
    """Return the command that runs a module; it needs `environment()`, since the working folder is not searched."""
    return [sys.executable, "-P", "-m", f"bench.{module}", *arguments]


def environment() -> dict[str, str]:
    """Return the variables with which a program finds the benchmarks."""
    return {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}


@contextmanager
def started(*arguments: str, **options: Any) -> Iterator[tuple[int, str]]:
    """Run a command of `zenostat`, which is ended in the end; yield its process id and its first line of output.

    Args:
        arguments: of the command.
        options: of `subprocess.Popen`.
    """
    command = [*ZENOSTAT, *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, process_group=0, **options) as program:
        assert program.stdout is not None
        try:
            yield program.pid, program.stdout.readline()
        finally:
            program.terminate()


def free_port() -> int:
    """Return a port of the loopback interface on which nobody listens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def result(module: str, *arguments: str) -> Any:
    """Run a module, and return what its last line of output says, as JSON.

    Raises:
        RuntimeError: the program failed; the text ends as its errors do.
    """
    program = command(module, *arguments)
    done = subprocess.run(program, capture_output=True, text=True, check=False, env=environment())
    if done.returncode:
        raise RuntimeError(f"{' '.join(program)} failed:\n{done.stderr[-3000:]}")
    return json.loads(done.stdout.splitlines()[-1])
