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
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import EngineDied, NodeLost, PlantFailed

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


def test_wait__district_says_once_for_whom_it_waits(folder: Path) -> None:
    waiting: list[str] = []

    def retry(_: object) -> None:
        waiting.append(guarded["a"].waiting)
        plants["a"].is_back = len(waiting) == 3

    plants, orchestrator, guarded = district(folder, OnLost.WAIT, retry=retry)
    reported: list[str] = []
    guarded["a"].on_waiting = reported.append
    plants["a"].fails_at = 4
    trajectory(orchestrator, plants, STEPS)
    text = "plant 'a' is lost, and the district waits for it: node 'node' is gone"
    assert waiting == [text] * 3
    assert reported == [text]
    assert guarded["a"].waiting == ""


def test_wait__reason_is_reported_when_it_is_new_and_not_in_each_step(folder: Path) -> None:
    _, _, guarded = district(folder, OnLost.STOP)
    plant, reported = guarded["a"], list[str]()
    plant.on_waiting = reported.append
    paused, gone = "node 'node' is paused", "node 'node' waits for 'fmi', which is disconnected (policy wait)"

    def step(*obstacles: str) -> None:
        plant.begin(np.zeros((1, 1)))
        for obstacle in obstacles:
            plant.report_obstacle(obstacle)
        plant.finish()
        assert plant.waiting == ""

    step(paused, paused)
    step(paused)  # by somebody who lets it step now and then
    step("", gone)
    step("")
    step(gone)
    assert [text.partition(": ")[2] for text in reported] == [paused, gone, gone]


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


class Commanded(FakeCoupled):
    """Somebody else commands more on its bus, until its node begins again."""

    others = 0.0

    def reset(self, seed: int) -> Rows:
        self.others = 0.0
        return super().reset(seed)

    def begin(self, commands: Floats) -> None:
        super().begin(commands + self.others)


@pytest.mark.parametrize("on_lost", [OnLost.WAIT, OnLost.GO_ON])
def test_lost__plant_that_comes_back_without_the_commands_of_others_is_an_event(on_lost: OnLost) -> None:
    """Step 2 has the command of somebody else, and its repetition has not."""
    plant = Commanded(manifest_of({"x": "W"}, {"u": ("W", None, None)}), mixed, first=[1.0])

    def come_back(_: object) -> None:
        plant.is_back = True

    guarded = GuardedPlant("a", plant, on_lost, timeout_s=60.0, stop=threading.Event(), retry=come_back)
    texts = {}
    for others in (0.0, 5.0):
        plant.fails_at, plant.is_back = None, False
        guarded.reset(7)
        plant.fails_at = 2
        for step in range(1, 5):
            plant.others = others if step == 2 else 0.0
            guarded.begin(np.array([[2.0]]))
            guarded.finish()
            plant.is_back = plant.is_back or step == 3
        texts[others] = guarded.drain_warnings()
        assert guarded.is_available
    assert texts[5.0][:-1] == texts[0.0]
    assert texts[5.0][-1].startswith(
        "plant 'a' has other values in step 2 than before it was lost: the district repeats"
    )


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
def test_trial__that_fails_has_no_value_and_is_no_loss(folder: Path, on_lost: OnLost) -> None:
    """Only copies fail: the plants step with the best trial, and the loop is not solved."""
    manifest = manifest_of({"x": "W"}, {"u": ("W", None, None)})
    plants = {"a": FailingTrials(manifest, mixed, first=[1.0]), "b": FakeCoupled(manifest, mixed, first=[-3.0])}
    orchestrator, _, guarded = orchestrated(district_file(folder, LOOP), plants, on_lost)
    trajectory(orchestrator, plants, 2)
    assert guarded["a"].is_available
    assert not orchestrator.loops[0].is_solved
    assert orchestrator.loops[0].unsolved == 2
    texts = orchestrator.drain_warnings()
    assert texts[0] == "plant 'a' has no values in a trial: ValueError: too hot"  # once
    assert [text.partition(", since ")[2] for text in texts[1:]] == ["a plant has no value"] * 2
    assert plants["a"].seeds == plants["b"].seeds == [7]  # nothing begins again


class LostAtStep(FakeCoupled):
    """Its node is gone when it is to step, and not in the trials before."""

    def finish(self) -> Rows:
        raise NodeLost("node 'node' is gone")


def test_loop__whose_plant_is_lost_after_its_solution_is_not_solved(folder: Path) -> None:
    manifest = manifest_of({"x": "W"}, {"u": ("W", None, None)})
    plants = {"a": LostAtStep(manifest, mixed, first=[1.0]), "b": FakeCoupled(manifest, mixed, first=[-3.0])}
    orchestrator, _, guarded = orchestrated(district_file(folder, LOOP), plants, OnLost.GO_ON)
    trajectory(orchestrator, plants, 1)
    assert not guarded["a"].is_available
    loop = orchestrator.loops[0]
    assert (loop.is_solved, loop.unsolved) == (False, 1)
    assert loop.error == abs(orchestrator.residuals[1]) / 1e-9 > 1.0
    assert "since a plant did not step as in its trial" in orchestrator.drain_warnings()[-1]


class Overridden(FakeCoupled):
    """Somebody commands its actuator at a higher priority."""

    held: float | None = None

    def finish(self) -> Rows:
        rows = super().finish()
        return rows if self.held is None else Rows(rows.values, np.full_like(rows.effective, self.held))


def test_input__with_a_value_that_is_not_that_of_its_connection_is_an_event(folder: Path) -> None:
    manifest = manifest_of({"x": "W"}, {"u": ("W", None, None)})
    plants = {name: Overridden(manifest, mixed, first=[1.0]) for name in ("a", "b")}
    orchestrator, _, _ = orchestrated(district_file(folder, LOOP), plants)
    texts: list[str] = []
    for step, held in enumerate((None, 5.0, 5.0, None, 0.0), 1):
        plants["b"].held = held
        trajectory(orchestrator, plants, 1)
        texts += [f"{step}: {text}" for text in orchestrator.drain_warnings() if "actuator" in text]
    assert [text[:44] for text in texts] == [
        "2: actuator 'b.u' has the value 5 in step 2 ", "5: actuator 'b.u' has the value 0 in step 5 ",
    ]  # fmt: skip


def test_reset__plant_is_available_again(folder: Path) -> None:
    plants, orchestrator, guarded = district(folder, OnLost.GO_ON)
    plants["b"].fails_at = 1
    trajectory(orchestrator, plants, 3)
    plants["b"].fails_at = None
    orchestrator.start(dict.fromkeys(plants, 8))
    assert guarded["b"].is_available
    assert plants["b"].seeds == [7, 8]
