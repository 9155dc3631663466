"""The state machine of an alarm: schedules of values with the states that BACnet and ISA-18.2 prescribe."""

import re
from math import inf, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zenostat.bridge.alarms import state_machine
from zenostat.bridge.alarms.state_machine import ALERTING, SET_ASIDE, TRANSITIONS, Alarm, Limits
from zenostat.topics.messages import AlarmState, AlarmTransition, EventState

NORMAL, ACTIVE, ACKNOWLEDGED, RETURNED, SUPPRESSED, SHELVED, OUT_OF_SERVICE = AlarmState
OK, HIGH, LOW, FAULT = EventState
ACK = "ack"
REQUESTS = {
    "ack": AlarmTransition.ACKNOWLEDGE,
    "shelve": AlarmTransition.SHELVE,
    "unshelve": AlarmTransition.UNSHELVE,
    "remove": AlarmTransition.REMOVE_FROM_SERVICE,
    "return": AlarmTransition.RETURN_TO_SERVICE,
}


def run(limits: Limits, *steps: object, needs_acknowledgment: bool = True) -> list[tuple[EventState, AlarmState]]:
    """The states after each step; a step is a value, (value, "inhibited" or "suppressed"), or a request."""
    alarm, states, number = Alarm(limits, needs_acknowledgment), [], 0
    for step in steps:
        if step in REQUESTS:
            alarm.request(REQUESTS[step])  # type: ignore[index]
        else:
            value, word = step if isinstance(step, tuple) else (step, "")
            alarm.update(float(value), number, inhibited=word == "inhibited", suppressed=word == "suppressed")  # type: ignore[arg-type]
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
        # Set aside: the event state follows the value, the state does not.
        (["shelve", 27.0], (HIGH, SHELVED)),
        ([27.0, "shelve", 22.0], (OK, SHELVED)),
        ([27.0, "shelve", "unshelve"], (HIGH, ACTIVE)),
        ([27.0, ACK, "shelve", "unshelve"], (HIGH, ACTIVE)),  # whoever comes back must know of it
        ([27.0, "shelve", 22.0, "unshelve"], (OK, NORMAL)),
        ([27.0, 22.0, "shelve", "unshelve"], (OK, NORMAL)),
        (["shelve", "shelve", "unshelve"], (OK, NORMAL)),
        (["remove", nan], (FAULT, OUT_OF_SERVICE)),
        (["remove", nan, "return"], (FAULT, ACTIVE)),
        (["shelve", "remove", "return"], (OK, NORMAL)),
        ([(27.0, "suppressed")], (HIGH, SUPPRESSED)),
        ([27.0, (27.0, "suppressed")], (HIGH, SUPPRESSED)),
        ([(27.0, "suppressed"), 27.0], (HIGH, ACTIVE)),
        ([(27.0, "suppressed"), 22.0], (OK, NORMAL)),
        ([(27.0, "suppressed"), "shelve", 27.0], (HIGH, SHELVED)),
        ([(27.0, "suppressed"), "shelve", "unshelve"], (HIGH, SUPPRESSED)),
        (["shelve", (27.0, "suppressed"), "unshelve"], (HIGH, SUPPRESSED)),
        (["remove", (22.0, "suppressed"), "return", 22.0], (OK, NORMAL)),
    ],
)
def test_alarms__schedules(schedule: list[object], state: tuple[EventState, AlarmState]) -> None:
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


def test_alarms__event_needs_no_acknowledgment() -> None:
    states = [state for _, state in run(LIMITS, 27, 24, 27, needs_acknowledgment=False)]
    assert states == [ACKNOWLEDGED, NORMAL, ACKNOWLEDGED]


@given(st.lists(st.sampled_from([*AlarmTransition]), max_size=30))
def test_the_table__keeps_the_meaning_of_each_state(triggers: list[AlarmTransition]) -> None:
    """Two facts, kept beside the table, are what each state stands for."""
    state, is_off, is_acknowledged = NORMAL, False, True
    for trigger in triggers:
        if (state, trigger) not in TRANSITIONS or TRANSITIONS[state, trigger] in SET_ASIDE:
            continue
        state = TRANSITIONS[state, trigger]
        if trigger is AlarmTransition.ACKNOWLEDGE:
            is_acknowledged = True
        else:
            is_off = trigger is not AlarmTransition.TO_NORMAL
            is_acknowledged = is_acknowledged and not is_off
        expected = {(False, True): NORMAL, (True, False): ACTIVE, (True, True): ACKNOWLEDGED, (False, False): RETURNED}
        assert state is expected[is_off, is_acknowledged]


def documented_table() -> dict[tuple[str, str], str]:
    """The two tables of the module's docstring."""
    rows: dict[tuple[str, str], str] = {}
    for block in re.findall(r"^    state .*\n(?:    \w.*\n)+", state_machine.__doc__ + "\n", re.M):
        head, *lines = block.splitlines()
        columns = [(match.start(), match[0].split(", ")) for match in re.finditer(r"\w+(?:, \w+)*", head)][1:]
        for line in lines:
            cells = {match.start(): match[0] for match in re.finditer(r"\w+", line)}
            state = cells.pop(4)
            for start, transitions in columns:
                if start in cells:
                    rows |= {(state, transition): cells[start] for transition in transitions}
    return rows


def test_alarms__docstring_has_the_table() -> None:
    entering = {AlarmTransition.SUPPRESS, AlarmTransition.SHELVE, AlarmTransition.REMOVE_FROM_SERVICE}
    to_value = {AlarmTransition.TO_OFFNORMAL, AlarmTransition.TO_FAULT, AlarmTransition.TO_NORMAL}
    rest = {
        (str(state), str(transition)): str(target)
        for (state, transition), target in TRANSITIONS.items()
        if not (state in ALERTING and transition in entering) and not (state in SET_ASIDE and transition in to_value)
    }
    assert documented_table() == rest
    for state in ALERTING:
        assert [TRANSITIONS[state, t] for t in sorted(entering)] == [OUT_OF_SERVICE, SHELVED, SUPPRESSED]
    for state in SET_ASIDE:
        assert {TRANSITIONS[state, t] for t in to_value} == {state}


STEPS = st.lists(
    st.tuples(st.floats(10, 35) | st.just(nan), st.booleans()) | st.sampled_from([*REQUESTS]) | st.integers(1, 5),
    max_size=40,
)


@given(STEPS, st.integers(0, 3))
def test_setting_aside__never_changes_what_the_value_is_and_never_hides_it_afterwards(
    steps: list[object], delay: int
) -> None:
    """Event states are those of an alarm that nobody sets aside; where it alerts, no off-normal value is normal."""
    limits = Limits(18.0, 26.0, 0.5, delay, delay)
    alarm, plain, number = Alarm(limits), Alarm(limits), 0
    for step in steps:
        if isinstance(step, tuple):
            alarm.update(step[0], number, suppressed=step[1])
            plain.update(step[0], number)
            number += 1
        elif isinstance(step, int):
            if alarm.allows(AlarmTransition.SHELVE):
                alarm.request(AlarmTransition.SHELVE, number - 1 + step)
        elif alarm.allows(REQUESTS[step]):
            alarm.request(REQUESTS[step])
        assert alarm.event_state is plain.event_state
        assert (alarm.state in (ACTIVE, ACKNOWLEDGED)) == (alarm.state in ALERTING and alarm.event_state is not OK)
        assert alarm.state is not SUPPRESSED or alarm.suppressed
        assert not alarm.suppressed or alarm.state in SET_ASIDE
        assert alarm.until is None or (alarm.state in (SHELVED, OUT_OF_SERVICE) and alarm.until > number - 1)


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
