"""The fast path of the step exchange: it accepts the same commands as the full one, or none."""

import copy
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.builders import actuator, advance, answer, claim, command, exchange, ruling, wire
from support.examples import examples
from support.exchange_checks import KEEP, running

from zenostat.bridge.exchange.step_exchange import StepExchange
from zenostat.topics import codec
from zenostat.topics.messages import Command, CommandOp, State, Write

UNUSUAL = [0.0, -0.0, 1.0, -1.0, math.nan, math.inf, -math.inf, 5e-324, 1.7976931348623157e308, 22.5, 15.0, 30.0]
numbers = st.sampled_from(UNUSUAL) | st.floats(14.0, 31.0) | st.floats()
BOUNDS = {
    "both": (actuator("heat", 15.0, 22.5), actuator("cool", 22.5, 30.0)),
    "zero": (actuator("heat", 0.0, 1.0), actuator("cool", -1.0, 0.0)),
    "minus zero": (actuator("heat", -0.0, 1.0), actuator("cool", -1.0, -0.0)),
    "none": (actuator("heat"), actuator("cool")),
    "one": (actuator("heat", 15.0, None), actuator("cool", None, 30.0)),
    "many": (actuator("heat", 0.0, 1.0), actuator("cool", None, 0.0),
        *(actuator(f"a{k}", 0.0, 1.0) for k in range(40))),
}  # fmt: skip


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
def test_step_exchange__fast_path_does_what_the_decoded_path_does(
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
def test_step_exchange__paths_agree_on_each_unusual_number_among_usual_ones(bounds: str, index: int) -> None:
    for number in UNUSUAL:
        values = inside(bounds)
        values[index] = number
        both_paths_agree(bounds, "agent", command(values, step=1), times=1)


@pytest.mark.parametrize("count", [0, 1, 2, 40])
def test_step_exchange__usual_command_takes_the_fast_path(count: int) -> None:
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


def test_step_exchange__fast_path_sets_the_level_that_was_claimed() -> None:
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


def test_step_exchange__building_without_actuators_is_stepped_all_the_same() -> None:
    at = bare()
    claim(at, "agent")
    assert not at.ready_to_step()
    assert answer(at, "agent", []) is None
    assert advance(at) == ([], [])


def test_step_exchange__fast_path_is_closed_during_a_timestep_and_open_at_its_end() -> None:
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


def test_step_exchange__sample_is_awaited_and_open_for_answers_from_the_end_of_its_timestep() -> None:
    # No other call is needed before the node may wait, tell whom it waits for, or hear an answer.
    at = running()
    assert (at.awaiting(), at.ready_to_step()) == (["agent"], False)
    assert answer(at, "agent", [20.0, 25.0]) is None
    at.begin_step(1.0)
    at.finish_step([False], 2.0)
    assert (at.awaiting(), at.ready_to_step()) == (["agent"], False)
    assert at.intake.accept_fast("agent", wire(command([20.0, 25.0], step=3)), 2.5)
    assert at.controllers()[0].response.max_ms == 500.0
