"""A plant that was lost is lost again where a recording has it: the trajectory is the same to the bit."""

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.coupled_plants import FakeCoupled, district_file, free, manifest_of, orchestrated

from zenostat.cosim.coupled import RepeatedPlant, Rows
from zenostat.cosim.file import OnLost
from zenostat.cosim.orchestrator import Orchestrator
from zenostat.topics.errors import EngineDied, NodeLost

STEPS = 9
DELAYED = """plants: {a: {plant: "p.py:P"}, b: {plant: "p.py:P"}}
connections:
  - {from: a.x, to: b.u}
  - {from: b.x, to: a.u, delay: 1}
"""
SOLVED = DELAYED.replace("delay: 1", "solve: true, tolerance: 1.0e-9")


def mixed(state: list[float], row: list[float]) -> tuple[list[float], list[float]]:
    value = 0.7 * state[0] + 0.3 * float(np.sin(np.nan_to_num(row[0]))) + 1.0
    return [value], [value]


class TriedPlant(FakeCoupled):
    """It is also lost once it has tried a number of steps."""

    lost_after: int | None = None

    def finish_trial(self) -> list[Rows]:
        if self.tries == self.lost_after and not self.is_back:
            self.fails_at = 0
            raise NodeLost("node 'node' is gone")
        return super().finish_trial()


def plants_of() -> dict[str, TriedPlant]:
    manifest = manifest_of({"x": "W"}, {"u": ("W", None, None)})
    return {name: TriedPlant(manifest, mixed, first=[start]) for name, start in (("a", 1.0), ("b", -3.0))}


def row(orchestrator: Orchestrator, guarded: dict[str, Any]) -> tuple[float, ...]:
    values = [float(orchestrator.rows[name].values[0, 0]) for name in guarded]
    return (*values, *orchestrator.received, *orchestrator.residuals, *(s.trials for s in orchestrator.loops))


def repeated(file: Any, flags: list[dict[str, tuple[bool, bool]]]) -> list[tuple[float, ...]]:
    """The trajectory of plants that are not lost themselves."""
    plants = plants_of()
    _, binding, _ = orchestrated(file, plants_of())
    guarded = {name: RepeatedPlant(name, plant, threading.Event()) for name, plant in plants.items()}
    orchestrator = Orchestrator(binding, guarded, file.spec.solver)
    orchestrator.start(dict.fromkeys(plants, 7))
    rows = []
    for step in flags:
        for name, (available, tried) in step.items():
            guarded[name].expect(available=available, tried=tried)
        orchestrator.step(free(plants))
        rows.append(row(orchestrator, guarded))
    return rows


@pytest.mark.parametrize("text", [DELAYED, SOLVED], ids=["delayed", "solved"])
@pytest.mark.parametrize("lost", ["a", "b"])
@pytest.mark.parametrize(("attribute", "number"), [("fails_at", 3), ("lost_after", 7), ("lost_after", 8)])
@pytest.mark.parametrize("back_at", [None, 6])
def test_repeated__trajectory_of_a_loss_to_the_bit(
    folder: Path, text: str, lost: str, attribute: str, number: int, back_at: int | None
) -> None:
    """It is lost at the beginning of a step, or between two trials of one; and it comes back, or does not."""
    file = district_file(folder, text)
    plants = plants_of()
    orchestrator, _, guarded = orchestrated(file, plants, OnLost.GO_ON)
    setattr(plants[lost], attribute, number)
    rows, flags = [], []
    for step in range(STEPS):
        plants[lost].is_back = step == back_at or plants[lost].is_back
        orchestrator.step(free(plants))
        rows.append(row(orchestrator, guarded))
        flags.append({name: (guard.is_available, guard.is_tried) for name, guard in guarded.items()})
    if attribute == "fails_at" or text == SOLVED:
        assert not all(step[lost][0] for step in flags)
        assert flags[-1][lost][0] == (back_at is not None)
    assert repeated(file, flags) == rows


def test_loss_between_trials__all_trials_are_with_the_last_values(folder: Path) -> None:
    """The solution is that of a plant that was lost before the step: the trials before the loss are not mixed in."""
    file, results = district_file(folder, SOLVED), []
    for attribute in ("lost_after", "fails_at"):
        plants = plants_of()
        orchestrator, _, guarded = orchestrated(file, plants, OnLost.GO_ON)
        orchestrator.step(free(plants))
        setattr(plants["b"], attribute, plants["b"].tries + 1 if attribute == "lost_after" else 1)
        orchestrator.step(free(plants))
        results.append((row(orchestrator, guarded), guarded["b"].is_tried))
    assert results[0] == results[1]
    assert not results[0][1]


def test_repeated__own_loss_is_an_error(folder: Path) -> None:
    file, plants = district_file(folder, DELAYED), plants_of()
    _, binding, _ = orchestrated(file, plants_of())
    guarded = {name: RepeatedPlant(name, plant, threading.Event()) for name, plant in plants.items()}
    orchestrator = Orchestrator(binding, guarded, file.spec.solver)
    orchestrator.start(dict.fromkeys(plants, 7))
    plants["b"].fails_at = 0
    with pytest.raises(EngineDied, match=r"^plant 'b': node 'node' is gone$"):
        orchestrator.step(free(plants))
