"""Faults of the link: what becomes of each message, by the rules and by the laws of chance."""

import itertools
import math
from datetime import datetime
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zenostat.bridge.faults import LinkFaults, Transition
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.fault_plan import FaultPlan

BEGIN = datetime(2017, 7, 3)
MANY = 20_000


def link(*faults: dict[str, Any], seed: int = 1, step: int | None = 0) -> LinkFaults:
    faulty = LinkFaults(FaultPlan.model_validate({"seed": seed, "faults": faults}), step_s=900, begin=BEGIN)
    if step is not None:
        faulty.move(step)
    return faulty


def within(count: int, of: int, probability: float) -> bool:
    """Whether a binomial count lies within four standard deviations of its mean."""
    return abs(count - of * probability) <= 4 * math.sqrt(of * probability * (1 - probability))


def test_link_faults__without_faults_each_message_comes_once_and_at_once() -> None:
    fine = link()
    assert fine.outgoing(3.0) == fine.incoming("agent", 3.0) == [0.0]
    assert not fine.disturbs_samples
    assert not fine.disturbs_commands


def test_link_faults__latencies_add_up_and_are_those_of_their_direction() -> None:
    slow = link(
        {"kind": "latency", "samples": True, "delay_ms": 20},
        {"kind": "latency", "samples": True, "commands": ["rl-*", "person"], "delay_ms": 30},
    )
    assert slow.outgoing(0.0) == [0.05]
    assert slow.incoming("rl-3", 0.0) == slow.incoming("person", 0.0) == [0.03]
    assert slow.incoming("other", 0.0) == [0.0]


def test_link_faults__jitter_is_uniform() -> None:
    # messages so far apart that none waits for the former: mean J/2, variance J²/12
    jitter = link({"kind": "jitter", "samples": True, "jitter_ms": 60})
    delays = [delay for k in range(MANY) for delay in jitter.outgoing(float(k))]
    assert len(delays) == MANY
    assert 0 <= min(delays) < 0.001
    assert 0.059 < max(delays) < 0.06
    mean = sum(delays) / MANY
    assert mean == pytest.approx(0.03, abs=4 * 0.06 / math.sqrt(12 * MANY))
    assert sum((d - mean) ** 2 for d in delays) / MANY == pytest.approx(0.06**2 / 12, rel=0.05)


def test_link_faults__with_jitter_nothing_overtakes() -> None:
    jitter = link({"kind": "jitter", "samples": True, "jitter_ms": 500})
    sent = [0.001 * k for k in range(2000)]
    arrivals = [now + delay for now in sent for delay in jitter.outgoing(now)]
    assert all(later >= earlier - 1e-12 for earlier, later in itertools.pairwise(arrivals))
    assert len(set(arrivals)) > 2


@pytest.mark.variants
@pytest.mark.parametrize("probability", [0.02, 0.5, 0.97])
@pytest.mark.parametrize(("kind", "copies"), [("loss", 0), ("duplicate", 2)])
def test_link_faults__lose_and_duplicate_as_often_as_configured(kind: str, copies: int, probability: float) -> None:
    faulty = link({"name": "it", "kind": kind, "samples": True, "probability": probability})
    deliveries = [faulty.outgoing(float(k)) for k in range(MANY)]
    hit = sum(len(delays) == copies for delays in deliveries)
    assert all(delays == [0.0] * len(delays) and len(delays) in (1, copies) for delays in deliveries)
    assert within(hit, MANY, probability)
    assert faulty.counts == {"it": hit}


def test_link_faults__loss_in_a_row_is_as_frequent_as_by_chance() -> None:
    faulty = link({"kind": "loss", "samples": True, "probability": 0.3})
    lost = [not faulty.outgoing(float(k)) for k in range(MANY)]
    assert within(sum(a and b for a, b in zip(lost[::2], lost[1::2], strict=True)), MANY // 2, 0.09)


def test_link_faults__what_is_held_back_is_overtaken() -> None:
    faulty = link({"kind": "reorder", "samples": True, "probability": 0.1, "hold_ms": 15})
    sent = [0.01 * k for k in range(MANY)]
    arrivals = sorted((now + faulty.outgoing(now)[0], k) for k, now in enumerate(sent))
    order = [k for _, k in arrivals]
    overtaken = sum(former > later for former, later in itertools.pairwise(order))
    # held for 15 ms, one is overtaken by the next, unless that is held, too
    assert within(overtaken, MANY, 0.1 * 0.9)
    assert within(faulty.counts["reorder 1"], MANY, 0.1)
    assert sorted(order) == list(range(MANY))


def test_link_faults__certain_loss_loses_all_and_a_window_ends_it() -> None:
    faulty = link(
        {"name": "cut", "kind": "loss", "commands": "*", "probability": 1, "when": {"from_step": 4, "to_step": 6}}
    )
    lost = []
    for step in range(8):
        faulty.move(step)
        lost.append(faulty.incoming("agent", 0.0) == [])
    assert lost == [False] * 4 + [True] * 2 + [False] * 2
    assert [(transition.turn, transition.fault, transition.step) for transition in faulty.drain_transitions()] == [
        (Transition.BEGAN, "cut", 4),
        (Transition.ENDED, "cut", 6),
    ]
    assert faulty.drain_transitions() == []


def test_link_faults__no_fault_is_on_before_the_node_states_where_it_is() -> None:
    faulty = link({"kind": "loss", "samples": True, "probability": 1}, step=None)
    assert faulty.outgoing(0.0) == [0.0]
    faulty.move(0)
    assert faulty.outgoing(0.0) == []
    faulty.reset()
    assert faulty.outgoing(0.0) == [0.0]


# Chance

LOSS = {"kind": "loss", "samples": True, "commands": "*", "probability": 0.5}


def lost_of(faulty: LinkFaults, n: int = 200) -> list[bool]:
    return [not faulty.outgoing(float(k)) for k in range(n)]


def test_link_faults__one_seed_one_sequence() -> None:
    assert lost_of(link(LOSS)) == lost_of(link(LOSS))
    assert lost_of(link(LOSS)) != lost_of(link(LOSS, seed=2))


def test_link_faults__flow_does_not_depend_on_the_others() -> None:
    alone = link(LOSS)
    mixed = link(LOSS)
    ours = [not alone.incoming("a", 0.0) for _ in range(200)]
    theirs, again = [], []
    for k in range(200):
        mixed.outgoing(0.0)
        theirs += [not mixed.incoming("b", 0.0) for _ in range(k % 3)]
        again.append(not mixed.incoming("a", 0.0))
    assert ours == again
    assert ours[: len(theirs)] != theirs[:200]


def test_link_faults__reset_with_a_seed_begins_anew() -> None:
    faulty, sequences = link(LOSS), []
    for seed in (5, None, 5, None):
        faulty.reset(seed)
        faulty.move(0)
        sequences.append(lost_of(faulty))
    assert sequences[:2] == sequences[2:]
    assert sequences[0] != sequences[1]


@pytest.mark.slow
@given(before=st.integers(0, 150), n=st.integers(1, 100))
def test_link_faults__snapshot_goes_on_with_the_same_numbers(before: int, n: int) -> None:
    burst = {**LOSS, "name": "burst", "probability": 0.9, "when": {"probability": 0.2, "lasts_steps": 3}}
    faulty = link(LOSS, burst)
    faulty.reset(11)

    def go_on(it: LinkFaults, first: int) -> list[Any]:
        delays = []
        for k in range(first, first + n):
            it.move(k)
            delays.append((it.outgoing(0.0), it.incoming("a", 0.0)))
        return delays

    for k in range(before):
        faulty.move(k)
        faulty.outgoing(0.0)
        faulty.incoming("a", 0.0)
    state = faulty.state()
    went_on = go_on(faulty, before)
    other = link(LOSS, burst, step=None)
    other.restore(state)
    assert go_on(other, before) == went_on
    faulty.restore(state)
    assert go_on(faulty, before) == went_on


def test_link_faults__window_without_a_sample_is_refused() -> None:
    with pytest.raises(InvalidConfig, match=r"'loss 1' is never active.*\n.*'latency 2' is never active") as error:
        link(
            {**LOSS, "when": {"from_s": 10, "to_s": 20}},
            {"kind": "latency", "samples": True, "delay_ms": 1, "when": {"to_time": "2016-01-01"}},
        )
    assert "every 900 s from 2017-07-03T00:00" in str(error.value)


def test_link_faults__fault_that_a_changed_plan_keeps_goes_on() -> None:
    loss = {"kind": "loss", "name": "radio", "samples": True, "probability": 0.3}
    slow = {"kind": "latency", "samples": True, "delay_ms": 20}
    expected, first, changed = lost_of(link(loss), 120), link(loss), link(slow, loss, step=None)
    assert lost_of(first, 70) == expected[:70]
    counted = first.counts["radio"]
    assert changed.adopt(first)
    changed.move(1)
    assert [transition.fault for transition in changed.drain_transitions()] == ["latency 1"]
    assert changed.counts["radio"] == counted
    assert [not changed.outgoing(float(k)) for k in range(70, 120)] == expected[70:]
    assert not link(slow).adopt(first)
