"""Fallback policies under any schedule."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.builders import advance, answer, claim, command, exchange, wire
from support.examples import examples
from support.fallback_exchanges import KEEP, SET, disconnect, node

from zenostat.bridge.exchange.step_exchange import StepExchange
from zenostat.topics.messages import EventKind, Policy

MOVES = st.lists(
    st.tuples(
        st.sampled_from(["answer", "late", "early", "claim", "disconnected", "waive", "overdue", "go", "go"]),
        st.sampled_from(["a", "b"]),
        st.integers(1, 3),
    ),
    max_size=60,
)


def value(name: str, step: int) -> float:
    """Return a controller's answer to a sample; it identifies both."""
    return (16.0 if name == "a" else 23.0) + step / 64.0


@settings(max_examples=examples(300))
@given(policy=st.sampled_from([Policy.WAIT, Policy.HOLD, Policy.RELINQUISH]), has_deadline=st.booleans(), moves=MOVES)
def test_step_exchange__whatever_happens_a_command_rules_its_own_step_and_every_message_is_counted_once(
    policy: Policy, has_deadline: bool, moves: list[tuple[str, str, int]]
) -> None:
    at = node(policy, 2.0 if has_deadline else None)
    taken: dict[str, list[int]] = {"a": [], "b": []}
    messages, late_but_taken, missed = 0, 0, 0
    for now_s, (kind, name, by) in enumerate(moves, start=1):
        match kind:
            case "claim":
                claim(at, name, actuators=["heat" if name == "a" else "cool"], now_s=now_s)
            case "disconnected":
                at.fallback.on_disconnect(name, now_s)
            case "waive":
                at.fallback.bypass(name, now_s)
            case "overdue":
                if has_deadline:
                    at.fallback.on_deadline(now_s)
            case "go":
                if at.ready_to_step():
                    missed += goes_on(at, policy, taken, now_s)
            case _:
                step = at.step[0] + {"answer": 0, "late": -by, "early": by}[kind]
                if step >= 0:
                    messages += 1
                    late_but_taken += send_random(at, name, step, taken, now_s)
    counts = at.counts
    told_of = counts.accepted + counts.rejected + counts.late + counts.duplicate + counts.rate_limited
    assert told_of == messages
    assert counts.accepted_late == late_but_taken
    assert counts.missed == missed
    assert sum(c.accepted for c in at.controllers()) == counts.accepted


def send_random(at: StepExchange, name: str, step: int, taken: dict[str, list[int]], now_s: float) -> bool:
    """A controller answers a step; notes whether it was taken, and gives whether that was after the deadline."""
    before, own = at.counts.accepted, value(name, step)
    operations = [SET, KEEP] if name == "a" else [KEEP, SET]
    event = at.intake.receive_command(name, wire(command([own, own], step=step, operations=operations)), now_s)
    if at.counts.accepted == before:
        assert event is not None
        return False
    assert step == at.step[0]
    taken[name].append(step)
    return event is not None and event.kind is EventKind.ACCEPTED_LATE


def goes_on(at: StepExchange, policy: Policy, taken: dict[str, list[int]], now_s: float) -> bool:
    """The timestep: who rules does so by what it answered last; gives whether somebody was missing."""
    absent = [c.controller for c in at.controllers() if at.step[0] not in taken[c.controller]]
    values, sources = advance(at, now_s=now_s)
    assert at.fallback_active or not absent
    assert policy is not Policy.WAIT or not absent
    for name, ruling, source_index in zip(("a", "b"), values, sources, strict=True):
        assert source_index in ("", name)
        if source_index:
            assert ruling == value(name, max(taken[name]))
        else:
            assert policy is Policy.RELINQUISH or not taken[name]
    return at.fallback_active


@pytest.mark.parametrize("policy", [Policy.HOLD, Policy.RELINQUISH])
def test_claim__does_not_wait_for_a_disconnected_controller(policy: Policy) -> None:
    at = exchange()
    at.policy, at.deadline_s = policy, 5.0
    claim(at, "gone", 10)
    disconnect(at, "gone", 0.0)
    answer(at, "gone", [20.0, 25.0])
    advance(at)
    assert at.awaiting() == ["gone"], "nobody else is there: the deadline sets the pace"
    claim(at, "new", 12)
    assert at.awaiting() == ["new"]
    answer(at, "new", [20.0, 25.0])
    assert at.ready_to_step()
