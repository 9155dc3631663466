"""Verification of a plant that is a Python class: what was changed in its recording is found and named."""

import json
from pathlib import Path
from typing import Any

import gymnasium as gym
import msgpack
import numpy as np
import pytest
from support.recordings import rewrite
from support.run_cli import run_in_process as run

from zenostat import recording
from zenostat.bridge.recording.reader import RecordedItem, RecordingReader
from zenostat.eplus_node.verify_recording import verify
from zenostat.lab.evaluate import evaluate
from zenostat.topics.errors import InvalidConfig, InvalidRecording
from zenostat.topics.messages import Flag

WALK = """
import random

class Walk:
    step_s = 60.0
    duration_s = 600.0
    sensors = {"place": "m"}
    meters = {"effort": "J"}
    actuators = {"push": ("m", -1.0, 1.0, 0.0)}

    def reset(self, seed):
        self.random, self.place = random.Random(seed), 0.0
        return {"place": 0.0, "effort": 0.0}

    def step(self, commands):
        self.place += commands["push"] + self.random.gauss(0.0, 1.0)
        return {"place": self.place, "effort": abs(commands["push"])}

    def save(self):
        return self.random.getstate(), self.place

    def restore(self, state):
        self.random = random.Random()
        self.random.setstate(state[0])
        self.place = state[1]
"""


PUSH, PLACE = 0, 0


def plant_of(walk: Path) -> str:
    return f"{walk.with_name('walk.py')}:Walk"


@pytest.fixture(scope="module")
def walk(module_scratch: Path) -> Path:
    """A recording of two episodes, a snapshot, a return to it, and a last episode without a seed."""
    (module_scratch / "walk.py").write_text(WALK)
    path = module_scratch / "walk.mcap"
    env = gym.make("zenostat/Building-v1", plant=f"{module_scratch}/walk.py:Walk", record=str(path), reward=None)
    rng = np.random.default_rng(0)

    def go(steps: int) -> None:
        for _ in range(steps):
            env.step(rng.uniform(-1.0, 1.0, 1).astype(np.float32))

    env.reset(seed=3)
    go(2)
    snapshot = env.unwrapped.snapshot()
    go(3)
    env.reset(options={"snapshot": snapshot})
    go(1)
    env.reset()
    go(10)
    env.close()
    return path


@pytest.mark.slow
def test_recording__seeds_and_snapshots_verify(walk: Path) -> None:
    result = verify(walk, plant=plant_of(walk))
    assert result.passed, str(result)
    assert (result.steps, result.episodes, result.skipped) == (16, 4, [])
    assert str(result) == "identical: 16 steps, 2 points, 1 actuator"
    assert verify(walk, plant=plant_of(walk), tolerance=0.0).greatest == {
        "place": 0.0,
        "effort": 0.0,
        "effective push": 0.0,
    }


class Change:
    """Changes fields of a message of an episode and a step; the number of changes is in `count`."""

    def __init__(self, schema: str, change: Any, *, step: int = 4, episode: int = 3) -> None:
        self.schema, self.change, self.step, self.episode, self.count = schema, change, step, episode, 0
        self._present = (-1, -1)

    def __call__(self, _: int, item: RecordedItem) -> bytes | None:
        fields = msgpack.unpackb(item.payload)
        if item.schema == "Sample":
            self._present = fields["episode"][0], fields["step"][0]
        if item.schema != self.schema or self._present != (self.episode, self.step) or self.count:
            return item.payload
        self.count += 1
        return None if self.change is None else msgpack.packb({**fields, **self.change(fields)})


def shifted(raw: bytes, index: int, change: Any) -> bytes:
    values = np.frombuffer(raw).copy()
    values[index] = change(values[index])
    return values.tobytes()


def next_up(value: float) -> float:
    return float(np.nextafter(value, np.inf))


CHANGES = {
    "a value by one bit": (lambda: Change("Sample", lambda s: {"values": shifted(s["values"], PLACE, next_up)}),
        "step 4 (2001-01-01T00:04:00): place is"),
    "an effective value": (lambda: Change("Sample", lambda s: {"effective": shifted(s["effective"], PUSH, next_up)}),
        "step 4 (2001-01-01T00:04:00): effective push is"),
    "an order by a nanometer": (
        lambda: Change("RecordedOrder", lambda o: {"values": shifted(o["values"], PUSH, lambda v: v + 1e-9)}, step=3),
        "step 4 (2001-01-01T00:04:00): place is",
    ),
    "an order relinquished": (
        lambda: Change("RecordedOrder", lambda o: {"values": shifted(o["values"], PUSH, lambda _: np.nan)}, step=3),
        "step 4 (2001-01-01T00:04:00): place is",
    ),
    "a time": (lambda: Change("Sample", lambda _: {"time": ["2001-01-01T00:04:01"]}),
        "step 4 (2001-01-01T00:04:01): time is '2001-01-01T00:04:00', recorded '2001-01-01T00:04:01'"),
    "a step left out": (lambda: Change("Sample", None), "step 5 (2001-01-01T00:05:00): step is 4, recorded 5"),
    "the end": (lambda: Change("Sample", lambda _: {"flags": [int(Flag.TRUNCATED)]}),
        "end of the episode is False, recorded True"),
    "a seed": (lambda: Change("RecordedEpisode", lambda _: {"inputs": [{"seed": 99}]}, step=3, episode=2),
        "episode 3, step 1 (2001-01-01T00:01:00): place is"),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("name", CHANGES)
def test_recording__what_was_changed_is_named(walk: Path, name: str) -> None:
    create, expected = CHANGES[name]
    change = create()
    result = verify(rewrite(walk, walk.with_name("changed.mcap"), change), plant=plant_of(walk))
    assert change.count == 1
    assert not result.passed
    assert expected in str(result)


@pytest.mark.slow
def test_recording__command_states_identical_or_the_first_difference(walk: Path) -> None:
    plant = ("--plant", plant_of(walk))
    done = run("verify", str(walk), *plant)
    assert (done.returncode, done.stdout.splitlines()[-1]) == (0, "identical: 16 steps, 2 points, 1 actuator")
    change = Change("Sample", lambda s: {"values": shifted(s["values"], PLACE, next_up)})
    changed = rewrite(walk, walk.with_name("changed.mcap"), change)
    done = run("verify", str(changed), *plant, "--json")
    fields = json.loads(done.stdout)
    assert done.returncode == 1
    assert (fields["passed"], fields["difference"]["point"], fields["difference"]["step"]) == (False, "place", 4)
    done = run("verify", str(changed), *plant, "--tolerance", "1e-6")
    assert done.returncode == 1  # its values are close enough, but somebody has changed them
    assert "all are within 1e-06" in done.stdout
    assert "audit log: broken: " in done.stdout
    done = run("verify", str(changed), *plant, "--tolerance", "0")
    assert done.returncode == 1
    assert "place" in done.stdout


@pytest.mark.slow
def test_recording__changed_class_is_refused_unless_a_tolerance_compares_it(walk: Path) -> None:
    file = walk.with_name("walk.py")
    text = file.read_text()
    try:
        file.write_text(text.replace("abs(commands", "0.5 + abs(commands"))
        with pytest.raises(InvalidRecording, match=r"the class .*walk\.py has changed; a tolerance compares it"):
            verify(walk, plant=plant_of(walk))
        result = verify(walk, plant=plant_of(walk), tolerance=0.1)
        assert not result.passed
        assert result.greatest == {"place": 0.0, "effort": pytest.approx(0.5), "effective push": 0.0}
        assert verify(walk, plant=plant_of(walk), tolerance=0.51).passed
        file.write_text(text.replace('"effort"', '"work"'))
        result = verify(walk, plant=plant_of(walk), tolerance=0.0)
        assert result.passed
        assert "effort is not a point of the model and was not compared" in result.notes
        file.write_text(text.replace('"push"', '"pull"'))
        with pytest.raises(InvalidRecording, match="lacks actuators that the recording commands: push"):
            verify(walk, plant=plant_of(walk), tolerance=0.0)
        file.unlink()
        with pytest.raises(InvalidConfig, match=r"no file .*walk\.py"):
            verify(walk, plant=plant_of(walk))
    finally:
        file.write_text(text)


@pytest.mark.slow
def test_recording__recording_without_a_start_verifies_nothing(walk: Path) -> None:
    path = rewrite(
        walk, walk.with_name("start.mcap"), lambda _, i: None if i.schema == "RecordedEpisode" else i.payload
    )
    result = verify(path, plant=plant_of(walk))
    assert not result.passed
    assert result.steps == 0
    with RecordingReader(path) as reader:
        samples = sum(1 for _ in reader.messages({"Sample"}))
    assert result.skipped == [f"{samples} samples of episodes whose start is not in the recording"]
    assert run("verify", str(path), "--plant", plant_of(walk)).returncode == 1


@pytest.mark.slow
def test_recording__plant_that_cannot_be_created_again_is_refused(walk: Path) -> None:
    path = rewrite(walk, walk.with_name("other.mcap"), provenance={"kind": "", "settings": {}, "files": {}})
    with pytest.raises(InvalidRecording, match="neither a building nor a Python class"):
        verify(path)


@pytest.mark.slow
def test_recording__evaluation_has_a_recording_per_controller(walk: Path) -> None:
    folder = walk.parent / "runs"
    settings = {"plant": f"{walk.with_name('walk.py')}:Walk", "reward": None}
    evaluate(settings, {"first": "random", "second": "random"}, episodes=2, record=folder)
    files = sorted(folder.iterdir())
    assert [file.name.partition("-")[0] for file in files] == ["first", "second"]
    loaded = [recording.load(file) for file in files]
    assert [run_.manifest.node for run_ in loaded] == ["first", "second"]
    assert [[len(e) for e in run_.episodes if e.seed is not None] for run_ in loaded] == [[11, 11], [11, 11]]
    with pytest.raises(InvalidConfig, match="name a folder"):
        evaluate(settings, ["random"], record=folder / "run.mcap")
