"""The audit log of a server: a line of JSON for each call of a tool before it runs, and one with its outcome.

A call that cannot be logged does not run. What reaches a node is in the node's recordings as well, with this server's
name and the way in `mcp`.
"""

from __future__ import annotations

import io
import json
import os
import sys
import threading
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any

from zenostat.topics.errors import InvalidConfig, RequestRejected

_MAX_ARGUMENTS = 4000


class CallLog:
    """Lines of JSON in a file that is readable by its owner alone, or on standard error; for several threads.

    Args:
        path: the file, which is appended to; None: standard error.
        now: the present time, with a zone.

    Raises:
        InvalidConfig: the file cannot be written.
    """

    def __init__(self, path: Path | None, *, now: Callable[[], datetime] = lambda: datetime.now(UTC)) -> None:
        self._lock, self._calls, self._now = threading.Lock(), 0, now
        self._file: io.FileIO | None = None
        if path is not None:
            try:
                self._file = io.FileIO(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600), "a")
            except OSError as error:
                raise InvalidConfig(f"--audit-log {path}: {error.strerror}") from None

    def __enter__(self) -> CallLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is not None:
            self._file.close()

    def begin(self, client: str, tool: str, arguments: Mapping[str, Any]) -> int:
        """Log a call that is about to run; return its number.

        Raises:
            RequestRejected: the log cannot be written, so the call must not run.
        """
        text = json.dumps(arguments, default=str)
        # JSON has no NaN and no infinities: they are logged as texts.
        shown = json.loads(text, parse_constant=str) if len(text) <= _MAX_ARGUMENTS else text[:_MAX_ARGUMENTS]
        with self._lock:
            self._calls += 1
            self._write({"call": self._calls, "client": client[:200], "tool": tool[:200], "arguments": shown})
            return self._calls

    def end(self, call: int, outcome: str) -> None:
        """Log the outcome of a call: `ok`, or an error.

        Raises:
            RequestRejected: the log cannot be written.
        """
        with self._lock:
            self._write({"call": call, "outcome": outcome[:_MAX_ARGUMENTS]})

    def _write(self, entry: Mapping[str, Any]) -> None:
        line = json.dumps({"time": self._now().isoformat(timespec="milliseconds"), **entry}, default=str)
        try:
            if self._file is None:
                sys.stderr.write(f"{line}\n")
                sys.stderr.flush()
            elif (written := self._file.write(f"{line}\n".encode())) != len(line) + 1:  # JSON is ASCII
                raise OSError(f"{written} bytes of {len(line) + 1} were written")
        except (OSError, ValueError) as error:
            raise RequestRejected(f"the audit log cannot be written: {error}") from None
