"""Warnings of a node or router that runs for long: its own certificate expires soon, or has expired."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from time import monotonic

from zenostat.bridge.runtime.timer import Timer
from zenostat.bridge.transport.identity import EXPIRES_SOON, Identity

_BEFORE = (EXPIRES_SOON, timedelta(days=3), timedelta(0))
_CHECK_S = 3600.0
"""Longest interval of the checks: the timer's clock does not follow the calendar, such as while a machine sleeps."""


class ExpiryWatch:
    """Warnings 30 days and 3 days before a certificate expires, and when it does; those that are past are left out.

    Args:
        identity: with the certificate.
        timer: of the checks, which end with it.
        warn: called with the text of a warning, in the timer's thread.
        now: the present time, UTC.
    """

    def __init__(
        self,
        identity: Identity,
        timer: Timer,
        warn: Callable[[str], None],
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
    ) -> None:
        self._identity, self._timer, self._warn, self._now = identity, timer, warn, now
        self._pending = self._moments()
        self._wait()

    def _moments(self) -> list[datetime]:
        now = self._now()
        return [moment for before in _BEFORE if (moment := self._identity.expires - before) > now]

    def _wait(self) -> None:
        if self._pending:
            left_s = (self._pending[0] - self._now()).total_seconds()
            self._timer.at(monotonic() + min(left_s, _CHECK_S), self._check)

    def _check(self) -> None:
        previous, self._pending = self._pending, self._moments()
        if len(self._pending) < len(previous):
            self._warn(self._identity.warning)
        self._wait()
