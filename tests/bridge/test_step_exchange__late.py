"""Late commands, and controllers that others replace."""

import pytest
from support.builders import advance, answer, claim, command, wire
from support.fallback_exchanges import (
    check_ruled,
    disconnect,
    expected_under,
    kinds_and_sources,
    node,
    state,
    status,
    with_agent,
)

from zenostat.topics.messages import ControllerState, EventKind, Policy

# Late


def test_step_exchange__late_command_states_how_late_and_has_no_effect() -> None:
    """node@1 at 1 s → deadline: node@2 at 3 s → agent@1 at 7.5 s: 4.5 s late → 8 s: deadline: node@3"""
    at = with_agent(Policy.HOLD, 2.0)
    at.fallback.on_deadline(3.0)
    advance(at, now_s=3.0)
    event = at.intake.receive_command("agent", wire(command([22.0, 29.0], step=1)), 7.5)
    assert (event.kind, event.source, event.step, event.late_s) == (EventKind.LATE, "agent", 2, 4.5)
    assert "step [1]" in event.text
    assert at.awaiting() == ["agent"]  # it has not answered sample 2 by that
    assert (at.counts.late, status(at, "agent").late) == (1, 1)
    assert state(at, "agent") is ControllerState.UNRESPONSIVE
    at.fallback.on_deadline(7.5)
    check_ruled(at, expected_under(Policy.HOLD), now_s=7.5)


def test_step_exchange__lateness_is_counted_from_the_step_that_the_command_answers() -> None:
    """Steps 1, 2, 3 went on at 3, 5 and 7 s; the commands for them all come at 10 s."""
    at = with_agent(Policy.HOLD, 2.0)
    for now_s in (3.0, 5.0, 7.0):
        at.fallback.on_deadline(now_s)
        advance(at, now_s=now_s)
    late = [at.intake.receive_command("agent", wire(command([22.0, 29.0], step=step)), 10.0) for step in (1, 2, 3)]
    assert [event.late_s for event in late if event is not None] == [7.0, 5.0, 3.0]


def test_step_exchange__of_several_slots_the_one_that_was_answered_states_how_late() -> None:
    """Slot 1 alone moves at 4 s, both move at 6 s; at 10 s a command for slot 1's sample 1, and one for slot 0's."""
    at = node(Policy.HOLD, 2.0, slots=2)
    claim(at, "agent")
    values = [20.0, 25.0] * 2
    for now_s, still in ((2.0, None), (4.0, 0), (6.0, None)):
        step: list[int | None] = [*at.step]
        if still is not None:
            step[still] = None
        sent = command(values, step=at.step, episode=at.episode).model_copy(update={"step": step})
        assert at.intake.command("agent", sent, now_s) is None
        advance(at, now_s=now_s)
    assert at.step == [2, 3]
    sent = command(values, step=[0, 1], episode=[0, 0])
    slot_1 = at.intake.command("agent", sent.model_copy(update={"step": [None, 1]}), 10.0)
    slot_0 = at.intake.command("agent", sent.model_copy(update={"step": [1, None]}), 10.0)
    assert slot_1 is not None
    assert (slot_1.late_s, slot_0.late_s) == (6.0, 4.0)  # slot 0 stood at sample 1 until 6 s


def test_step_exchange__how_late_is_not_invented_once_it_is_forgotten() -> None:
    at = with_agent(Policy.HOLD)
    disconnect(at, "agent")
    for _ in range(1000):
        advance(at)
    claim(at, "agent")
    event = at.intake.receive_command("agent", wire(command([22.0, 29.0], step=1)), 1.0)
    assert (event.kind, event.late_s) == (EventKind.LATE, None)


# Replaced


@pytest.mark.parametrize("deadline_s", [None, 2.0])
@pytest.mark.parametrize("policy", Policy)
def test_step_exchange__another_program_takes_over_within_the_time_of_grace(
    policy: Policy, deadline_s: float | None
) -> None:
    """agent@0 → node@1 → agent gone → other claims → other@1 → node@2: no timestep without a ruler"""
    at = with_agent(policy, deadline_s)
    at.fallback.on_disconnect("agent", 1.5)
    assert kinds_and_sources(claim(at, "other", now_s=1.5)) == [
        (EventKind.DISCONNECTED, "agent"),
        (EventKind.CONNECTED, "other"),
    ]
    assert at.fallback.bypass("agent", 2.0, 0.1) == []
    assert not at.ready_to_step()
    assert answer(at, "other", [21.0, 26.0], now_s=2.0) is None
    check_ruled(at, ([21.0, 26.0], ["other", "other"]), now_s=2.0, fallback=False)
    assert at.counts.missed == 0


def test_step_exchange__another_program_takes_over_from_one_that_is_waived() -> None:
    """The first one's command holds until the other's first answer, also if that misses a deadline."""
    at = with_agent(Policy.HOLD, 2.0)
    disconnect(at, "agent")
    at.fallback.on_deadline(1.0)
    check_ruled(at, expected_under(Policy.HOLD))
    claim(at, "other")
    assert kinds_and_sources(at.fallback.on_deadline(1.0)) == [(EventKind.FALLBACK, "other")]
    check_ruled(at, ([20.0, 25.0], ["agent", "agent"]))
    answer(at, "other", [21.0, 26.0])
    check_ruled(at, ([21.0, 26.0], ["other", "other"]), fallback=False)


def test_step_exchange__one_that_was_replaced_is_not_counted_any_more() -> None:
    at = with_agent(Policy.HOLD)
    disconnect(at, "agent")
    advance(at)
    claim(at, "other")
    answer(at, "other", [21.0, 26.0])
    advance(at)
    assert at.counts.missed == 1
    assert [c.controller for c in at.controllers()] == ["other"]
    assert at.fallback.on_disconnect("agent", 1.0) == at.fallback.bypass("agent", 1.0) == []
