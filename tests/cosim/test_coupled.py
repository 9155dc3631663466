"""The loss of a plant: the others wait, go on, or stop; a plant that comes back has lost nothing."""

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.coupled_plants import FakeCoupled, district_file, free, manifest_of, orchestrated

from zenostat.cosim.coupled import GuardedPlant, Rows
from zenostat.cosim.file import OnLost
from zenostat.cosim.orchestrator import Orchestrator
from zenostat.topics.errors import EngineDied, PlantFailed

STEPS = 8


def mixed(state: list[float], row: list[float]) -> tuple[list[float], list[float]]:
    value = 0.7 * state[0] + 0.3 * np.nan_to_num(row[0]) + 1.0
    return [value], [value]


def district(
    folder: Path, on_lost: OnLost, **guard: Any
) -> tuple[dict[str, FakeCoupled], Orchestrator, dict[str, GuardedPlant]]:
    text = """plants: {a: {plant: "p.py:P"}, b: {plant: "p.py:P"}}
connections:
  - {from: a.x, to: b.u}
  - {from: b.x, to: a.u, delay: 1}
"""
    manifest = manifest_of({"x": "W"}, {"u": ("W", None, None)})
    plants = {name: FakeCoupled(manifest, mixed, first=[start]) for name, start in (("a", 1.0), ("b", -3.0))}
    orchestrator, _, guarded = orchestrated(district_file(folder, text), plants, on_lost, **guard)
    return plants, orchestrator, guarded


def trajectory(orchestrator: Orchestrator, plants: dict[str, FakeCoupled], steps: int) -> list[tuple[float, ...]]:
    rows = []
    for _ in range(steps):
        orchestrator.step(free(plants))
        rows.append(tuple(float(orchestrator.rows[name].values[0, 0]) for name in plants))
    return rows


def test_stop__loss_is_an_error_with_the_plants_name(folder: Path) -> None:
    plants, orchestrator, _ = district(folder, OnLost.STOP)
    plants["b"].fails_at = 2
    with pytest.raises(EngineDied, match=r"^plant 'b': node 'node' is gone$"):
        trajectory(orchestrator, plants, STEPS)
    assert len(plants["a"].commands) == 3


def test_wait__plant_that_comes_back_has_lost_nothing(folder: Path) -> None:
    """It begins again with its seed and its commands: the trajectory is the same to the bit."""
    expected = trajectory(*_undisturbed(folder), STEPS)
    attempts = []

    def retry(_: object) -> None:
        attempts.append(len(attempts))
        plants["a"].is_back = len(attempts) == 3

    plants, orchestrator, _ = district(folder, OnLost.WAIT, retry=retry)
    plants["a"].fails_at = 4
    assert trajectory(orchestrator, plants, STEPS) == expected
    assert len(attempts) == 3
    assert set(plants["a"].seeds) == {7}
    (report,) = orchestrator.drain_warnings()
    assert report == "plant 'a' was lost, and is back at step 5: node 'node' is gone"


def _undisturbed(folder: Path) -> tuple[Orchestrator, dict[str, FakeCoupled]]:
    plants, orchestrator, _ = district(folder, OnLost.STOP)
    return orchestrator, plants


def test_wait__has_a_limit(folder: Path) -> None:
    plants, orchestrator, _ = district(folder, OnLost.WAIT, timeout_s=0.0)
    plants["a"].fails_at = 1
    with pytest.raises(EngineDied, match=r"plant 'a' is lost .* did not come back within 0 s"):
        trajectory(orchestrator, plants, STEPS)


def test_wait__ends_with_the_district(folder: Path) -> None:
    stop = threading.Event()
    plants, orchestrator, _ = district(folder, OnLost.WAIT, stop=stop, retry=lambda event: event.set())
    plants["a"].fails_at = 1
    with pytest.raises(EngineDied, match="plant 'a'"):
        trajectory(orchestrator, plants, STEPS)


def test_continue__last_values_hold_until_it_is_back(folder: Path) -> None:
    plants, orchestrator, guarded = district(folder, OnLost.GO_ON)
    plants["b"].fails_at = 3
    rows = trajectory(orchestrator, plants, 6)
    assert [row[1] for row in rows[2:]] == [rows[2][1]] * 4
    assert not guarded["b"].is_available
    assert [row[0] for row in rows[3:]] != [rows[2][0]] * 3  # the other plant goes on
    (report,) = orchestrator.drain_warnings()
    assert report == "plant 'b' is lost, and its last values hold: node 'node' is gone"
    plants["b"].is_back = True
    trajectory(orchestrator, plants, 1)
    assert guarded["b"].is_available
    assert len(plants["b"].commands) == 7  # brought to the present step with the commands that it had
    assert orchestrator.drain_warnings() == ["plant 'b' is back at step 7"]


LOOP = """plants: {a: {plant: "p.py:P"}, b: {plant: "p.py:P"}}
connections:
  - {from: a.x, to: b.u}
  - {from: b.x, to: a.u, solve: true, tolerance: 1.0e-9}
"""


class FailingTrials(FakeCoupled):
    """Its copies fail, as a class does that raises an error for some commands; the plant itself does not."""

    def finish_trial(self) -> list[Rows]:
        raise PlantFailed("ValueError: too hot")


@pytest.mark.parametrize("on_lost", OnLost)
def test_trial__that_fails_again_and_again_does_not_wait_for_ever(folder: Path, on_lost: OnLost) -> None:
    manifest = manifest_of({"x": "W"}, {"u": ("W", None, None)})
    plants = {"a": FailingTrials(manifest, mixed, first=[1.0]), "b": FakeCoupled(manifest, mixed, first=[-3.0])}
    plants["a"].is_back = True
    orchestrator, _, _ = orchestrated(district_file(folder, LOOP), plants, on_lost)
    if on_lost is OnLost.GO_ON:
        trajectory(orchestrator, plants, 2)
        assert any("too hot" in text for text in orchestrator.drain_warnings())
    else:
        with pytest.raises(EngineDied, match=r"plant 'a'.*too hot"):
            trajectory(orchestrator, plants, 2)
    assert len(plants["a"].seeds) < 10


def test_reset__plant_is_available_again(folder: Path) -> None:
    plants, orchestrator, guarded = district(folder, OnLost.GO_ON)
    plants["b"].fails_at = 1
    trajectory(orchestrator, plants, 3)
    plants["b"].fails_at = None
    orchestrator.start(dict.fromkeys(plants, 8))
    assert guarded["b"].is_available
    assert plants["b"].seeds == [7, 8]
