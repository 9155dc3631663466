"""Writes to a step exchange: priorities, durations, and what is rejected."""

import itertools
import math

import numpy as np
import pytest
from support.builders import NAN, advance, answer, claim, exchange, ruling
from support.exchange_checks import KEEP, RELEASE, SET, check_event, running, same, unchanged

from zenostat.topics.messages import EventKind, Mode, Policy, Write


def test_step_exchange__write_rules_over_a_controller_until_it_is_released() -> None:
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


def test_step_exchange__write_below_a_controller_waits_for_its_turn() -> None:
    at = exchange()
    claim(at, "agent", 10)
    answer(at, "agent", [20.0, 25.0])
    at.intake.write("cool", Write(value=28.0, priority=16, source="plan"), 0.0)
    assert advance(at) == ([20.0, 25.0], ["agent", "agent"])
    answer(at, "agent", [0.0, 0.0], [KEEP, RELEASE])
    assert advance(at) == ([20.0, 28.0], ["agent", "plan"])


def test_step_exchange__write_answers_nothing() -> None:
    at = exchange()
    claim(at, "agent")
    at.intake.write("cool", Write(value=28.0), 0.0)
    assert not at.ready_to_step()


def test_step_exchange__write_reaches_all_slots() -> None:
    at = exchange(slots=2, mode=Mode.FREE)
    at.intake.write("cool", Write(value=28.0, source="wall"), 0.0)
    values, sources = advance(at)
    assert same(values, [NAN, 28.0, NAN, 28.0])
    assert sources == ["", "wall", "", "wall"]


@pytest.mark.parametrize("priority", [8, 12])
def test_step_exchange__write_for_1800_s_rules_two_timesteps_of_900_s(priority: int) -> None:
    at = exchange(mode=Mode.FREE)
    at.intake.write("cool", Write(value=28.0, duration_s=1800.0, priority=priority, source="wall"), 0.0)
    sources, told_of = [], []
    for k in range(4):
        told_of += [(k, e.kind, e.source) for e in at.intake.expire(k * 900.0)]
        sources.append(advance(at)[1])
    assert sources == [["", "wall"], ["", "wall"], ["", ""], ["", ""]]
    assert told_of == [(2, EventKind.EXPIRED, "wall")]
    assert not at.commands.has_expiries


@pytest.mark.parametrize(("duration", "timesteps"), [("0.1", 1), ("0.3", 3), ("0.35", 4), ("7", 70), ("5e-324", 1)])
@pytest.mark.parametrize("step_s", [0.1, 0.7, 1 / 3, 900.0])
def test_step_exchange__written_value_rules_whole_timesteps_whatever_the_step(
    step_s: float, duration: str, timesteps: int
) -> None:
    """`duration` is one of timesteps of 0.1 s; sums and products of such times differ in their last bits."""
    duration_s = float(duration) / 0.1 * step_s or 5e-324
    for first in [*range(200), 10**5 + 7, int(1e8 / step_s)]:
        at = exchange(mode=Mode.FREE)
        at.intake.write("cool", Write(value=28.0, duration_s=duration_s), first * step_s)
        over = (k for k in itertools.count() if at.intake.expire((first + k) * step_s))
        assert next(over) == timesteps, first


def test_step_exchange__write_once_the_episode_is_over_is_refused() -> None:
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
def test_step_exchange__later_write_has_its_own_time(duration_s: float) -> None:
    at = exchange(mode=Mode.FREE)
    at.intake.write("cool", Write(value=28.0, duration_s=1800.0), 0.0)
    at.intake.write("cool", Write(value=27.0, duration_s=duration_s), 0.0)
    over = [k for k in range(5) if at.intake.expire(k * 900.0)]
    assert over == [math.ceil(duration_s / 900.0)]


def test_step_exchange__each_write_has_a_time_of_its_own() -> None:
    at = exchange(mode=Mode.FREE)
    at.intake.write("cool", Write(value=28.0, duration_s=900.0), 0.0)
    at.intake.write("heat", Write(value=16.0, duration_s=1800.0), 0.0)
    at.intake.write("cool", Write(value=27.0, duration_s=2700.0, priority=9), 0.0)
    assert [(k, e.text) for k in range(5) for e in at.intake.expire(k * 900.0)] == [
        (1, "cool relinquished at priority 8"),
        (2, "heat relinquished at priority 8"),
        (3, "cool relinquished at priority 9"),
    ]


def test_step_exchange__remaining_time_is_that_of_each_write() -> None:
    at = exchange(mode=Mode.FREE)
    assert at.commands.remaining_s(0.0) == b""
    at.intake.write("cool", Write(value=28.0, duration_s=1800.0), 0.0)
    at.intake.write("heat", Write(value=16.0, priority=3), 0.0)
    remaining_s = np.frombuffer(at.commands.remaining_s(900.0), "<f8").reshape(2, 16)
    assert remaining_s[1, 7] == 900.0
    assert np.isnan(np.delete(remaining_s, 16 + 7)).all()


def test_step_exchange__write_without_a_time_after_one_with_a_time_stays() -> None:
    at = exchange(mode=Mode.FREE)
    at.intake.write("cool", Write(value=28.0, duration_s=900.0), 0.0)
    at.intake.write("cool", Write(value=27.0, source="wall"), 0.0)
    assert at.intake.expire(1e9) == []
    assert ruling(at)[1] == ["", "wall"]


def test_step_exchange__release_takes_the_expiry_with_it() -> None:
    at = exchange(mode=Mode.FREE)
    at.intake.write("cool", Write(value=28.0, duration_s=900.0), 0.0)
    at.intake.write("cool", Write(value=None), 0.0)
    assert not at.commands.has_expiries
    assert at.intake.expire(1e9) == []


def test_step_exchange__expiry_releases_what_was_written_and_nothing_else() -> None:
    # The wall writes at 10 for half an hour, then an agent claims that very level.
    at = exchange()
    at.intake.write("cool", Write(value=28.0, duration_s=1800.0, priority=10, source="wall"), 0.0)
    claim(at, "agent", 10)
    answer(at, "agent", [20.0, 25.0])
    advance(at)
    answer(at, "agent", [0.0, 0.0], [KEEP, KEEP])
    at.intake.expire(1800.0)
    assert advance(at) == ([20.0, 25.0], ["agent", "agent"])


def test_step_exchange__claim_does_not_end_the_time_of_what_others_have_written() -> None:
    at = exchange()
    at.intake.write("cool", Write(value=28.0, duration_s=1800.0, priority=10, source="wall"), 0.0)
    claim(at, "agent", 10)
    answer(at, "agent", [20.0, 0.0], [SET, KEEP])
    assert advance(at) == ([20.0, 28.0], ["agent", "wall"])
    assert np.frombuffer(at.commands.remaining_s(900.0), "<f8").reshape(2, 16)[1, 9] == 900.0
    (event,) = at.intake.expire(1800.0)
    assert (event.kind, event.source) == (EventKind.EXPIRED, "wall")
    answer(at, "agent", [0.0, 0.0], [KEEP, KEEP])
    values, _ = advance(at)
    assert same(values, [20.0, NAN])


def test_step_exchange__time_of_an_own_write_ends_with_the_writers_claim() -> None:
    at = exchange()
    at.intake.write("cool", Write(value=28.0, duration_s=1800.0, priority=10, source="agent"), 0.0)
    claim(at, "agent", 10)
    assert not at.commands.has_expiries


@pytest.mark.parametrize("policy", [Policy.RELINQUISH, Policy.HOLD])
def test_step_exchange__end_of_a_claim_relinquishes_what_the_controller_has_set_only(policy: Policy) -> None:
    at = exchange()
    at.policy = policy
    at.intake.write("cool", Write(value=28.0, priority=10, source="wall"), 0.0)
    claim(at, "agent", 10)
    answer(at, "agent", [20.0, 0.0], [SET, KEEP])
    advance(at)
    at.fallback.on_disconnect("agent", 0.0)
    at.fallback.bypass("agent", 0.0)
    assert same(ruling(at)[0], [NAN if policy is Policy.RELINQUISH else 20.0, 28.0])
    at.claims.remove("agent")
    assert same(ruling(at)[0], [NAN, 28.0])


def test_step_exchange__values_of_a_replaced_controller_end_with_its_successors_claim() -> None:
    at = exchange()
    at.policy = Policy.HOLD
    for name in ("first", "second", "third"):
        claim(at, name, 10)
        answer(at, name, [20.0, 25.0], [SET, SET] if name == "first" else [KEEP, KEEP])
        advance(at)
        at.fallback.on_disconnect(name, 0.0)
        at.fallback.bypass(name, 0.0)
    assert ruling(at) == ([20.0, 25.0], ["first", "first"])
    at.claims.remove("third")
    assert same(ruling(at)[0], [NAN, NAN])


REFUSED_WRITES = {
    "unknown": ("coool", Write(value=25.0), ["no actuator 'coool'", "'cool'"]),
    "too low": ("cool", Write(value=22.0), ["cool = 22", "22.5 to 30 degC"]),
    "too high": ("cool", Write(value=31.0), ["cool = 31", "22.5 to 30 degC"]),
    "level of a controller": ("cool", Write(value=25.0, priority=9), ["priority 9 of 'cool'", "'helper'"]),
    "release of a controller's": ("cool", Write(value=None, priority=9), ["priority 9 of 'cool'", "'helper'"]),
}


@pytest.mark.parametrize(("name", "write", "words"), REFUSED_WRITES.values(), ids=REFUSED_WRITES)
def test_step_exchange__wrong_write_is_rejected_in_words(name: str, write: Write, words: list[str]) -> None:
    at = running()
    check_event(unchanged(at, lambda: at.intake.write(name, write, 0.0), count="rejected"), EventKind.REJECTED, *words)


def test_step_exchange__level_is_claimed_only_on_the_actuators_that_were_claimed() -> None:
    at = running()  # `helper` holds level 9 of `cool`
    check_event(at.intake.write("heat", Write(value=20.0, priority=9), 0.0), EventKind.WRITTEN)
