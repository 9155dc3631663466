"""Trials leave no trace: a node's samples are the same to the bit whether or not trials were made in between."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from support.nodes import SMALL, node_on_bus
from support.trial_histories import Operation, Player, histories

ROOMS = {"module": "support.rooms_plant", "steps": 12}
TESTS = Path(__file__).parents[1]


@contextmanager
def players(folder: Path, **node: Any) -> Iterator[tuple[Player, Player]]:
    """Two equal nodes: one on which histories are played with their trials, and one without."""
    with ExitStack() as close:
        pair = []
        for trials in (True, False):
            _, bus = close.enter_context(node_on_bus(folder / str(trials), **node))
            player = Player(bus, "office", trials=trials)
            close.callback(player.close)
            pair.append(player)
        yield pair[0], pair[1]


def assert_equal_samples(pair: tuple[Player, Player], history: Sequence[Operation]) -> None:
    with_trials, without = [player.play(history) for player in pair]
    assert with_trials == without


@pytest.fixture(scope="module", params=[1, 2], ids=["one slot", "two slots"])
def rooms(request: pytest.FixtureRequest, module_folder: Path) -> Iterator[tuple[Player, Player]]:
    """Nodes whose plant computes in their own process and is copied by assignment."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", f"{TESTS}:{TESTS.parent}")
        with players(module_folder / f"rooms-{request.param}", **ROOMS, slots=request.param) as pair:
            yield pair


@pytest.mark.variants
@given(history=histories(25))
@settings(max_examples=25)
def test_trials__leave_no_trace(rooms: tuple[Player, Player], history: list[Operation]) -> None:
    """And each trial has the samples of the steps that follow it with the same commands."""
    assert_equal_samples(rooms, history)


@pytest.fixture(scope="module", params=[{}, {"slots": 2}, {"baseline": True}], ids=["one", "slots", "baseline"])
def offices(request: pytest.FixtureRequest, module_folder: Path) -> Iterator[tuple[Player, Player]]:
    """Nodes with engines of EnergyPlus, which are forked."""
    folder = module_folder / "-".join(["office", *request.param])
    with players(folder, **SMALL, **request.param) as pair:
        yield pair


@pytest.mark.slow
@given(history=histories(40))
@settings(max_examples=40)
def test_trials__leave_no_trace_in_energyplus(offices: tuple[Player, Player], history: list[Operation]) -> None:
    assert_equal_samples(offices, history)
