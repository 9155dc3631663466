"""The audit log of a control room: who has changed what, or tried to, with the outcome of each change."""

from __future__ import annotations

import json
import os
import secrets
import sys
import threading
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from zenostat.topics.errors import InvalidConfig, PeerError, RequestRejected, ZenostatError
from zenostat.views.room.numbers import to_json
from zenostat.views.room.updates import Updates

TOPIC = "audit"

_KEPT = 500
_SENT = 100
_MAX_TEXT = 2000
_MAX_NAME = 200
_MAX_DENIED = 20
"""Entries in a minute for what the role of one user does not permit, so that they displace no others."""
_MAX_UNWRITTEN = 1 << 20
"""Bytes that are kept while the file cannot be written; what comes later are refusals."""


class Unanswered(PeerError):
    """A change whose outcome is not known: it may have been carried out, or be carried out later."""


class AuditLog:
    """Changes in the order in which they were requested; thread-safe.

    A change that takes a while has two lines of the file, with the same `id`: one before it is made, and its outcome.

    Args:
        updates: receives the latest entries.
        file: to which each entry is added as a line of JSON; None for none.
        clock: monotonic time in seconds.

    Raises:
        InvalidConfig: the file cannot be written.
    """

    def __init__(self, updates: Updates, file: Path | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        self._updates, self._clock, self._lock = updates, clock, threading.Lock()
        self._denied: Counter[str] = Counter()
        self._minute = 0
        self._entries: dict[str, dict[str, Any]] = {}
        self._unwritten = b""
        try:
            # Each entry is one write to the end of the file, which a rotation may move.
            self._file = None if file is None else os.open(file, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
        except OSError as error:
            raise InvalidConfig(f"--audit-log {file}: {error.strerror}") from None

    def add(self, operator: str, operation: str, target: str, outcome: str, *, accepted: bool) -> None:
        """Add a change.

        Args:
            operator: name of the user.
            operation: the change, as in its address.
            target: of the change: a node, a scenario, or a user.
            outcome: answer, or the reason for which it was rejected.
            accepted: whether it was carried out.

        What cannot be written to the file is kept, and written before any other change is made; see `attempt`.
        """
        self._set(_entry(operator, operation, target), outcome, accepted=accepted)

    def _set(self, entry: dict[str, Any], outcome: str, *, accepted: bool | None) -> str:
        """Set the outcome of a change, and write it; return why it cannot be written, or "".

        `accepted` None: it is not known whether it was carried out.
        """
        entry = entry | {"accepted": accepted, "outcome": outcome[:_MAX_TEXT]}
        with self._lock:
            self._entries[entry["id"]] = entry
            if len(self._entries) > _KEPT:
                del self._entries[next(iter(self._entries))]
            problem = ""
            if self._file is not None and len(self._unwritten) < _MAX_UNWRITTEN:
                self._unwritten += json.dumps(entry | {"time": _now()}).encode() + b"\n"
                problem = self._write()
                if problem:
                    sys.stderr.write(f"the audit log cannot be written: {problem}\n")
            latest = [*self._entries.values()][-_SENT:]
        self._updates.publish(TOPIC, to_json({"entries": latest}))
        return problem

    def add_denied(self, operator: str, operation: str, target: str, reason: str) -> None:
        """Add an attempt that the role of its user does not permit, of one user at most 20 in a minute.

        Arguments are those of `add`, which may be texts of a stranger of any length; `reason` is the outcome.
        """
        minute = int(self._clock() // 60)
        with self._lock:
            if minute != self._minute:
                self._minute = minute
                self._denied.clear()
            self._denied[operator] += 1
            number = self._denied[operator]
        if number == _MAX_DENIED:
            reason += "; further attempts within this minute are not listed"
        if number <= _MAX_DENIED:
            self.add(operator, operation[:_MAX_NAME], target[:_MAX_NAME], reason, accepted=False)

    def _write(self) -> str:
        """Write what is not written yet; return why it cannot be, or ""."""
        try:
            while self._file is not None and self._unwritten:
                self._unwritten = self._unwritten[os.write(self._file, self._unwritten) :]
        except OSError as error:
            return error.strerror or str(error)
        return ""

    async def attempt(
        self, operator: str, operation: str, target: str, change: Callable[[], Awaitable[str]], request: bytes = b""
    ) -> str:
        """Add a change, make it, set its outcome, and return its answer.

        Args:
            operator: name of the user.
            operation: the change, as in its address.
            target: of the change.
            change: makes it, and returns its answer; not called if the entry cannot be written.
            request: content of the change, as it was received.

        Raises:
            ZenostatError: the change was rejected, or is `Unanswered`, which is its outcome, like any other error.
        """
        entry = _entry(operator, operation, target, request)
        problem = self._set(entry, "requested", accepted=None)
        outcome, accepted = "the control room ended before the answer; it may be carried out", None
        try:
            if problem:
                raise RequestRejected(f"nothing was changed, since the audit log cannot be written: {problem}")
            outcome = await change()
            accepted = True
        except Exception as error:
            outcome = str(error) if isinstance(error, ZenostatError) else f"{type(error).__name__}: {error}"
            accepted = None if isinstance(error, Unanswered) else False
            raise
        finally:
            self._set(entry, outcome, accepted=accepted)
        return outcome

    def entries(self) -> list[dict[str, Any]]:
        """Return the latest entries, the newest one last."""
        with self._lock:
            return [*self._entries.values()]

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            if self._file is not None:
                os.close(self._file)
                self._file = None


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def _entry(operator: str, operation: str, target: str, request: bytes = b"") -> dict[str, Any]:
    """Return an entry without its outcome."""
    return {
        "time": _now(),
        "id": secrets.token_hex(8),
        "operator": operator,
        "operation": operation,
        "target": target,
        "request": request[:_MAX_TEXT].decode(errors="replace"),
    }
