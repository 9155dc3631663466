"""The step exchange as schedules: who spoke when, and what ruled. No bus, no EnergyPlus, no clock."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.builders import NAN, actuator, advance, answer, claim, command, exchange, ruling, wire
from support.examples import examples

from zenostat.bridge.exchange.step_exchange import TRANSITIONS, IllegalTransition, StepExchange, Trigger
from zenostat.topics import codec
from zenostat.topics.errors import RequestRejected
from zenostat.topics.messages import Command, CommandOp, ControllerState, Event, EventKind, Mode, State, Write

KEEP, SET, RELEASE = CommandOp.KEEP, CommandOp.SET, CommandOp.RELINQUISH


def check_event(event: Event | None, kind: EventKind, *words: str) -> None:
    """The event is of that kind and its text has those words."""
    assert event is not None
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


# The table


PAIRS = [(state, what) for state in State for what in Trigger]


@pytest.mark.parametrize(("state", "what"), PAIRS, ids=lambda p: p.value)
def test_a_pair_has_a_row_or_is_illegal(state: State, what: Trigger) -> None:
    at = StepExchange((), state=state)
    if (state, what) in TRANSITIONS:
        at.transition(what)
        assert at.state is TRANSITIONS[state, what]
        return
    with pytest.raises(IllegalTransition) as raised:
        at.transition(what)
    assert state.value in str(raised.value)
    assert what.value in str(raised.value)
    assert at.state is state


def test_the_table_is_that_of_the_drawing() -> None:
    """Written out by hand from the module's drawing: each state, what may happen, where it leads."""
    drawn = {
        State.STARTING: {Trigger.READY: State.WAITING, Trigger.FAIL: State.FAILED, Trigger.STOP: State.STOPPED},
        State.WAITING: {
            Trigger.GO: State.RUNNING, Trigger.RESET: State.STARTING, Trigger.FAIL: State.FAILED,
            Trigger.STOP: State.STOPPED,
        },
        State.RUNNING: {
            Trigger.SAMPLED: State.WAITING, Trigger.ENDED: State.ENDED, Trigger.FAIL: State.FAILED,
            Trigger.STOP: State.STOPPED,
        },
        State.ENDED: {Trigger.RESET: State.STARTING, Trigger.STOP: State.STOPPED},
        State.FAILED: {Trigger.RESET: State.STARTING, Trigger.STOP: State.STOPPED},
        State.STOPPED: {},
    }  # fmt: skip
    assert {(state, what): to for state, row in drawn.items() for what, to in row.items()} == TRANSITIONS


def test_an_illegal_call_changes_nothing() -> None:
    at, other = exchange(), exchange()
    other.intake.write("heat", Write(value=20.0), 0.0)
    captured = other.capture()
    for call in (lambda: at.finish_step([False], 0.0), lambda: at.ready(0.0), lambda: at.ready(0.0, commands=captured)):
        with pytest.raises(IllegalTransition):
            call()
    assert (at.state, at.step) == (State.WAITING, [0])
    assert same(ruling(at)[0], [NAN, NAN])
    claim(at, "a")
    answer(at, "a", [20.0, 25.0])
    at.begin_step(0.0)
    for call in (lambda: at.begin_step(0.0), at.reset, lambda: at.ready(0.0)):
        with pytest.raises(IllegalTransition):
            call()
    assert (at.state, at.step, at.episode) == (State.RUNNING, [0], [0])


# Lockstep


@pytest.mark.parametrize("steps", [1, 2, 24])
def test_an_episode_of_n_timesteps_has_n_commands_and_n_plus_1_samples(steps: int) -> None:
    # node@0 -> agent@0 -> node@1 -> agent@1 -> ... -> node@N
    at = exchange()
    claim(at, "agent")
    samples, applied = [at.step[0]], []
    while at.state is State.WAITING:
        k = at.step[0]
        assert answer(at, "agent", [20.0, 25.0 + k / 100]) is None
        applied.append(advance(at, last=k + 1 == steps))
        samples.append(at.step[0])
    assert samples == list(range(steps + 1))
    assert applied == [([20.0, 25.0 + k / 100], ["agent", "agent"]) for k in range(steps)]
    assert at.counts.accepted == steps
    assert at.state is State.ENDED
    assert not at.ready_to_step()


def test_nothing_goes_on_without_a_required_controller() -> None:
    at = exchange()
    assert not at.ready_to_step()
    claim(at, "helper", 12, required=False)
    assert answer(at, "helper", [20.0, 25.0]) is None
    assert not at.ready_to_step()


def test_each_required_controller_is_waited_for() -> None:
    # node@0 -> heater@0 -> (waits) -> cooler@0 -> node@1 -> cooler@1 -> (waits) -> heater@1 -> node@2
    at = exchange()
    claim(at, "heater", actuators=["heat"])
    claim(at, "cooler", actuators=["cool"])
    assert at.awaiting() == ["cooler", "heater"]
    assert answer(at, "heater", [20.0, 0.0], [SET, KEEP]) is None
    assert not at.ready_to_step()
    assert at.awaiting() == ["cooler"]
    assert answer(at, "cooler", [0.0, 25.0], [KEEP, SET]) is None
    assert advance(at) == ([20.0, 25.0], ["heater", "cooler"])
    assert answer(at, "cooler", [0.0, 26.0], [KEEP, SET]) is None
    assert not at.ready_to_step()
    assert at.awaiting() == ["heater"]
    assert answer(at, "heater", [0.0, 0.0], [KEEP, KEEP]) is None
    assert advance(at) == ([20.0, 26.0], ["heater", "cooler"])


def test_one_that_is_not_required_is_heard_but_not_waited_for() -> None:
    # node@0 -> agent@0 -> node@1 -> helper@1 -> agent@1 -> node@2
    at = exchange()
    claim(at, "agent", 10)
    claim(at, "helper", 9, required=False)
    answer(at, "agent", [20.0, 25.0])
    assert advance(at) == ([20.0, 25.0], ["agent", "agent"])
    assert answer(at, "helper", [16.0, 29.0]) is None
    answer(at, "agent", [20.0, 25.0])
    assert advance(at) == ([16.0, 29.0], ["helper", "helper"])


def test_a_command_rules_until_the_next_one() -> None:
    at = exchange()
    claim(at, "agent")
    answer(at, "agent", [20.0, 25.0])
    advance(at)
    answer(at, "agent", [0.0, 0.0], [KEEP, KEEP])
    assert advance(at) == ([20.0, 25.0], ["agent", "agent"])


def test_a_mask_sets_keeps_and_releases() -> None:
    at = exchange(actuator("a"), actuator("b"), actuator("c"))
    claim(at, "agent")
    answer(at, "agent", [1.0, 2.0, 3.0])
    advance(at)
    answer(at, "agent", [10.0, 20.0, 30.0], [SET, KEEP, RELEASE])
    values, sources = advance(at)
    assert same(values, [10.0, 2.0, NAN])
    assert sources == ["agent", "agent", ""]


def test_what_a_mask_does_not_set_is_not_looked_at() -> None:
    at = exchange()
    claim(at, "agent")
    assert answer(at, "agent", [math.inf, 25.0], [KEEP, SET]) is None
    values, _ = advance(at)
    assert same(values, [NAN, 25.0])


def test_slots_are_commanded_apart() -> None:
    at = exchange(slots=2)
    claim(at, "agent")
    assert at.intake.command("agent", command([16.0, 23.0, 17.0, 24.0], step=[0, 0], episode=[0, 0]), 0.0) is None
    assert advance(at) == ([16.0, 23.0, 17.0, 24.0], ["agent"] * 4)
    assert at.step == [1, 1]
    operations = [KEEP, KEEP, RELEASE, SET]
    assert (
        at.intake.command("agent", command([0, 0, 0, 28.0], step=[1, 1], episode=[0, 0], operations=operations), 0.0)
        is None
    )
    values, sources = advance(at)
    assert same(values, [16.0, 23.0, NAN, 28.0])
    assert sources == ["agent", "agent", "", "agent"]


def test_the_bounds_themselves_are_within() -> None:
    at = exchange()
    claim(at, "agent")
    assert answer(at, "agent", [15.0, 30.0]) is None
    advance(at)
    assert answer(at, "agent", [22.5, 22.5]) is None
    assert advance(at) == ([22.5, 22.5], ["agent", "agent"])


# What is not taken changes nothing


def running() -> StepExchange:
    """At sample 2 of episode 0; `agent` has still to answer, `helper` (whose level rules) need not."""
    at = exchange()
    claim(at, "agent", 10)
    claim(at, "helper", 9, actuators=["cool"], required=False)
    for _ in range(2):
        answer(at, "agent", [20.0, 25.0])
        advance(at)
    return at


@pytest.mark.parametrize("step", [0, 1])
def test_an_answer_to_a_step_that_is_over_is_late(step: int) -> None:
    at = running()
    event = unchanged(at, lambda: at.intake.command("agent", command([21.0, 26.0], step=step), 0.0), count="late")
    check_event(event, EventKind.LATE, f"[{step}]", "[2]")
    assert (event.source, event.episode, event.step) == ("agent", 0, 2)


def test_an_answer_to_an_episode_that_is_over_is_late() -> None:
    at = running()
    at.reset()
    at.ready(0.0)
    event = unchanged(
        at, lambda: at.intake.command("agent", command([21.0, 26.0], step=2, episode=0), 0.0), count="late"
    )
    check_event(event, EventKind.LATE, "episode [0] step [2]", "episode [1] step [0]")


def test_a_second_answer_is_a_duplicate() -> None:
    at = running()
    claim(at, "second", 11)  # is waited for, so that the node stays at sample 2
    answer(at, "agent", [20.0, 25.0])
    event = unchanged(at, lambda: answer(at, "agent", [21.0, 26.0]), count="duplicate")
    check_event(event, EventKind.DUPLICATE, "already answered")
    assert event.source == "agent"


def test_a_second_answer_of_one_that_is_not_required_is_a_duplicate_too() -> None:
    at = running()
    assert answer(at, "helper", [0.0, 28.0], [KEEP, SET]) is None
    event = unchanged(at, lambda: answer(at, "helper", [0.0, 29.0], [KEEP, SET]), count="duplicate")
    check_event(event, EventKind.DUPLICATE)


def test_an_answer_to_the_last_sample_is_a_duplicate_of_nothing_that_rules() -> None:
    at = running()
    answer(at, "agent", [20.0, 25.0])
    advance(at, last=True)
    event = unchanged(at, lambda: answer(at, "agent", [21.0, 26.0]), count="duplicate")
    check_event(event, EventKind.DUPLICATE, "episode is over")
    assert at.state is State.ENDED


WRONG = {
    "by a stranger": ("stranger", command([20.0, 25.0], step=2), ["'stranger'", "claim first"]),
    "to a step to come": ("agent", command([20.0, 25.0], step=3), ["step [3]", "step [2]"]),
    "to an episode to come": ("agent", command([20.0, 25.0], step=2, episode=1), ["episode [1]", "episode [0]"]),
    "for two slots": ("agent", command([20.0, 25.0] * 2, step=[2, 2], episode=[0, 0]), ["[2, 2]", "[2]"]),
    "for no slot": ("agent", command([], step=[], episode=[]), ["[]"]),
    "with too few values": ("agent", command([20.0], step=2), ["8 bytes", "16 expected"]),
    "with too many values": ("agent", command([20.0, 25.0, 1.0], step=2), ["24 bytes", "16 expected"]),
    "with a value below its bounds": ("agent", command([14.9, 25.0], step=2), ["heat = 14.9", "15 to 22.5 degC"]),
    "with a value above its bounds": ("agent", command([20.0, 30.5], step=2), ["cool = 30.5", "22.5 to 30 degC"]),
    "with a NaN": ("agent", command([20.0, NAN], step=2), ["cool = nan"]),
    "with an infinity": ("agent", command([-math.inf, 25.0], step=2), ["heat = -inf"]),
    "with a short mask": (
        "agent", command([20.0, 25.0], step=2, operations=[SET]), ["operations has 1 bytes", "2 expected"]
    ),
    "with a long mask": (
        "agent", command([20.0, 25.0], step=2, operations=[SET] * 3), ["operations has 3 bytes", "2 expected"]
    ),
    "with an unknown mask": (
        "agent", command([20.0, 25.0], step=2, operations=[SET, 3]), ["operations has 3;", "relinquishes"]
    ),
    "of an actuator of another": ("helper", command([20.0, 25.0], step=2), ["'heat'", "claimed"]),
    "releasing another's": ("helper", command([0.0, 25.0], step=2, operations=[RELEASE, SET]), ["'heat'", "claimed"]),
    "out of bounds under a mask": ("helper", command([0.0, 99.0], step=2, operations=[KEEP, SET]), ["cool = 99"]),
}  # fmt: skip


@pytest.mark.parametrize(("controller", "sent", "words"), WRONG.values(), ids=WRONG)
def test_a_wrong_command_is_rejected_in_words(controller: str, sent: Command, words: list[str]) -> None:
    at = running()
    event = unchanged(at, lambda: at.intake.command(controller, sent, 0.0), count="rejected")
    check_event(event, EventKind.REJECTED, *words)
    assert event.source == controller
    assert answer(at, "agent", [20.0, 25.0]) is None  # the right answer is still taken
    assert at.ready_to_step()


@pytest.mark.parametrize("payload", [b"", b"\xc1", b"\x80", wire(command([20.0, 25.0], step=2))[:-1]])
def test_bytes_that_are_no_command_are_rejected(payload: bytes) -> None:
    at = running()
    assert unchanged(at, lambda: at.intake.accept_fast("agent", payload, 0.0), count="") is False
    check_event(
        unchanged(at, lambda: at.intake.receive_command("agent", payload, 0.0), count="rejected"), EventKind.REJECTED
    )


def test_a_command_of_another_version_is_rejected_by_name() -> None:
    at = running()
    payload, other = wire(command([20.0, 25.0], step=2)), "application/msgpack;zenostat/1.Command"
    assert unchanged(at, lambda: at.intake.accept_fast("agent", payload, 0.0, other), count="") is False
    event = unchanged(at, lambda: at.intake.receive_command("agent", payload, 0.0, other), count="rejected")
    check_event(event, EventKind.REJECTED, "zenostat/1.Command", "zenostat/2.Command")


def test_every_message_is_counted_once() -> None:
    at = running()
    before = at.counts.accepted
    claim(at, "second", 11)
    sent = [*([command([20.0, 25.0], step=2)] * 3), *([command([20.0, 25.0], step=1)] * 2)]
    sent += [command([20.0, NAN], step=2)] * 4
    for one in sent:
        at.intake.command("agent", one, 0.0)
    counts = at.counts
    # After its answer, whatever else the agent says of this step is a duplicate, right or wrong.
    assert (counts.accepted - before, counts.duplicate, counts.late, counts.rejected) == (1, 6, 2, 0)


# The fast path


UNUSUAL = [0.0, -0.0, 1.0, -1.0, math.nan, math.inf, -math.inf, 5e-324, 1.7976931348623157e308, 22.5, 15.0, 30.0]
numbers = st.sampled_from(UNUSUAL) | st.floats(14.0, 31.0) | st.floats()
BOUNDS = {
    "both": (actuator("heat", 15.0, 22.5), actuator("cool", 22.5, 30.0)),
    "zero": (actuator("heat", 0.0, 1.0), actuator("cool", -1.0, 0.0)),
    "minus zero": (actuator("heat", -0.0, 1.0), actuator("cool", -1.0, -0.0)),
    "none": (actuator("heat"), actuator("cool")),
    "one": (actuator("heat", 15.0, None), actuator("cool", None, 30.0)),
    "many": (
        actuator("heat", 0.0, 1.0),
        actuator("cool", None, 0.0),
        *(actuator(f"a{k}", 0.0, 1.0) for k in range(40)),
    ),
}


def state_text(at: StepExchange) -> str:
    """All that can be seen of an exchange."""
    array = [] if at.state is not State.WAITING else ruling(at)
    return repr((at.state, at.episode, at.step, at.counts, at.controllers(), at.awaiting(), at.ready_to_step(), array))


def inside(bounds: str) -> list[float]:
    """A value within each actuator's bounds."""
    return [next(b for b in (a.low, a.high, 0.0) if b is not None) for a in BOUNDS[bounds]]


def both_paths_agree(bounds: str, controller: str, sent: Command, *, times: int) -> None:
    """Sends the command at sample 1 by both paths: the same events, the same state."""
    at = exchange(*BOUNDS[bounds])
    claim(at, "agent", 10)
    claim(at, "helper", 11, required=False)
    claim(at, "part", 9, actuators=["cool"])
    count = len(BOUNDS[bounds])
    answer(at, "agent", [0.0] * count, [KEEP] * count)
    answer(at, "part", [0.0] * count, [KEEP] * count)
    advance(at)
    payload, slow, before = wire(sent), copy.deepcopy(at), state_text(at)
    for _ in range(times):
        expected = slow.intake.receive_command(controller, payload, 0.0)
        if at.intake.accept_fast(controller, payload, 0.0):
            event = None
        else:
            assert state_text(at) == before  # a no of the fast path changes nothing
            event = at.intake.receive_command(controller, payload, 0.0)
        assert event == expected
        assert state_text(at) == state_text(slow)
        before = state_text(at)


@settings(max_examples=examples(300), deadline=None)
@given(
    bounds=st.sampled_from(sorted(BOUNDS)),
    wrong=st.sets(st.sampled_from(["values", "values", "step", "episode", "operations"]), max_size=2),
    values=st.lists(numbers, min_size=1, max_size=3) | st.lists(numbers, min_size=2, max_size=2),
    step=st.sampled_from([0, 2]),
    operations=st.lists(st.integers(0, 3), min_size=1, max_size=3),
    controller=st.sampled_from(["agent", "agent", "helper", "part", "stranger"]),
    again=st.booleans(),
)
def test_the_fast_path_does_what_the_decoded_path_does(
    bounds: str,
    wrong: set[str],
    values: list[float],
    step: int,
    operations: list[CommandOp],
    controller: str,
    again: bool,
) -> None:
    sent = command(
        values if "values" in wrong else inside(bounds),
        step=step if "step" in wrong else 1,
        episode=1 if "episode" in wrong else 0,
        operations=operations if "operations" in wrong else None,
    )
    both_paths_agree(bounds, controller, sent, times=1 + again)


@pytest.mark.parametrize("index", [0, 1])
@pytest.mark.parametrize("bounds", BOUNDS)
def test_the_paths_agree_on_each_unusual_number_among_usual_ones(bounds: str, index: int) -> None:
    for number in UNUSUAL:
        values = inside(bounds)
        values[index] = number
        both_paths_agree(bounds, "agent", command(values, step=1), times=1)


@pytest.mark.parametrize("count", [0, 1, 2, 40])
def test_a_usual_command_takes_the_fast_path(count: int) -> None:
    at = exchange(*(actuator(f"a{i}", 0.0, 1.0) for i in range(count)), slots=2) if count else bare()
    claim(at, "agent")
    for k in (0, 1, 2):
        payload = (
            codec.CommandHead(at.episode, 8 * count * at.slots).at(at.step) + np.full(count * at.slots, 0.5).tobytes()
        )
        assert at.intake.accept_fast("agent", payload, 0.0)
        values, sources = advance(at)
        assert values == [0.5] * count * at.slots
        assert sources == ["agent"] * count * at.slots
        assert at.counts.accepted == k + 1


def test_the_fast_path_sets_the_level_that_was_claimed() -> None:
    at = exchange()
    claim(at, "agent", 10)
    assert at.intake.accept_fast("agent", wire(command([20.0, 25.0])), 0.0)
    at.intake.write("cool", Write(value=28.0, priority=11, source="below"), 0.0)
    at.intake.write("heat", Write(value=16.0, priority=9, source="above"), 0.0)
    assert advance(at) == ([16.0, 25.0], ["above", "agent"])


def bare() -> StepExchange:
    """A building without actuators."""
    at = StepExchange(())
    at.ready(0.0)
    return at


def test_a_building_without_actuators_is_stepped_all_the_same() -> None:
    at = bare()
    claim(at, "agent")
    assert not at.ready_to_step()
    assert answer(at, "agent", []) is None
    assert advance(at) == ([], [])


def test_the_fast_path_is_closed_during_a_timestep_and_open_at_its_end() -> None:
    # agent@0 -> node@1 is computed -> the intake is open for answers to it, and for no others
    at = exchange()
    claim(at, "agent")
    answer(at, "agent", [20.0, 25.0])
    at.begin_step(0.0)
    assert not any(at.intake.accept_fast("agent", wire(command([20.0, 25.0], step=step)), 0.0) for step in (0, 1))
    at.finish_step([False], 0.0)
    assert not any(at.intake.accept_fast("agent", wire(command([20.0, 25.0], step=step)), 0.0) for step in (0, 2))
    assert at.intake.accept_fast("agent", wire(command([20.0, 25.0], step=1)), 0.0)
    assert at.ready_to_step()


def test_a_sample_is_awaited_and_open_for_answers_from_the_end_of_its_timestep() -> None:
    # No other call is needed before the node may wait, tell whom it waits for, or hear an answer.
    at = running()
    assert (at.awaiting(), at.ready_to_step()) == (["agent"], False)
    assert answer(at, "agent", [20.0, 25.0]) is None
    at.begin_step(1.0)
    at.finish_step([False], 2.0)
    assert (at.awaiting(), at.ready_to_step()) == (["agent"], False)
    assert at.intake.accept_fast("agent", wire(command([20.0, 25.0], step=3)), 2.5)
    assert at.controllers()[0].response.max_ms == 500.0


# Claims


def test_a_second_claim_on_a_level_is_refused_by_name() -> None:
    at = exchange()
    claim(at, "first", 10, actuators=["cool"])
    with pytest.raises(RequestRejected) as raised:
        claim(at, "second", 10)
    assert "priority 10 of 'cool' is claimed by 'first'" in str(raised.value)
    assert [c.controller for c in at.controllers()] == ["first"]
    assert at.awaiting() == ["first"]


@pytest.mark.parametrize(("priority", "actuators"), [(11, None), (10, ["heat"])], ids=["priority", "actuators"])
def test_claims_that_do_not_meet_are_both_taken(priority: int, actuators: list[str] | None) -> None:
    at = exchange()
    claim(at, "first", 10, actuators=["cool"])
    (event,) = claim(at, "second", priority, actuators=actuators)
    check_event(event, EventKind.CONNECTED, "second")
    assert at.awaiting() == ["first", "second"]


def test_an_unknown_actuator_is_refused_with_near_names() -> None:
    at = exchange()
    with pytest.raises(RequestRejected, match=r"no actuator 'coool'; did you mean 'cool'"):
        claim(at, "a", actuators=["coool"])
    assert at.controllers() == []


def test_the_lower_level_rules_and_falls_back_on_release() -> None:
    at = exchange()
    claim(at, "agent", 10)
    claim(at, "guard", 5)
    answer(at, "agent", [20.0, 25.0])
    answer(at, "guard", [16.0, 0.0], [SET, KEEP])
    assert advance(at) == ([16.0, 25.0], ["guard", "agent"])
    answer(at, "agent", [21.0, 26.0])
    answer(at, "guard", [0.0, 0.0], [RELEASE, RELEASE])
    assert advance(at) == ([21.0, 26.0], ["agent", "agent"])


def test_one_that_has_gone_is_waited_for_until_it_is_back() -> None:
    # node@0 -> agent@0 -> node@1 -> agent leaves -> (waits) -> agent is back -> agent@1 -> node@2
    at = exchange()
    claim(at, "agent")
    answer(at, "agent", [20.0, 25.0])
    advance(at)
    (event,) = at.fallback.on_disconnect("agent", 0.0)
    check_event(event, EventKind.DISCONNECTED, "agent", "waits")
    assert not at.ready_to_step()
    assert at.awaiting() == ["agent"]
    assert [c.state for c in at.controllers()] == [ControllerState.DISCONNECTED]
    assert at.fallback.on_disconnect("agent", 0.0) == []
    claim(at, "agent")
    assert [(c.state, c.accepted) for c in at.controllers()] == [(ControllerState.CONNECTED, 1)]
    assert not at.ready_to_step()
    answer(at, "agent", [21.0, 26.0])
    assert advance(at) == ([21.0, 26.0], ["agent", "agent"])


def test_one_that_was_never_there_cannot_leave() -> None:
    at = exchange()
    assert at.fallback.on_disconnect("nobody", 0.0) == []


def test_one_that_has_gone_is_replaced_at_its_level() -> None:
    # agent@0 -> node@1 -> agent leaves -> other takes over -> other@1 -> node@2 -> agent comes back: refused
    at = exchange()
    claim(at, "agent")
    answer(at, "agent", [20.0, 25.0])
    advance(at)
    at.fallback.on_disconnect("agent", 0.0)
    gone, joined = claim(at, "other")
    check_event(gone, EventKind.DISCONNECTED, "other takes over from agent")
    check_event(joined, EventKind.CONNECTED, "other")
    assert at.awaiting() == ["other"]
    assert answer(at, "other", [16.0, 29.0]) is None
    assert advance(at) == ([16.0, 29.0], ["other", "other"])
    with pytest.raises(RequestRejected, match="claimed by 'other'"):
        claim(at, "agent")
    check_event(answer(at, "agent", [20.0, 25.0]), EventKind.REJECTED, "'agent' has claimed nothing")


def test_one_that_has_gone_at_another_level_is_not_replaced() -> None:
    at = exchange()
    claim(at, "agent", 10)
    at.fallback.on_disconnect("agent", 0.0)
    claim(at, "other", 11)
    answer(at, "other", [16.0, 29.0])
    assert at.awaiting() == ["agent"]
    assert not at.ready_to_step()


def test_what_one_set_that_was_replaced_does_not_outlive_it() -> None:
    # The new one claims `heat` only: nobody is left who could release `cool`.
    at = exchange()
    claim(at, "agent")
    answer(at, "agent", [20.0, 25.0])
    advance(at)
    at.fallback.on_disconnect("agent", 0.0)
    claim(at, "other", actuators=["heat"])
    answer(at, "other", [16.0, 0.0], [SET, KEEP])
    values, sources = advance(at)
    assert same(values, [16.0, NAN])
    assert sources == ["other", ""]


def test_what_was_set_at_a_level_does_not_outlive_the_claim_on_it() -> None:
    # The agent moves from level 10 to 12 and releases all: nobody is left who could release level 10.
    at = exchange()
    claim(at, "agent", 10)
    answer(at, "agent", [20.0, 25.0])
    advance(at)
    claim(at, "agent", 12)
    answer(at, "agent", [0.0, 0.0], [RELEASE, RELEASE])
    values, sources = advance(at)
    assert same(values, [NAN, NAN])
    assert sources == ["", ""]


def test_one_that_claims_again_answers_again() -> None:
    at = exchange()
    claim(at, "agent")
    answer(at, "agent", [20.0, 25.0])
    (event,) = claim(at, "agent")
    check_event(event, EventKind.CONNECTED, "again")
    assert not at.ready_to_step()
    assert answer(at, "agent", [21.0, 26.0]) is None
    assert advance(at) == ([21.0, 26.0], ["agent", "agent"])


def test_one_that_joins_within_an_episode_is_waited_for_at_once() -> None:
    at = running()
    answer(at, "agent", [20.0, 25.0])
    claim(at, "late-comer", 11)
    assert not at.ready_to_step()
    assert at.awaiting() == ["late-comer"]


def test_the_status_tells_of_each_claim() -> None:
    at = running()
    rows = [(c.controller, c.priority, c.actuators, c.required, c.state, c.accepted) for c in at.controllers()]
    assert rows == [
        ("agent", 10, 2, True, ControllerState.CONNECTED, 2),
        ("helper", 9, 1, False, ControllerState.CONNECTED, 0),
    ]


# Writes


def test_a_write_rules_over_a_controller_until_it_is_released() -> None:
    # person@8 over agent@10
    at = exchange()
    claim(at, "agent", 10)
    answer(at, "agent", [20.0, 25.0])
    check_event(
        at.intake.write("cool", Write(value=28.0, source="wall"), 0.0),
        EventKind.WRITTEN,
        "cool = 28 degC",
        "priority 8",
    )
    assert advance(at) == ([20.0, 28.0], ["agent", "wall"])
    answer(at, "agent", [20.0, 24.0])
    assert advance(at) == ([20.0, 28.0], ["agent", "wall"])
    answer(at, "agent", [20.0, 24.0])
    check_event(
        at.intake.write("cool", Write(value=None, source="wall"), 1800.0),
        EventKind.WRITTEN,
        "relinquished",
        "priority 8",
    )
    assert advance(at) == ([20.0, 24.0], ["agent", "agent"])


def test_a_write_below_a_controller_waits_for_its_turn() -> None:
    at = exchange()
    claim(at, "agent", 10)
    answer(at, "agent", [20.0, 25.0])
    at.intake.write("cool", Write(value=28.0, priority=16, source="plan"), 0.0)
    assert advance(at) == ([20.0, 25.0], ["agent", "agent"])
    answer(at, "agent", [0.0, 0.0], [KEEP, RELEASE])
    assert advance(at) == ([20.0, 28.0], ["agent", "plan"])


def test_a_write_answers_nothing() -> None:
    at = exchange()
    claim(at, "agent")
    at.intake.write("cool", Write(value=28.0), 0.0)
    assert not at.ready_to_step()


def test_a_write_reaches_all_slots() -> None:
    at = exchange(slots=2, mode=Mode.FREE)
    at.intake.write("cool", Write(value=28.0, source="wall"), 0.0)
    values, sources = advance(at)
    assert same(values, [NAN, 28.0, NAN, 28.0])
    assert sources == ["", "wall", "", "wall"]


@pytest.mark.parametrize("priority", [8, 12])
def test_a_write_for_1800_s_rules_two_timesteps_of_900_s(priority: int) -> None:
    at = exchange(mode=Mode.FREE)
    at.intake.write("cool", Write(value=28.0, duration_s=1800.0, priority=priority, source="wall"), 0.0)
    sources, told_of = [], []
    for k in range(4):
        told_of += [(k, e.kind, e.source) for e in at.intake.expire(k * 900.0)]
        sources.append(advance(at)[1])
    assert sources == [["", "wall"], ["", "wall"], ["", ""], ["", ""]]
    assert told_of == [(2, EventKind.EXPIRED, "wall")]
    assert not at.commands.has_expiries


def test_a_write_once_the_episode_is_over_is_refused() -> None:
    at = exchange(mode=Mode.FREE)
    at.begin_step(0.0)
    at.finish_step([True], 0.0)
    event = at.intake.write("cool", Write(value=28.0, source="wall"), 900.0)
    assert (event.kind, event.source) == (EventKind.REJECTED, "wall")
    assert "the episode is over" in event.text
    at.reset()
    at.ready(0.0)
    assert advance(at)[1] == ["", ""]


@pytest.mark.parametrize("duration_s", [600.0, 2700.0], ids=["shorter", "longer"])
def test_a_later_write_has_its_own_time(duration_s: float) -> None:
    at = exchange(mode=Mode.FREE)
    at.intake.write("cool", Write(value=28.0, duration_s=1800.0), 0.0)
    at.intake.write("cool", Write(value=27.0, duration_s=duration_s), 0.0)
    over = [k for k in range(5) if at.intake.expire(k * 900.0)]
    assert over == [math.ceil(duration_s / 900.0)]


def test_each_write_has_a_time_of_its_own() -> None:
    at = exchange(mode=Mode.FREE)
    at.intake.write("cool", Write(value=28.0, duration_s=900.0), 0.0)
    at.intake.write("heat", Write(value=16.0, duration_s=1800.0), 0.0)
    at.intake.write("cool", Write(value=27.0, duration_s=2700.0, priority=9), 0.0)
    assert [(k, e.text) for k in range(5) for e in at.intake.expire(k * 900.0)] == [
        (1, "cool relinquished at priority 8"),
        (2, "heat relinquished at priority 8"),
        (3, "cool relinquished at priority 9"),
    ]


def test_a_write_without_a_time_after_one_with_a_time_stays() -> None:
    at = exchange(mode=Mode.FREE)
    at.intake.write("cool", Write(value=28.0, duration_s=900.0), 0.0)
    at.intake.write("cool", Write(value=27.0, source="wall"), 0.0)
    assert at.intake.expire(1e9) == []
    assert ruling(at)[1] == ["", "wall"]


def test_a_release_takes_the_expiry_with_it() -> None:
    at = exchange(mode=Mode.FREE)
    at.intake.write("cool", Write(value=28.0, duration_s=900.0), 0.0)
    at.intake.write("cool", Write(value=None), 0.0)
    assert not at.commands.has_expiries
    assert at.intake.expire(1e9) == []


def test_an_expiry_releases_what_was_written_and_nothing_else() -> None:
    # The wall writes at 10 for half an hour, then an agent claims that very level.
    at = exchange()
    at.intake.write("cool", Write(value=28.0, duration_s=1800.0, priority=10, source="wall"), 0.0)
    claim(at, "agent", 10)
    answer(at, "agent", [20.0, 25.0])
    advance(at)
    answer(at, "agent", [0.0, 0.0], [KEEP, KEEP])
    at.intake.expire(1800.0)
    assert advance(at) == ([20.0, 25.0], ["agent", "agent"])


REFUSED_WRITES = {
    "unknown": ("coool", Write(value=25.0), ["no actuator 'coool'", "'cool'"]),
    "too low": ("cool", Write(value=22.0), ["cool = 22", "22.5 to 30 degC"]),
    "too high": ("cool", Write(value=31.0), ["cool = 31", "22.5 to 30 degC"]),
    "level of a controller": ("cool", Write(value=25.0, priority=9), ["priority 9 of 'cool'", "'helper'"]),
    "release of a controller's": ("cool", Write(value=None, priority=9), ["priority 9 of 'cool'", "'helper'"]),
}


@pytest.mark.parametrize(("name", "write", "words"), REFUSED_WRITES.values(), ids=REFUSED_WRITES)
def test_a_wrong_write_is_rejected_in_words(name: str, write: Write, words: list[str]) -> None:
    at = running()
    check_event(unchanged(at, lambda: at.intake.write(name, write, 0.0), count="rejected"), EventKind.REJECTED, *words)


def test_a_level_is_claimed_only_on_the_actuators_that_were_claimed() -> None:
    at = running()  # `helper` holds level 9 of `cool`
    check_event(at.intake.write("heat", Write(value=20.0, priority=9), 0.0), EventKind.WRITTEN)


# Free mode


def test_in_free_mode_nobody_is_waited_for() -> None:
    at = exchange(mode=Mode.FREE)
    assert at.ready_to_step()
    claim(at, "agent")
    values, sources = advance(at)
    assert same(values, [NAN, NAN])
    assert sources == ["", ""]
    assert answer(at, "agent", [20.0, 25.0]) is None
    assert advance(at) == ([20.0, 25.0], ["agent", "agent"])
    assert advance(at) == ([20.0, 25.0], ["agent", "agent"])  # held
    check_event(at.intake.command("agent", command([21.0, 26.0], step=1), 0.0), EventKind.LATE)
    assert advance(at) == ([20.0, 25.0], ["agent", "agent"])


def test_in_free_mode_the_end_is_the_end() -> None:
    at = exchange(mode=Mode.FREE)
    advance(at, last=True)
    assert not at.ready_to_step()


# Reset


@pytest.mark.parametrize("ended", [False, True])
def test_a_reset_releases_everything_and_keeps_the_claims(ended: bool) -> None:
    at = exchange()
    claim(at, "agent")
    at.intake.write("cool", Write(value=28.0, duration_s=3600.0, source="wall"), 0.0)
    answer(at, "agent", [20.0, 25.0])
    assert advance(at, last=ended)[1] == ["agent", "wall"]
    at.reset()
    assert (at.state, at.episode) == (State.STARTING, [1])
    assert not at.ready_to_step()
    at.ready(0.0)
    assert (at.state, at.step) == (State.WAITING, [0])
    assert not at.commands.has_expiries
    values, sources = ruling(at)
    assert same(values, [NAN, NAN])
    assert sources == ["", ""]
    assert at.awaiting() == ["agent"]
    assert answer(at, "agent", [21.0, 26.0]) is None
    assert advance(at) == ([21.0, 26.0], ["agent", "agent"])


def test_the_names_are_right_after_a_reset() -> None:
    at = exchange()
    at.intake.write("cool", Write(value=28.0, source="wall"), 0.0)  # the first name of this episode, not of the next
    claim(at, "agent", 10)
    claim(at, "guard", 5)
    at.reset()
    at.ready(0.0)
    answer(at, "guard", [16.0, 0.0], [SET, KEEP])
    answer(at, "agent", [20.0, 25.0])
    assert advance(at) == ([16.0, 25.0], ["guard", "agent"])


def test_counts_are_of_the_nodes_life() -> None:
    at = running()
    at.intake.command("agent", command([20.0, 25.0], step=0), 0.0)
    at.intake.command("agent", command([20.0, NAN], step=2), 0.0)
    at.reset()
    at.ready(0.0)
    assert (at.counts.accepted, at.counts.late, at.counts.rejected) == (2, 1, 1)


def test_touched_tells_whether_sample_0_is_still_that_of_a_fresh_start() -> None:
    at = exchange()
    claim(at, "agent")
    assert at.modified == [False]
    answer(at, "agent", [20.0, 25.0])
    advance(at)
    assert at.modified == [True]
    at.reset()
    at.ready(0.0)
    assert at.modified == [False]


def test_a_write_that_names_nobody_is_of_somebody() -> None:
    at = exchange(mode=Mode.FREE)
    at.intake.write("cool", Write(value=28.0, source=""), 0.0)
    assert advance(at)[1] == ["", "anonymous"]


def test_a_write_after_a_failure_is_refused() -> None:
    at = exchange(mode=Mode.FREE)
    at.transition(Trigger.FAIL)
    assert at.intake.write("cool", Write(value=28.0, source="wall"), 0.0).kind is EventKind.REJECTED
