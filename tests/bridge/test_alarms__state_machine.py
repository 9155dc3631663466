"""The state machine of an alarm: schedules of values with the states that BACnet and ISA-18.2 prescribe."""

from __future__ import annotations

from math import inf, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.alarms.state_machine import TRANSITIONS, Alarm, Limits
from topics.messages import AlarmState, AlarmTransition, EventState

NORMAL, ACTIVE, ACKNOWLEDGED, RETURNED = AlarmState
OK, HIGH, LOW, FAULT = EventState
ACK = "ack"


def run(limits: Limits, *steps: object, needs_acknowledgment: bool = True) -> list[tuple[EventState, AlarmState]]:
    """The states after each step; a step is a value, (value, "inhibited"), or an acknowledgment."""
    alarm, states, number = Alarm(limits, needs_acknowledgment), [], 0
    for step in steps:
        if step == ACK:
            alarm.acknowledge()
        else:
            value, inhibited = step if isinstance(step, tuple) else (step, "")
            alarm.update(float(value), number, inhibited=bool(inhibited))  # type: ignore[arg-type]
            number += 1
        states.append((alarm.event_state, alarm.state))
    return states


def last(limits: Limits, *steps: object) -> tuple[EventState, AlarmState]:
    return run(limits, *steps)[-1]


LIMITS = Limits(18.0, 26.0, deadband=1.0)


@pytest.mark.parametrize(
    ("schedule", "state"),
    [
        ([26.0], (OK, NORMAL)),  # the limit itself is normal
        ([26.1], (HIGH, ACTIVE)),
        ([17.9], (LOW, ACTIVE)),
        ([26.1, ACK], (HIGH, ACKNOWLEDGED)),
        ([26.1, ACK, 24.0], (OK, NORMAL)),
        ([26.1, 24.0], (OK, RETURNED)),
        ([26.1, 24.0, ACK], (OK, NORMAL)),
        ([26.1, 24.0, 26.1], (HIGH, ACTIVE)),
        ([26.1, ACK, 24.0, 26.1], (HIGH, ACTIVE)),
        ([26.1, 25.0], (HIGH, ACTIVE)),  # within the deadband
        ([26.1, 24.99], (OK, RETURNED)),
        ([17.9, 19.0], (LOW, ACTIVE)),
        ([17.9, 19.01], (OK, RETURNED)),
        ([26.1, ACK, 17.0], (LOW, ACTIVE)),  # another limit is another alarm
        ([nan], (FAULT, ACTIVE)),
        ([26.1, ACK, nan], (FAULT, ACTIVE)),
        ([nan, ACK, 22.0], (OK, NORMAL)),
        ([nan, 27.0], (OK, RETURNED)),  # from a fault through normal
        ([nan, 27.0, 27.0], (HIGH, ACTIVE)),
        ([inf], (HIGH, ACTIVE)),
        ([(27.0, "inhibited")], (OK, NORMAL)),
        ([27.0, (27.0, "inhibited")], (OK, RETURNED)),
        ([27.0, ACK, (27.0, "inhibited")], (OK, NORMAL)),
        ([(nan, "inhibited")], (FAULT, ACTIVE)),
    ],
)
def test_schedules(schedule: list[object], state: tuple[EventState, AlarmState]) -> None:
    assert last(LIMITS, *schedule) == state


@pytest.mark.parametrize(
    ("schedule", "raised_at"),
    [
        ([27, 27, 27], 2),  # two timesteps after the first
        ([27, 27, 25, 27, 27, 27], 5),  # an interruption begins it anew
        ([27, 27, nan, 27, 27, 27, 27], 6),  # after the fault: normal at step 3, then two timesteps
        ([27, (27, "inhibited"), 27, 27, 27], 4),
    ],
)
def test_a_delay__counts_timesteps_without_interruption(schedule: list[object], raised_at: int) -> None:
    events = [event for event, _ in run(Limits(-inf, 26.0, delay=2, return_delay=1), *schedule)]
    assert events[raised_at] is HIGH
    assert HIGH not in events[:raised_at]


def test_a_return_delay__is_its_own() -> None:
    limits = Limits(-inf, 26.0, deadband=0.5, delay=0, return_delay=2)
    assert [event for event, _ in run(limits, 27, 25, 25, 25, 25)] == [HIGH, HIGH, HIGH, OK, OK]
    assert [event for event, _ in run(limits, 27, 25, 25.8, 25, 25, 25)][-1] is OK  # 25.8 interrupts
    assert run(limits, 27, 25, 25.8, 25, 25)[-1][0] is HIGH


def test_an_event_needs_no_acknowledgment() -> None:
    states = [state for _, state in run(LIMITS, 27, 24, 27, needs_acknowledgment=False)]
    assert states == [ACKNOWLEDGED, NORMAL, ACKNOWLEDGED]


@given(st.lists(st.sampled_from([*AlarmTransition]), max_size=30))
def test_the_table__keeps_the_meaning_of_each_state(triggers: list[AlarmTransition]) -> None:
    """Two facts, kept beside the table, are what each state stands for."""
    state, is_off, is_acknowledged = NORMAL, False, True
    for trigger in triggers:
        if (state, trigger) not in TRANSITIONS:
            continue
        state = TRANSITIONS[state, trigger]
        if trigger is AlarmTransition.ACKNOWLEDGE:
            is_acknowledged = True
        else:
            is_off = trigger is not AlarmTransition.TO_NORMAL
            is_acknowledged = is_acknowledged and not is_off
        expected = {(False, True): NORMAL, (True, False): ACTIVE, (True, True): ACKNOWLEDGED, (False, False): RETURNED}
        assert state is expected[is_off, is_acknowledged]


VALUES = st.lists(st.floats(10, 35) | st.just(nan), min_size=1, max_size=60)


@given(VALUES, st.integers(0, 4), st.integers(0, 4), st.floats(0, 3))
def test_a_limit__is_reported_only_after_its_delay_and_left_only_beyond_the_deadband(
    values: list[float], delay: int, return_delay: int, deadband: float
) -> None:
    limits = Limits(18.0, 26.0, deadband, delay, return_delay)
    events = [event for event, _ in run(limits, *values)]
    for k, event in enumerate(events):
        before = events[k - 1] if k else OK
        if event is before:
            continue
        window = values[max(0, k - (return_delay if event is OK else delay)) : k + 1]
        if event is HIGH:
            assert k >= delay
            assert all(value > 26.0 for value in window)
        elif event is LOW:
            assert all(value < 18.0 for value in window)
        elif event is FAULT:
            assert window[-1] != window[-1]
        elif before is HIGH:
            assert all(value < 26.0 - deadband for value in window)
        elif before is LOW:
            assert all(value > 18.0 + deadband for value in window)


@given(VALUES, st.integers(0, 4))
def test_the_quiet_range__is_where_nothing_changes(values: list[float], delay: int) -> None:
    limits, alarm = Limits(18.0, 26.0, 0.5, delay, delay), Alarm(Limits(18.0, 26.0, 0.5, delay, delay))
    for step, value in enumerate(values):
        low, high = limits.quiet_range(alarm.event_state)
        assert (low <= value <= high) is (limits.event_state(alarm.event_state, value) is alarm.event_state) or (
            alarm.event_state is FAULT and value != value  # visited, without effect
        )
        alarm.update(value, step)
