"""`zenostat` commands: as programs, and within the test's process where only what they print is tested."""

import io
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any
from unittest.mock import patch

from support.nodes import SMALL
from zenostat.bridge.runtime.signals import TERMINATION_SIGNALS
from zenostat.cli.main import main

ZENOSTAT = (sys.executable, "-P", "-m", "zenostat.cli.main")
"""A command as a program starts with these words."""

DAY = ("--building", SMALL["building"], "--weather", SMALL["weather"], "--begin", "07-03", "--end", "07-03")
"""Options of `zenostat node`: a day of the small building."""


def run_python(*words: str, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run Python with these words as a program of its own, which reads nothing; see `subprocess.run` for options."""
    return subprocess.run([sys.executable, *words], stdin=subprocess.DEVNULL, capture_output=True, text=True, **options)


def run_program(
    *arguments: str, cwd: Path | None = None, columns: int = 80, timeout_s: float = 120.0
) -> subprocess.CompletedProcess[str]:
    """Run a command as a program of its own."""
    size = {**os.environ, "COLUMNS": str(columns), "TERMINAL_WIDTH": str(columns)}
    return subprocess.run([*ZENOSTAT, *arguments], capture_output=True, text=True, cwd=cwd, env=size, timeout=timeout_s)


def run_in_process(*arguments: str, cwd: Path | None = None, columns: int = 80) -> subprocess.CompletedProcess[str]:
    """Run a command through its entry point within this process; its exit code and output are a program's.

    A new process needs half a second for its imports alone.
    """
    out, err = io.StringIO(), io.StringIO()
    with (
        _main_restored("zenostat", *arguments),
        patch.dict(os.environ, COLUMNS=str(columns)),
        chdir(cwd or Path.cwd()),
        redirect_stdout(out),
        redirect_stderr(err),
    ):
        try:
            main()
        except SystemExit as exit_:
            code = exit_.code if isinstance(exit_.code, int) else int(exit_.code is not None)
    return subprocess.CompletedProcess(arguments, code, out.getvalue(), err.getvalue())


def output_of(*arguments: str, cwd: Path | None = None, columns: int = 80) -> str:
    """Run a command within this process, which must succeed; return its output."""
    done = run_in_process(*arguments, cwd=cwd, columns=columns)
    assert done.returncode == 0, done.stderr
    return done.stdout


def error_of(*arguments: str, cwd: Path | None = None, columns: int = 80, code: int = 2) -> str:
    """Run a command within this process, which must fail; return its error in one line and without colors."""
    done = run_in_process(*arguments, cwd=cwd, columns=columns)
    assert done.returncode == code, (done.stdout, done.stderr)
    assert "Traceback" not in done.stderr
    return plain(done.stderr)


def plain(text: str) -> str:
    """Return the text in one line and without colors."""
    return " ".join(re.sub(r"\x1b\[[0-9;]*m", "", text).split())


@contextmanager
def _main_restored(*argv: str) -> Iterator[None]:
    """Restore what `main` changes in its process: the signals' handlers; give it these words."""
    handlers = {number: signal.getsignal(number) for number in TERMINATION_SIGNALS}
    before, sys.argv = sys.argv, list(argv)
    try:
        yield
    finally:
        sys.argv = before
        for number, handler in handlers.items():
            signal.signal(number, handler)
