"""The rules of several slots: who stands still, who begins anew, what holds and goes along. No bus, no EnergyPlus."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.builders import NAN, answer, claim, command, exchange, ruling

from zenostat.bridge.exchange.priority_array import PRIORITIES, PriorityArray
from zenostat.bridge.exchange.step_exchange import StepExchange
from zenostat.bridge.node.episodes import seeds_of
from zenostat.topics.errors import RequestRejected
from zenostat.topics.messages import Command, CommandOp, EventKind, Mode, Reset, State, Write

KEEP, SET, RELEASE = CommandOp.KEEP, CommandOp.SET, CommandOp.RELINQUISH


def answers(at: StepExchange, controller: str, slots: dict[int, tuple[float, float]]) -> object:
    """The controller answers these slots and leaves the others out."""
    values = [v for slot in range(at.slots) for v in slots.get(slot, (0.0, 0.0))]
    steps = [step if slot in slots else None for slot, step in enumerate(at.step)]
    return at.intake.command(
        controller,
        Command(episode=at.episode, step=steps, operations=None, values=np.array(values, "<f8").tobytes()),
        0.0,
    )


def go(at: StepExchange, last: tuple[int, ...] = ()) -> tuple[list[int], np.ndarray]:
    """One timestep: who moved, and what ruled, shape (slots, actuators)."""
    assert at.ready_to_step(), at.awaiting()
    values = at.begin_step(0.0)
    moving = [*at.active_slots]
    at.finish_step([slot in last for slot in moving], 0.0)
    return moving, np.frombuffer(values).reshape(at.shape)


def three() -> StepExchange:
    at = exchange(slots=3)
    claim(at, "agent")
    return at


# Standing still


def test_step_exchange__slot_that_is_not_answered_hangs_and_keeps_what_it_had() -> None:
    at = three()
    assert answer(at, "agent", [20.0, 25.0] * 3) is None
    assert go(at)[0] == [0, 1, 2]
    assert answers(at, "agent", {0: (21.0, 26.0), 2: (22.0, 27.0)}) is None
    moving, values = go(at)
    assert moving == [0, 2]
    assert values.tolist() == [[21.0, 26.0], [20.0, 25.0], [22.0, 27.0]]
    assert (at.step, at.state) == ([2, 1, 2], State.WAITING)
    assert answer(at, "agent", [20.0, 25.0] * 3) is None
    assert go(at)[0] == [0, 1, 2]
    assert at.step == [3, 2, 3]


def test_step_exchange__value_for_a_slot_that_does_not_advance_is_not_looked_at() -> None:
    """Not even whether it is within its bounds; in a slot that moves it is."""
    at = three()
    steps, values = [0, None, 0], np.array([20.0, 25.0, 1e9, NAN, 20.0, 25.0])
    assert (
        at.intake.command("agent", Command(episode=[0] * 3, step=steps, values=values.astype("<f8").tobytes()), 0.0)
        is None
    )
    assert go(at)[0] == [0, 2]
    event = answers(at, "agent", {1: (20.0, 99.0)})
    assert event.kind is EventKind.REJECTED
    assert "99" in event.text
    assert not at.ready_to_step()


def test_step_exchange__no_slot_at_all_is_no_answer() -> None:
    at = three()
    event = answers(at, "agent", {})
    assert event.kind is EventKind.REJECTED
    assert not at.ready_to_step()


def test_step_exchange__slots_that_any_required_controller_answers_move() -> None:
    """A helper's answer sets its values, yet moves nobody."""
    at = three()
    claim(at, "second", 9, actuators=["heat"])
    claim(at, "helper", 8, actuators=["heat"], required=False)
    assert answers(at, "agent", {0: (20.0, 25.0)}) is None
    assert not at.ready_to_step()
    operations = bytes([KEEP, KEEP, SET, KEEP, SET, KEEP])
    both = np.array([0.0, 0.0, 21.0, 0.0, 22.0, 0.0]).tobytes()
    assert (
        at.intake.command(
            "second", Command(episode=[0] * 3, step=[None, 0, None], operations=operations, values=both), 0.0
        )
        is None
    )
    at2 = at.ready_to_step()
    assert at2
    assert (
        at.intake.command(
            "helper", Command(episode=[0] * 3, step=[None, None, 0], operations=operations, values=both), 0.0
        )
        is None
    )
    moving, values = go(at)
    assert moving == [0, 1]
    np.testing.assert_array_equal(values, [[20.0, 25.0], [21.0, NAN], [22.0, NAN]])
    assert at.step == [1, 1, 0]


def test_step_exchange__slot_stays_if_the_claim_is_renewed_by_whom_alone_it_was_answered() -> None:
    at = exchange(slots=2)
    claim(at, "agent", 10)
    claim(at, "guard", 5)
    assert answers(at, "agent", {0: (21.0, 26.0)}) is None
    claim(at, "agent", 10)
    for name in ("agent", "guard"):
        assert answers(at, name, {1: (22.0, 27.0)}) is None
    assert go(at)[0] == [1]
    assert answer(at, "guard", [20.0, 25.0] * 2) is None
    claim(at, "agent", 10)
    assert answers(at, "agent", {1: (22.0, 27.0)}) is None
    assert go(at)[0] == [0, 1], "the other one's answer is as it was"


@pytest.mark.parametrize("wrong", [(1, 0), (0, 1)], ids=["a later step", "a later episode"])
def test_step_exchange__only_the_slots_that_are_answered_are_compared_with_the_present(wrong: tuple[int, int]) -> None:
    at = three()
    assert answers(at, "agent", {0: (20.0, 25.0)}) is None
    go(at)
    step, episode = wrong
    command = Command(episode=[0, 7, 0], step=[1, None, 0], values=np.array([20.0, 25.0] * 3).tobytes())
    assert at.intake.command("agent", command, 0.0) is None
    go(at)
    command = Command(episode=[0, episode, 0], step=[None, step, 1], values=np.array([20.0, 25.0] * 3).tobytes())
    event = at.intake.command("agent", command, 0.0)
    assert event.kind is EventKind.REJECTED
    assert at.step == [2, 0, 1]


def test_step_exchange__slot_that_was_left_behind_is_late_only_where_all_are() -> None:
    at = three()
    answer(at, "agent", [20.0, 25.0] * 3)
    go(at)
    answers(at, "agent", {0: (20.0, 25.0)})
    go(at)
    late = at.intake.command("agent", command([20.0, 25.0] * 3, step=[1, 1, 1], episode=[0] * 3), 0.0)
    assert late.kind is EventKind.LATE
    mixed = at.intake.command("agent", command([20.0, 25.0] * 3, step=[1, 2, 1], episode=[0] * 3), 0.0)
    assert mixed.kind is EventKind.REJECTED
    assert (at.counts.late, at.counts.rejected) == (1, 1)


# Ends and beginnings


def test_step_exchange__exchange_ends_with_its_last_slot() -> None:
    at = three()
    answer(at, "agent", [20.0, 25.0] * 3)
    go(at, last=(1,))
    assert (at.state, at.done) == (State.WAITING, [False, True, False])
    event = answer(at, "agent", [20.0, 25.0] * 3)
    assert "slot 1 is over" in event.text
    assert answers(at, "agent", {0: (20.0, 25.0), 2: (20.0, 25.0)}) is None
    assert go(at, last=(0,))[0] == [0, 2]
    assert answers(at, "agent", {2: (20.0, 25.0)}) is None
    assert go(at, last=(2,))[0] == [2]
    assert (at.state, at.step) == (State.ENDED, [2, 1, 3])


def test_finished_slot__awaits_no_command() -> None:
    """Free mode moves all that are not."""
    at = exchange(slots=2, mode=Mode.FREE)
    assert go(at, last=(0,))[0] == [0, 1]
    assert go(at)[0] == [1]
    assert at.step == [1, 2]


def test_step_exchange__slot_begins_anew_while_the_others_stand() -> None:
    at = three()
    answer(at, "agent", [20.0, 25.0] * 3)
    go(at, last=(1,))
    at.reset([1])
    assert at.state is State.STARTING
    at.ready(0.0, {1: 0})
    assert (at.episode, at.step, at.done) == ([0, 1, 0], [1, 0, 1], [False] * 3)
    assert at.modified == [True, False, True]
    assert at.awaiting() == ["agent"]
    values, sources = ruling(at)
    np.testing.assert_array_equal(values, [20.0, 25.0, NAN, NAN, 20.0, 25.0])
    assert sources == ["agent", "agent", "", "", "agent", "agent"]
    assert answer(at, "agent", [21.0, 26.0] * 3) is None
    assert go(at)[0] == [0, 1, 2]
    assert at.step == [2, 1, 2]


def test_step_exchange__answer_from_before_another_slot_began_anew_is_given_again() -> None:
    """The sample is published again; what was answered to the former one moves nobody."""
    at = three()
    assert answers(at, "agent", {0: (20.0, 25.0)}) is None
    assert at.ready_to_step()
    at.reset([1])
    at.ready(0.0, {1: 0})
    assert not at.ready_to_step()
    event = at.intake.command("agent", command([20.0, 25.0] * 3, step=[0, 0, 0], episode=[0, 0, 0]), 0.0)
    assert event is not None
    assert at.awaiting() == ["agent"]
    assert answers(at, "agent", {2: (20.0, 25.0)}) is None
    assert go(at)[0] == [2]


def test_step_exchange__when_all_are_over_one_may_begin_anew() -> None:
    at = three()
    answer(at, "agent", [20.0, 25.0] * 3)
    go(at, last=(0, 1, 2))
    assert at.state is State.ENDED
    at.reset([2])
    at.ready(0.0, {2: 0})
    assert (at.state, at.done, at.step) == (State.WAITING, [True, True, False], [1, 1, 0])
    assert answers(at, "agent", {2: (20.0, 25.0)}) is None
    assert go(at, last=(2,))[0] == [2]
    assert at.state is State.ENDED


@pytest.mark.parametrize("slots", [None, [0, 1, 2], [2, 0, 1, 1]])
def test_step_exchange__all_slots_begin_anew_by_any_name_of_them(slots: list[int] | None) -> None:
    at = three()
    answer(at, "agent", [20.0, 25.0] * 3)
    at.intake.write("heat", Write(value=18.0, priority=8, duration_s=1e6), 0.0)
    go(at)
    at.fallback.on_disconnect("agent", 0.0)
    at.reset(slots)
    at.ready(0.0)
    assert (at.episode, at.step, at.commands.has_expiries, at.controllers()) == ([1] * 3, [0] * 3, False, [])
    assert ruling(at)[1] == [""] * 6


def test_step_exchange__written_value_outlives_the_beginning_of_one_slot_elsewhere() -> None:
    at = exchange(slots=2)
    claim(at, "agent")
    at.intake.write("heat", Write(value=18.0, priority=8), 0.0)
    at.reset([0])
    at.ready(0.0, {0: 0})
    np.testing.assert_array_equal(ruling(at)[0], [NAN, NAN, 18.0, NAN])


# What holds, kept and gone back to


def held() -> StepExchange:
    """Three slots that differ, with a value that expires after 1,800 s, at step 2."""
    at = three()
    answer(at, "agent", [20.0, 25.0] * 3)
    go(at)
    at.intake.write("cool", Write(value=29.0, priority=8, duration_s=1800.0, source="person"), 900.0)
    answers(at, "agent", {1: (21.0, 26.0)})
    go(at)
    return at


def test_step_exchange__what_held_holds_again_and_what_came_later_does_not() -> None:
    at = held()
    kept, before = at.capture(), ruling(at)
    answer(at, "agent", [22.0, 30.0] * 3)
    at.intake.write("heat", Write(value=15.0, priority=1, source="late"), 1800.0)
    at.intake.write("cool", Write(value=None, priority=8, source="person"), 1800.0)
    go(at)
    assert not at.commands.has_expiries
    for _ in range(2):
        at.reset()
        at.ready(0.0, {0: 1, 1: 2, 2: 1}, kept)
        assert str(ruling(at)) == str(before)
        assert at.commands.has_expiries
        assert at.modified == [True] * 3
        assert [event.kind for event in at.intake.expire(2700.0)] == [EventKind.EXPIRED]
        assert ruling(at)[0] == [20.0, 25.0, 21.0, 26.0, 20.0, 25.0]
        answer(at, "agent", [22.0, 30.0] * 3)
        go(at)


def test_step_exchange__whoever_claimed_since_keeps_its_claim_and_rules_under_its_own_name() -> None:
    """The names of who rules go back, too; a newcomer's is added to them."""
    at = held()
    kept = at.capture()
    claim(at, "newcomer", 9)
    for name in ("agent", "newcomer"):
        answer(at, name, [22.0, 30.0] * 3)
    go(at)
    at.reset()
    at.ready(0.0, commands=kept)
    assert at.awaiting() == ["agent", "newcomer"]
    answer(at, "newcomer", [16.0, 24.0] * 3, [SET, KEEP] * 3)
    answer(at, "agent", [0.0, 0.0] * 3, [KEEP, KEEP] * 3)
    assert ruling(at) == ([16.0, 29.0] * 3, ["newcomer", "person"] * 3)


def commanded(at: StepExchange) -> list[list[float]]:
    """The commands that samples report, shape (slots, actuators)."""
    return np.frombuffer(at.commanded).reshape(at.shape).tolist()


def test_step_exchange__samples_report_the_commands_of_each_slots_latest_timestep() -> None:
    at = three()
    assert np.isnan(commanded(at)).all()
    answer(at, "agent", [20.0, 25.0] * 3)
    go(at)
    assert commanded(at) == [[20.0, 25.0]] * 3
    answers(at, "agent", {1: (21.0, 26.0)})
    go(at)
    kept = at.capture()
    assert commanded(at) == [[20.0, 25.0], [21.0, 26.0], [20.0, 25.0]]
    at.reset([0])
    at.ready(0.0, {0: 0})
    assert np.isnan(commanded(at)[0]).all()
    assert commanded(at)[1:] == [[21.0, 26.0], [20.0, 25.0]]
    at.reset()
    assert np.isnan(commanded(at)).all()
    at.ready(0.0, {0: 1, 1: 2, 2: 1}, kept)
    assert commanded(at) == [[20.0, 25.0], [21.0, 26.0], [20.0, 25.0]]
    branch = exchange(slots=2)
    branch.reset()
    branch.ready(0.0, {0: 2, 1: 2}, kept.of_slot(1, 2))
    assert commanded(branch) == [[21.0, 26.0]] * 2


def test_step_exchange__what_held_in_one_slot_goes_along_to_as_many_as_are_wanted() -> None:
    at = held()
    for slot, expected in enumerate([[20.0, 29.0], [21.0, 29.0], [20.0, 29.0]]):
        branch = exchange(slots=2)
        branch.reset()
        branch.ready(0.0, {0: 2, 1: 2}, at.capture().of_slot(slot, 2))
        assert ruling(branch) == (expected * 2, ["agent", "person"] * 2)
        claim(branch, "other")
        answer(branch, "other", [15.5, 22.5] * 2)
        branch.intake.expire(2700.0)
        assert ruling(branch) == ([15.5, 22.5] * 2, ["other"] * 4)
    assert ruling(at)[0] == [20.0, 29.0, 21.0, 29.0, 20.0, 29.0]


def test_step_exchange__what_is_written_for_a_time_holds_so_long_whichever_slot_begins_anew_or_is_over() -> None:
    """Its clock is the node's, not a slot's: it counts the timesteps since all slots began."""
    at = three()
    for _ in range(4):
        answer(at, "agent", [20.0, 25.0] * 3)
        go(at)
    at.intake.write(
        "cool", Write(value=29.0, priority=8, duration_s=1800.0, source="person"), 900.0 * at.commands.timesteps
    )
    at.reset([0])
    at.ready(0.0, {0: 0})
    kept = at.capture()
    for _ in range(2):
        assert at.intake.expire(900.0 * at.commands.timesteps) == []
        answer(at, "agent", [20.0, 25.0] * 3)
        go(at)
    assert [event.kind for event in at.intake.expire(900.0 * at.commands.timesteps)] == [EventKind.EXPIRED]
    for branch, slot in ((exchange(slots=3), None), (exchange(slots=1), 1)):
        branch.reset()
        branch.ready(0.0, commands=kept if slot is None else kept.of_slot(slot, 1))
        assert branch.intake.expire(900.0 * branch.commands.timesteps) == []
        assert branch.commands.has_expiries
        assert [event.kind for event in branch.intake.expire(900.0 * (branch.commands.timesteps + 2))] == [
            EventKind.EXPIRED
        ]
    at.reset()
    assert at.commands.timesteps == 0


SLOTS, ACTUATORS = 3, 2
rows = st.lists(
    st.tuples(
        st.integers(1, PRIORITIES),
        st.sampled_from("abc"),
        st.lists(st.floats(-9, 9) | st.just(NAN), min_size=SLOTS * ACTUATORS, max_size=SLOTS * ACTUATORS),
        st.lists(st.booleans(), min_size=SLOTS * ACTUATORS, max_size=SLOTS * ACTUATORS),
    ),
    max_size=6,
)


def arrays(puts: list[tuple[int, str, list[float], list[bool]]]) -> PriorityArray:
    array = PriorityArray(SLOTS, ACTUATORS)
    put_in(array, puts)
    return array


def put_in(array: PriorityArray, puts: list[tuple[int, str, list[float], list[bool]]]) -> None:
    for priority, name, values, where in puts:
        source = array.source(name)
        if all(where) and np.isfinite(values).all():
            array.put_all(priority, source, np.array(values).tobytes())
        else:
            shape = (SLOTS, ACTUATORS)
            array.put(priority, source, np.array(values).reshape(shape), np.array(where).reshape(shape))


def resolved(array: PriorityArray) -> list[list[tuple[str, str]]]:
    """By slot and actuator, what rules and who set it."""
    values, sources = array.resolve()
    cells = [
        (repr(v), array.names[w])
        for v, w in zip(np.frombuffer(values).tolist(), np.frombuffer(sources, "<u2"), strict=True)
    ]
    return [cells[i : i + ACTUATORS] for i in range(0, len(cells), ACTUATORS)]


@given(rows, rows)
def test_step_exchange__copy_is_the_same_and_on_its_own(before: list, after: list) -> None:
    array, twin = arrays(before), arrays(before)
    copy = array.copy()
    assert resolved(copy) == resolved(array)
    put_in(array, after)
    assert resolved(copy) == resolved(twin)
    put_in(copy, after)
    assert resolved(copy) == resolved(array)
    array.restore(twin)
    assert resolved(array) == resolved(twin)


@given(rows, rows, st.integers(0, SLOTS - 1))
def test_step_exchange__slots_part_rules_as_that_slot_does(before: list, after: list, slot: int) -> None:
    array = arrays(before)
    part = array.of_slot(slot, SLOTS)
    assert resolved(part) == [resolved(array)[slot]] * SLOTS
    put_in(part, after)
    assert resolved(array) == resolved(arrays(before))


@given(rows, st.sets(st.integers(0, SLOTS - 1), min_size=1))
def test_step_exchange__releasing_slots_leaves_the_others_as_they_are(puts: list, slots: set[int]) -> None:
    array = arrays(puts)
    expected = [[("nan", "")] * ACTUATORS if slot in slots else row for slot, row in enumerate(resolved(array))]
    array.relinquish_slots(sorted(slots))
    assert resolved(array) == expected


def test_step_exchange__source_s_place_is_given_on_once_nothing_of_it_holds() -> None:
    """Three hundred who each write and release, one after another: the one who rules is told by its own name."""
    array = PriorityArray(1, 2)
    holder = array.source("holder")
    array.put_one(5, holder, 0, 21.0)
    for number in range(300):
        source = array.source(f"w{number}", keeping=[array.source("quiet claimant")])
        array.put_one(8, source, 1, float(number))
        _, sources = array.resolve()
        assert [array.names[index] for index in np.frombuffer(sources, "<u2")] == ["holder", f"w{number}"]
        array.put_one(8, source, 1, np.nan)
    assert array.names[array.source("quiet claimant")] == "quiet claimant"
    assert len(array.names) == 256


def test_priority_array__names_each_of_many_sources() -> None:
    array = PriorityArray(1, 300)
    for number in range(300):
        array.put_one(8, array.source(f"w{number}"), number, 1.0)
    names = [array.names[index] for index in np.frombuffer(array.resolve()[1], "<u2")]
    assert names == [f"w{number}" for number in range(300)]


@pytest.mark.parametrize("slots", [1, 2])
def test_seeds__of_consecutive_slots_stay_below_the_number_of_seeds(slots: int) -> None:
    largest = 2**64 - slots
    assert seeds_of(Reset(seed=largest), slots) == [largest + index for index in range(slots)]
    if slots > 1:
        with pytest.raises(RequestRejected, match=r"slot 1 would have 18446744073709551616, above 2\*\*64 - 1"):
            seeds_of(Reset(seed=largest + 1), slots)
