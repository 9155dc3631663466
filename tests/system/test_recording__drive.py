"""The commands of a recording drive another node; a twin with the same seeds repeats the trajectory to the bit."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.nodes import SMALL, WEATHER, NodeProgram, node_on_bus
from support.recordings import rewrite
from support.run_cli import run_in_process as run

import zenostat
from zenostat import recording
from zenostat.bridge.recording.reader import RecordingReader
from zenostat.lab.drive import drive
from zenostat.topics import codec
from zenostat.topics.errors import InvalidConfig, InvalidRecording
from zenostat.topics.messages import Manifest, Mode
from zenostat.topics.recording import RecordedOrder

NOISE = {"weather_noise": {"dry_bulb_temperature": {"sigma": 3.0, "mu": 0.0, "tau_h": 5.0}}}
TWIN = {**SMALL, **NOISE, "weather": [WEATHER], "slots": 2}
SETPOINT = "core_zn_cooling_setpoint"


@pytest.fixture(scope="module")
def driven(module_scratch: Path) -> Path:
    """A recording of two slots: seeds, a write that expires, a pause of a slot, a snapshot, a partial reset."""
    path, rng = module_scratch / "driven.mcap", np.random.default_rng(3)
    with (
        node_on_bus(module_scratch / "driven", **TWIN, record=str(path)) as (_, bus),
        bus.controller("office", name="random") as link,
    ):
        low, high = np.array([[a.low, a.high] for a in link.manifest.actuators]).T

        def step(**still: Any) -> None:
            link.send(rng.uniform(low, high, (2, len(low))), **still)
            link.receive()

        link.reset(seed=7)
        for number in range(16):
            if number == 4:
                bus.write("office", SETPOINT, 27.0, priority=3, duration_s=1800.0, source="plc7")
            if number == 8:
                taken = bus.snapshot("office", controller=link.name)
            step(**({"still": (1,)} if number == 6 else {}))
        link.reset(snapshot=taken.snapshot)
        step()
        link.reset(slots=[1], seed=11)
        for _ in range(5):
            step()
    return path


@pytest.fixture(scope="module")
def twin(module_scratch: Path) -> Iterator[Any]:
    """A node of the same scenario, with another name, that is recorded."""
    path = module_scratch / "twin.mcap"
    with NodeProgram(module_scratch / "twin", **TWIN, name="twin", record=str(path)) as program:
        yield program, path


@pytest.mark.slow
def test_recording__twin_repeats_the_trajectory_to_the_bit(driven: Path, twin: Any) -> None:
    program, path = twin
    result = run("replay", str(driven), "--only-commands", "--node", "twin", "--connect", program.endpoint)
    assert result.returncode == 0, result.stderr
    assert not result.stderr
    assert "twin: 22 steps of 5 episodes commanded" in result.stdout  # 2 at the reset, 2 at the snapshot, 1 slot
    with zenostat.connect(program.endpoint, affinity="off") as bus:
        bus.stop_recording("twin")
    original, copy = recording.load(driven), recording.load(path)
    mine, other = ([e for e in r.episodes if len(e) > 1] for r in (original, copy))
    assert [(e.slot, len(e)) for e in mine] == [(e.slot, len(e)) for e in other]
    assert len(mine) >= 5
    for a, b in zip(mine, other, strict=True):
        for name in ("step", "time", "values", "effective", "orders"):
            assert getattr(a, name).tobytes() == getattr(b, name).tobytes(), (a, name)
    assert not np.array_equal(mine[0].values, mine[1].values)  # the slots have other noise
    sources = {name.partition("-")[0] for name in copy.episodes[-1].sources}
    assert sources - {""} == {"replay"}


TANK = """
class Tank:
    step_s, steps = 60, 100
    sensors = {"level": "m"}
    actuators = {"pump": ("W", 0.0, 100.0, 0.0)}

    def reset(self, seed):
        self.level = 1.0
        return {"level": self.level}

    def step(self, commands):
        self.level += commands["pump"] / 1000.0
        return {"level": self.level}

    def save(self):
        return self.level

    def restore(self, state):
        self.level = state
"""


@pytest.mark.slow
def test_recording__node_with_room_for_one_snapshot_repeats_those_that_were_used(scratch: Path) -> None:
    (scratch / "tank.py").write_text(TANK)
    settings = {"plant": f"{scratch}/tank.py:Tank", "name": "tank", "branches": 1}
    path = scratch / "tank.mcap"
    with (
        node_on_bus(scratch / "first", **settings, record=str(path)) as (_, bus),
        bus.controller("tank", name="filler") as link,
    ):
        sample = link.reset(seed=1)
        for number in range(8):
            snapshot = bus.snapshot("tank", controller=link.name).snapshot
            sample.send({"pump": 10.0 * number})
            sample = link.receive()
            if number in (3, 5):
                sample = link.reset(snapshot=snapshot)
            bus.drop("tank", snapshot, controller=link.name)
        bus.stop_recording("tank")
    with node_on_bus(scratch / "second", **settings, record=str(scratch / "copy.mcap")) as (_, bus):
        result = drive(path, bus, "tank")
        assert not bus.status("tank").snapshots
        bus.stop_recording("tank")
    assert (result.steps, result.episodes) == (8, 3)
    mine, other = (recording.load(each).episodes for each in (path, scratch / "copy.mcap"))
    assert [e.values.tobytes() for e in mine if len(e) > 1] == [e.values.tobytes() for e in other if len(e) > 1]


def order_out_of_bounds(_: int, item: Any) -> bytes:
    if item.schema != "RecordedOrder":
        return item.payload
    order = codec.decode(RecordedOrder, item.payload)
    values = np.frombuffer(order.values).copy()
    values[0] = 1e6
    return codec.encode(order.model_copy(update={"values": values.tobytes()}))


def manifest_without_an_actuator(manifest: Manifest) -> Manifest:
    first = manifest.actuators[0].model_copy(update={"name": "damper"})
    return manifest.model_copy(update={"actuators": (first, *manifest.actuators[1:])})


@pytest.mark.slow
def test_recording__what_does_not_fit_is_one_error_before_anything_starts(
    driven: Path, twin: Any, scratch: Path
) -> None:
    program, _ = twin
    with RecordingReader(driven) as reader:
        manifest = reader.manifest
    changed = {
        "a timestep of 900 s, the recorded node a timestep of 600 s": manifest.model_copy(update={"step_s": 600.0}),
        "2 slots, the recorded node 3 slots": manifest.model_copy(update={"slots": 3}),
        "their actuators differ: it lacks damper; the recorded node lacks": manifest_without_an_actuator(manifest),
    }
    with zenostat.connect(program.endpoint, affinity="off") as bus:
        before = bus.status("twin")
        for number, (text, other) in enumerate(changed.items()):
            path = rewrite(driven, scratch / f"{number}.mcap", manifest=other)
            with pytest.raises(InvalidConfig, match=text):
                recording.drive(path, bus, "twin")
        path = rewrite(driven, scratch / "bounds.mcap", order_out_of_bounds)
        with pytest.raises(InvalidConfig, match=r"timestep 0 commands \w+ = 1e\+06, outside its bounds"):
            recording.drive(path, bus, "twin")
        none = rewrite(driven, scratch / "none.mcap", lambda _, i: None if i.schema == "RecordedOrder" else i.payload)
        with pytest.raises(InvalidRecording, match="has no commands"):
            recording.drive(none, bus, "twin")
        bus.pause("twin")
        bus.pace("twin", mode=Mode.FREE)
        with pytest.raises(InvalidConfig, match=r"runs in mode free"):
            recording.drive(driven, bus, "twin")
        bus.pace("twin", mode=Mode.LOCKSTEP)
        bus.resume("twin")
        after = bus.status("twin")
        assert (after.episode, len(after.controllers)) == (before.episode, len(before.controllers))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--only-commands",), "needs the node to command"),
        (("--node", "twin"), "need --only-commands"),
        (("--only-commands", "--node", "twin", "--from", "07-03"), "--from: --only-commands connects to one bus"),
    ],
)
def test_recording__options_that_do_not_go_together_are_one_error(
    driven: Path, words: tuple[str, ...], text: str
) -> None:
    result = run("replay", str(driven), *words)
    assert result.returncode != 0
    assert text in result.stderr
