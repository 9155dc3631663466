"""Checks of events and of an exchange's state."""

import copy
from collections.abc import Callable

import numpy as np

from support.builders import advance, answer, claim, exchange, ruling
from zenostat.bridge.exchange.step_exchange import StepExchange
from zenostat.topics.messages import CommandOp, Event, EventKind, State

KEEP, SET, RELEASE = CommandOp.KEEP, CommandOp.SET, CommandOp.RELINQUISH


def check_event(event: Event | None, kind: EventKind, *words: str) -> None:
    """The event is of that kind and its text has those words."""
    assert event.kind is kind
    for word in words:
        assert word in event.text, event.text


def same(one: list[float], other: list[float]) -> bool:
    """Equal, with NaN equal to NaN."""
    return np.array_equal(one, other, equal_nan=True)


def unchanged(at: StepExchange, act: Callable[[], object], *, count: str) -> object:
    """Return the result of `act`, after a check that it changed nothing but that count, by one."""
    before = copy.deepcopy(at)
    result = act()
    for name in ("accepted", "rejected", "late", "duplicate"):
        assert getattr(at.counts, name) - getattr(before.counts, name) == (name == count), name
    assert (at.state, at.episode, at.step, at.awaiting()) == (
        before.state, before.episode, before.step, before.awaiting(),
    )  # fmt: skip
    uncounted = dict.fromkeys(("rejected", "late", "duplicate"), 0)  # those of the one who sent it
    assert [c.model_copy(update=uncounted) for c in at.controllers()] == [
        c.model_copy(update=uncounted) for c in before.controllers()
    ]
    assert at.ready_to_step() == before.ready_to_step()
    assert at.commands.has_expiries == before.commands.has_expiries
    if at.state is State.WAITING:
        assert repr(ruling(at)) == repr(ruling(before))
    return result


def running() -> StepExchange:
    """At sample 2 of episode 0; `agent` has still to answer, `helper` (whose level rules) need not."""
    at = exchange()
    claim(at, "agent", 10)
    claim(at, "helper", 9, actuators=["cool"], required=False)
    for _ in range(2):
        answer(at, "agent", [20.0, 25.0])
        advance(at)
    return at
