"""Warnings of a node or router whose own certificate expires."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from support.clock import Clock

from zenostat.bridge.transport.certificates import make
from zenostat.bridge.transport.expiry_watch import ExpiryWatch
from zenostat.bridge.transport.identity import identity
from zenostat.topics.keys import Role

DAY_S = 86400.0


@pytest.mark.parametrize(("days", "expected"), [(40, [10, 37, 40]), (20, [17, 20]), (1, [1])])
def test_expiry_watch__warns_30_and_3_days_before_and_at_the_end(days: int, expected: list[int]) -> None:
    begin, clock = datetime(2030, 1, 1, tzinfo=UTC), Clock()
    certificate: Any = SimpleNamespace(expires=begin + timedelta(days=days), warning="expires")
    calls: list[Any] = []
    timer: Any = SimpleNamespace(at=lambda due_s, call: calls.append(call))
    warned: list[float] = []
    ExpiryWatch(
        certificate, timer, lambda _: warned.append(clock.now_s / DAY_S), lambda: begin + timedelta(seconds=clock.now_s)
    )
    for hour in range(50 * 24):
        clock.now_s = hour * 3600.0
        for call in [calls.pop()] if calls else []:
            call()
    assert warned == expected
    assert not calls


def test_expiry_watch__last_warning_is_that_it_has_expired(tmp_path: Path) -> None:
    make(tmp_path)
    ended = replace(identity(tmp_path, Role.NODE), expires=datetime.now(UTC) - timedelta(hours=1))
    calls: list[Any] = []
    timer: Any = SimpleNamespace(at=lambda due_s, call: calls.append(call))
    warned: list[str] = []
    moments = iter((ended.expires - timedelta(hours=2), ended.expires - timedelta(hours=2), ended.expires))
    ExpiryWatch(ended, timer, warned.append, lambda: next(moments))
    calls.pop()()
    (warning,) = warned
    assert warning.startswith(f"{ended.certificate} expired on ")
    assert not calls
