"""A new node goes on with the recording of an ended one, to the bit, wherever that one stopped."""

import fcntl
import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
from support.nodes import SMALL, ZONES, NodeProgram, free_port, node_on_bus, until
from support.recordings import cut
from support.run_cli import ZENOSTAT
from support.run_cli import run_in_process as run

import zenostat
from zenostat import ControllerLink, recording
from zenostat.bridge.recording.continuation import MAX_DROPPED
from zenostat.bridge.recording.reader import RecordingReader
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.eplus_node.verify_recording import verify
from zenostat.models.catalog import find_building
from zenostat.topics import codec, keys, yaml12
from zenostat.topics.errors import InvalidConfig, InvalidRecording, PlantFailed, RequestRejected
from zenostat.topics.messages import Claim, Command, ControllerState, EventKind, State, Write

pytestmark = pytest.mark.process

COOLING = [f"{zone}_cooling_setpoint" for zone in ZONES]
HEATING = [f"{zone}_heating_setpoint" for zone in ZONES]
NIGHT = COOLING[2:4]
ALARMS = """
alarms:
  - {name: warm, points: "*_air_temperature", high: 24.0, unit: degC, deadband: 0.3, delay_s: 1800}
  - {name: power, points: hvac_electricity, high: 1.0e6, notify: event}
"""
FAULTS = {
    "seed": 3,
    "faults": [
        {"kind": "noise", "points": ["perimeter_zn_1_air_temperature"], "sigma": 0.5},
        {"kind": "bias", "actuators": [COOLING[1]], "offset": -0.5, "when": {"from_step": 40, "to_step": 50}},
        {"kind": "freeze", "points": ["core_zn_air_temperature"], "when": {"from_step": 44, "to_step": 52}},
    ],
}
DRIFT = {"kind": "drift", "name": "ages", "points": ["core_zn_air_temperature"], "rate_per_h": 0.5}
STEPS = 96
FIELDS = ("values", "effective", "commanded", "time", "elapsed_s", "flags", "fault_free_values")


class Day:
    """Two controllers, a panel and an operator, whose messages depend on the step alone.

    Controllers that are not connected connect, as after the loss of a node.
    """

    def __init__(self, bus: zenostat.Bus) -> None:
        self._bus, self._close = bus, ExitStack()
        self._links: dict[str, ControllerLink] = {}

    def __enter__(self) -> "Day":
        return self

    def __exit__(self, *_: object) -> None:
        self._close.close()

    def _link(self, name: str, priority: int, actuators: list[str] | None = None) -> ControllerLink:
        if name not in self._links:
            claim = Claim(controller=name, priority=priority, actuators=actuators)
            self._links[name] = self._close.enter_context(ControllerLink(self._bus, "office", claim, Affinity.OFF))
        return self._links[name]

    def play(self, end: int = STEPS) -> None:
        """Play the day from the present step up to `end`."""
        bus = self._bus
        if bus.status("office").state is State.ENDED:
            return
        mpc = self._link("mpc", 10)
        sample = mpc.reset(seed=7) if bus.status("office").episode == [0] else mpc.current()
        while sample.step < end and not sample.truncated:
            step = sample.step
            self._write(step)
            if 10 <= step < 25:
                night = self._link("night", 5, NIGHT)
                night.current()
                night.send({NIGHT[0]: 28.0 - step % 3, NIGHT[1]: None if step % 4 else 27.0})
            elif step == 25:  # the node need not wait for it any more; its commands stay in effect
                self._link("night", 5, NIGHT)
                bus.claim("office", Claim(controller="night", priority=5, actuators=NIGHT, required=False))
                self._links.pop("night").close()
                until(lambda: not _is_connected(bus, "night"), "it has left")
            mpc.send(self._values(step))
            sample = mpc.receive()

    def _write(self, step: int) -> None:
        bus = self._bus
        if step % 7 == 3:
            bus.write("office", COOLING[0], 25.0 + step % 3, priority=3, duration_s=4 * 900.0, source="panel")
        if step % 11 == 5:
            bus.write("office", HEATING[1], None if step % 2 else 20.0, priority=8, source="ann")
        if step == 35:
            bus.faults("office", FAULTS, source="ann")
        if step == 47:  # the freeze goes on
            bus.faults("office", {**FAULTS, "faults": [DRIFT, *FAULTS["faults"]]}, source="ann")
        if step == 60:
            with suppress(RequestRejected):  # acknowledged before the node was killed
                bus.acknowledge("office", "*", source="ann", comment="seen")
        if step == 70:
            bus.faults("office", None, source="ann")

    @staticmethod
    def _values(step: int) -> dict[str, float | None]:
        values: dict[str, float | None] = {name: 23.0 + (step + index) % 4 for index, name in enumerate(COOLING)}
        values |= {name: 18.0 + (step * index) % 3 for index, name in enumerate(HEATING)}
        return values | ({COOLING[4]: None} if step % 9 == 0 else {})


def _is_connected(bus: zenostat.Bus, name: str) -> bool:
    return any(c.controller == name and c.state.is_connected for c in bus.status("office").controllers)


def is_recorded(path: Path, step: int) -> bool:
    """Whether a recording that is being written has a step of its first episode."""
    try:
        return (1, step) in samples(path)
    except InvalidRecording:  # its head is not written yet
        return False


def samples(path: Path) -> dict[tuple[int, int], dict[str, Any]]:
    """The samples of a recording by episode and step, with the names of the sources."""
    by_step: dict[tuple[int, int], dict[str, Any]] = {}
    with RecordingReader(path) as reader:
        for item in reader.messages({"Sample"}):
            sample = msgpack.unpackb(item.payload)
            index = np.frombuffer(sample["source_index"], "<u2").tolist()
            fields = {name: sample[name] for name in FIELDS}
            fields["sources"] = [sample["sources"][number] for number in index]
            by_step[sample["episode"][0], sample["step"][0]] = fields
    return by_step


def kinds(path: Path) -> list[str]:
    """The kinds of the events of a recording."""
    with RecordingReader(path) as reader:
        return [msgpack.unpackb(item.payload)["kind"] for item in reader.messages({"Event"})]


def counted(path: Path) -> int:
    with RecordingReader(path) as reader:
        return sum(item.schema != "RecordedAudit" for item in reader.messages())


def outcome(bus: zenostat.Bus) -> tuple[Any, ...]:
    """Return the state of a node besides its samples."""
    alarms = bus.alarms("office").model_dump(exclude={"episode"})
    return bus.priorities("office"), bus.remaining_durations("office"), alarms


@pytest.fixture(scope="module")
def settings(module_scratch: Path) -> dict[str, Any]:
    (module_scratch / "alarms.yaml").write_text(ALARMS)
    return {**SMALL, "alarms": str(module_scratch / "alarms.yaml")}


@pytest.fixture(scope="module")
def reference(module_scratch: Path, settings: dict[str, Any]) -> tuple[Path, tuple[Any, ...]]:
    """The recording of the whole day by a node that nobody killed, and what it had at the end."""
    path = module_scratch / "reference.mcap"
    with node_on_bus(module_scratch / "reference", **settings, record=str(path)) as (_, bus), Day(bus) as day:
        day.play()
        end = outcome(bus)
    return path, end


def play_to_end(folder: Path, path: Path, settings: dict[str, Any]) -> tuple[int, tuple[Any, ...]]:
    """Let a new node go on with a recording, and play the rest of the day; return its first step, and its end."""
    with node_on_bus(folder, **settings, resume=str(path)) as (_, bus):
        begin = bus.status("office").step[0]
        assert not any(c.state.is_connected for c in bus.status("office").controllers)
        with Day(bus) as day:
            day.play()
            return begin, outcome(bus)


def check(path: Path, reference: Path) -> None:
    """The recording has the whole day as if nothing had happened, and verifies."""
    expected, present = samples(reference), samples(path)
    assert present.keys() == expected.keys()
    for at, sample in expected.items():
        for name, value in sample.items():
            assert present[at][name] == value, (at, name)
    result = verify(path)
    assert result.passed, str(result)
    assert result.steps >= STEPS


@pytest.mark.slow
def test_resume__killed_node_goes_on_to_the_bit(
    scratch: Path, settings: dict[str, Any], reference: tuple[Path, tuple[Any, ...]]
) -> None:
    path = scratch / "run.mcap"
    with node_on_bus(scratch / "first", **settings, record=str(path)) as (node, bus), Day(bus) as day:
        day.play(47)
        until(lambda: (1, 30) in samples(path), "the recorder has written step 30")
        node.kill()
    recorded = max(samples(path))[1]
    with NodeProgram(scratch / "second", **settings, resume=str(path)) as node:
        with zenostat.connect(node.endpoint, affinity=Affinity.OFF) as bus:
            assert bus.status("office").step[0] >= recorded  # one more if its command was recorded
            states = {c.controller: c.state for c in bus.status("office").controllers}
            assert states == {"mpc": ControllerState.DISCONNECTED, "night": ControllerState.DISCONNECTED}
        until(lambda: EventKind.RESUMED in kinds(path), "the recorder has written the event")
        node.kill()  # again, before anyone is back
    begin, end = play_to_end(scratch / "third", path, settings)
    assert begin >= recorded
    assert end == reference[1]
    check(path, reference[0])
    assert kinds(path).count(EventKind.RESUMED) == 2


@pytest.mark.parametrize(
    "share", [pytest.param(0.0, marks=pytest.mark.slow), pytest.param(0.38, marks=pytest.mark.slow), 0.999]
)
def test_resume__goes_on_after_any_message(
    share: float, scratch: Path, settings: dict[str, Any], reference: tuple[Path, tuple[Any, ...]]
) -> None:
    count = counted(reference[0])
    path = cut(reference[0], scratch / "cut.mcap", max(8, round(share * count)))
    _, end = play_to_end(scratch / "node", path, settings)
    assert end == reference[1]
    check(path, reference[0])


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(25))
def test_resume__goes_on_after_each_of_many_messages(
    seed: int, scratch: Path, settings: dict[str, Any], reference: tuple[Path, tuple[Any, ...]]
) -> None:
    count = counted(reference[0])
    path = cut(reference[0], scratch / "cut.mcap", int(np.random.default_rng(seed).integers(8, count)))
    _, end = play_to_end(scratch / "node", path, settings)
    assert end == reference[1]
    check(path, reference[0])


# Other plants, several slots


TANK = """
class Tank:
    step_s, steps = 60, 1000
    sensors = {"level": "m"}
    actuators = {"pump": ("W", 0.0, 100.0, 0.0)}

    def __init__(self, area=2.0):
        self.area = area

    def reset(self, seed):
        self.level = 1.0
        return {"level": self.level}

    def step(self, commands):
        self.level += commands["pump"] / 1000.0 / self.area - self.level / 3000
        return {"level": self.level}
"""


@pytest.fixture
def tank(scratch: Path) -> dict[str, Any]:
    (scratch / "tank.py").write_text(TANK)
    return {"plant": f"{scratch}/tank.py:Tank", "name": "tank", "plant_arguments": {"area": 3.0}}


def levels(bus: zenostat.Bus, end: int) -> list[float]:
    """Simulate the tank up to a step; return its levels."""
    with bus.controller("tank", name="filler") as link:
        sample, seen = link.current(), list[float]()
        while sample.step < end:
            link.send({"pump": 10.0 + sample.step % 5})
            sample = link.receive()
            seen.append(sample["level"])
    return seen


@pytest.mark.slow
def test_resume__python_class_goes_on(scratch: Path, tank: dict[str, Any]) -> None:
    path = scratch / "tank.mcap"
    with node_on_bus(scratch / "whole", **tank) as (_, bus):
        expected = levels(bus, 60)
    with node_on_bus(scratch / "first", **tank, record=str(path)) as (node, bus):
        levels(bus, 40)
        until(lambda: (0, 40) in samples(path), "the recorder has written step 40")
        node.kill()
    with pytest.raises(InvalidRecording, match=r"its settings are .*3\.0.*, not .*4\.0"):
        NodeProgram(scratch / "other", **{**tank, "plant_arguments": {"area": 4.0}}, resume=str(path))
    (scratch / "tank.py").write_text(TANK.replace("3000", "3001"))
    with pytest.raises(InvalidRecording, match=r"the class .*tank\.py has changed"):
        NodeProgram(scratch / "changed", **tank, resume=str(path))
    (scratch / "tank.py").write_text(TANK)
    with node_on_bus(scratch / "second", **tank, resume=str(path)) as (_, bus):
        status = bus.status("tank")
        assert status.step == [40]
        assert (status.accepted, {controller.accepted for controller in status.controllers}) == (0, {0})
        assert levels(bus, 60) == expected[40:]
    assert verify(path, plant=tank["plant"]).passed
    (scratch / "elsewhere").mkdir()
    (scratch / "tank.py").rename(scratch / "elsewhere" / "tank.py")
    moved = {**tank, "plant": f"{scratch}/elsewhere/tank.py:Tank"}
    with node_on_bus(scratch / "third", **moved, resume=str(path)) as (_, bus):
        assert bus.status("tank").step == [60]


@pytest.mark.slow
def test_resume__steps_left_are_those_of_a_pace_that_was_changed_after_them(
    scratch: Path, tank: dict[str, Any]
) -> None:
    path = scratch / "tank.mcap"
    with node_on_bus(scratch / "first", **tank, record=str(path)) as (node, bus):
        bus.pause("tank")
        bus.step("tank", 10)
        bus.pace("tank", mode="lockstep")
        levels(bus, 4)
        until(lambda: (0, 4) in samples(path), "the recorder has written step 4")
        node.kill()
    with node_on_bus(scratch / "second", **tank, resume=str(path)) as (_, bus):
        status = bus.status("tank")
        assert (status.paused, status.step, status.steps_left) == (True, [4], 6)


def _leave_without_answer(bus: zenostat.Bus) -> int:
    """Step while a controller that has left misses the deadline of each step, long before the end of its grace time."""
    with bus.controller("tank", name="filler", priority=12) as link:
        sample = link.reset(seed=1)
        with bus.controller("tank", name="guard", priority=10) as guard:
            guard.current().send({"pump": 50.0})
            sample.send({"pump": 10.0})
            sample = link.receive()
        for number in range(3):
            sample.send({"pump": 20.0 + number})
            sample = link.receive()
        return sample.step


@pytest.mark.slow
def test_resume__command_takes_the_settings_of_the_recorded_plant(scratch: Path, tank: dict[str, Any]) -> None:
    path, endpoint = scratch / "tank.mcap", f"tcp/127.0.0.1:{free_port()}"
    policy = {"policy": "relinquish", "grace_s": 3600.0, "deadline_s": 0.2}
    with node_on_bus(scratch / "first", **tank, **policy, record=str(path)) as (node, bus):
        step = _leave_without_answer(bus)
        until(lambda: (1, step) in samples(path), "the recorder has written the last step")
        node.kill()
    assert EventKind.FALLBACK in kinds(path)
    options = ["--name", "tank", "--plant", tank["plant"], "--plant-argument", "area=3.0", "--listen", endpoint]
    other = run("node", *options, "--resume", str(path), "--policy", "hold", columns=500)
    assert "its policy is relinquish, not hold" in other.stderr
    with subprocess.Popen([*ZENOSTAT, "node", *options, "--resume", str(path)]) as resumed:
        try:
            until(lambda: run("status", "tank", "--connect", endpoint).returncode == 0, "the node goes on")
            with zenostat.connect(endpoint, affinity=Affinity.OFF) as bus:
                status, manifest = bus.status("tank"), bus.manifest("tank")
            assert status.step[0] >= step
            assert (manifest.policy, manifest.grace_s, manifest.deadline_s) == tuple(policy.values())
        finally:
            resumed.terminate()


@pytest.mark.slow
def test_resume__rejected_messages_beyond_those_with_published_events_have_no_effect(
    scratch: Path, tank: dict[str, Any]
) -> None:
    path, long = scratch / "tank.mcap", "p" * 127 + "…"  # the part of a long name that is recorded
    expected = {"ü": 25, long: 2, "ann": 1, "stranger": 130}
    with node_on_bus(scratch / "first", **tank, record=str(path)) as (node, bus):
        with bus.controller("tank", name="filler") as link:
            link.current()
            for _ in range(3):
                link.send({"pump": 10.0})
                link.receive()
            expected[link.name] = 101
            for sender, count in (("ü", 25), ("p" * 999, 1)):
                for number in range(count):
                    _write(bus, sender, 20.0 + number)
            bus.session.put(keys.COMMAND.at("tank", sender="p" * 60_000), b"")
            _write(bus, "ann", 90.0, source="somebody")
            bus.write("tank", "pump", 30.0, priority=16, source="ann")
            for number in range(130):
                wrong = Command(episode=[0], step=[3], values=np.array([999.0]).tobytes())
                masked = wrong.model_copy(update={"operations": b"\1"})  # not on the fast path
                bus.session.put(keys.COMMAND.at("tank", sender="stranger"), codec.encode(masked))
                if number <= 100:  # a valid one would be accepted, since the step waits for it
                    bus.session.put(keys.COMMAND.at("tank", sender=link.name), codec.encode(masked))
            statistics = until(
                lambda: (s := bus.status("tank").statistics).rejected + s.rate_limited >= sum(expected.values()) and s,
                "all are rejected",
            )
            assert statistics.rate_limited == 32, "31 of the stranger and the long name, 1 of the filler"
            right = masked.model_copy(update={"values": np.array([12.0]).tobytes()})  # the step waits for it
            bus.session.put(keys.COMMAND.at("tank", sender=link.name), codec.encode(right))
            until(lambda: (0, 4) in samples(path), "the recorder has written step 4")
        node.kill()
    with node_on_bus(scratch / "second", **tank, resume=str(path)) as (_, bus):
        assert bus.status("tank").step == [4]
    rejected = [entry.source for entry in recording.load(path).log if not entry.is_accepted]
    assert {sender: rejected.count(sender) for sender in expected} == expected


def _write(bus: zenostat.Bus, sender: str, value: float, source: str = "") -> None:
    payload = codec.encode(Write(value=value, source=source))
    bus.session.put(keys.ACTUATOR.at("tank", name="pump", sender=sender), payload)


@pytest.mark.slow
def test_resume__model_may_be_in_another_folder(scratch: Path, settings: dict[str, Any]) -> None:
    path, first, second = scratch / "run.mcap", scratch / "first.idf", scratch / "second.idf"
    first.write_bytes(find_building("ref-small-office").path.read_bytes())
    with (
        node_on_bus(scratch / "first", **{**settings, "building": str(first)}, record=str(path)) as (node, bus),
        Day(bus) as day,
    ):
        day.play(10)
        until(lambda: is_recorded(path, 10), "it is recorded")
        node.kill()
    first.rename(second)
    with node_on_bus(scratch / "second", **{**settings, "building": str(second)}, resume=str(path)) as (_, bus):
        assert bus.status("office").step == [10]
    second.write_bytes(second.read_bytes().replace(b"10.76", b"10.75"))
    with pytest.raises(InvalidRecording, match=r"the model .*second\.idf has changed"):
        NodeProgram(scratch / "third", **{**settings, "building": str(second)}, resume=str(path))


@pytest.mark.slow
def test_resume__slots_with_snapshots_and_resets_of_their_own(scratch: Path, settings: dict[str, Any]) -> None:
    path = scratch / "slots.mcap"
    (scratch / "faults.yaml").write_text(yaml12.dump(FAULTS))
    noise = {"weather_noise": {"dry_bulb_temperature": {"sigma": 3.0, "mu": 0.0, "tau_h": 5.0}}}
    several = {**settings, **noise, "slots": 2, "weather": ["USA_CO_Denver", "USA_FL_Miami"]}
    rng = np.random.default_rng(5)
    first = {**several, "faults": str(scratch / "faults.yaml"), "record": str(path)}
    with node_on_bus(scratch / "node", **first) as (_, bus), bus.controller("office") as link:
        low = np.array([a.low or 0.0 for a in link.manifest.actuators])
        high = np.array([a.high or 1.0 for a in link.manifest.actuators])
        sample = link.reset(seed=7)
        for number in range(40):
            link.send(rng.uniform(low, high, (2, len(low))))
            sample = link.receive()
            if number == 8:
                taken = bus.snapshot("office", controller=link.name)
            elif number == 12:
                sample = link.reset(slots=[1], seed=[4])
            elif number == 20:
                sample = link.reset(snapshot=taken.snapshot)
            elif number == 30:
                bus.write("office", COOLING[0], 27.0, priority=3, duration_s=1800.0, source="panel")
        last = bus.status("office")
    assert sample.message.step == last.step
    count = counted(path)
    for seed in range(6):
        copy = cut(path, scratch / f"{seed}.mcap", int(np.random.default_rng(seed).integers(8, count)))
        recorded = list(_positions(copy))[-1]
        with node_on_bus(scratch / f"node-{seed}", **several, resume=str(copy)) as (_, bus):
            status = bus.status("office")
            assert status.episode == recorded[0]
            assert [step - before for step, before in zip(status.step, recorded[1], strict=True)] in ([0, 0], [1, 1])
        assert verify(copy).passed


def _positions(path: Path) -> Iterator[tuple[list[int], list[int]]]:
    with RecordingReader(path) as reader:
        for item in reader.messages({"Sample"}):
            sample = msgpack.unpackb(item.payload)
            yield sample["episode"], sample["step"]


# What cannot go on


@pytest.mark.slow
def test_resume__says_why_it_cannot(
    scratch: Path, settings: dict[str, Any], reference: tuple[Path, tuple[Any, ...]]
) -> None:
    path, data = scratch / "run.mcap", reference[0].read_bytes()
    other = scratch / "other.yaml"
    other.write_text(ALARMS.replace("24.0", "25.0"))
    wrong = {
        r"the alarm rules are not the recorded ones": {"alarms": str(other)},
        r"the scenario is another one": {"begin": "07-02"},
        r"its policy is .*wait.*, not .*hold": {"policy": "hold"},
        r"a node that goes on with a recording goes on recording to it": {"record": str(scratch / "new.mcap")},
    }
    for text, changes in wrong.items():
        path.write_bytes(data)
        with pytest.raises((InvalidRecording, InvalidConfig), match=text):
            NodeProgram(scratch / "node", **{**settings, **changes}, resume=str(path))
        assert path.read_bytes() == data  # nothing has been written
    with open(path, "rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with pytest.raises(InvalidRecording, match="another node is recording to"):
            NodeProgram(scratch / "node", **settings, resume=str(path))
    with pytest.raises(InvalidRecording, match="No such file"):
        NodeProgram(scratch / "node", **settings, resume=str(scratch / "none.mcap"))


@pytest.mark.slow
def test_resume__changed_value_is_named(
    scratch: Path, settings: dict[str, Any], reference: tuple[Path, tuple[Any, ...]]
) -> None:
    changed = iter(range(10**6))

    def change(_: int, item: Any) -> bytes:
        if item.schema != "Sample" or next(changed) != 20:
            return bytes(item.payload)
        sample = msgpack.unpackb(item.payload)
        values = np.frombuffer(sample["values"]).copy()
        values[3] += 1e-9
        return bytes(msgpack.packb(sample | {"values": values.tobytes()}))

    path = cut(reference[0], scratch / "run.mcap", counted(reference[0]) // 2, change)
    with pytest.raises(InvalidRecording, match=r"step 19 \(2017-07-03T04:45:00\): core_zn_air_temperature is 23"):
        NodeProgram(scratch / "node", **settings, resume=str(path))


@pytest.mark.slow
@pytest.mark.parametrize("tail", [b"\0" * 5000, b"\x06" + (900).to_bytes(8, "little") + b"x" * 300])
def test_resume__drops_what_a_lost_power_left(
    tail: bytes, scratch: Path, settings: dict[str, Any], reference: tuple[Path, tuple[Any, ...]]
) -> None:
    path = cut(reference[0], scratch / "run.mcap", counted(reference[0]) // 3)
    path.write_bytes(path.read_bytes() + tail)
    _, end = play_to_end(scratch / "node", path, settings)
    assert end == reference[1]
    check(path, reference[0])


def test_resume__damage_that_is_not_at_the_end_is_an_error(
    scratch: Path, settings: dict[str, Any], reference: tuple[Path, tuple[Any, ...]]
) -> None:
    path = cut(reference[0], scratch / "run.mcap", counted(reference[0]) // 3)
    path.write_bytes(path.read_bytes() + b"\0" * (MAX_DROPPED + 1))
    with pytest.raises(InvalidRecording, match=rf"damaged after byte [\d,]+, and {MAX_DROPPED + 1:,} bytes follow"):
        NodeProgram(scratch / "node", **settings, resume=str(path))


# The command


@pytest.mark.slow
def test_resume__command_goes_on_with_the_recording_alone(
    scratch: Path, reference: tuple[Path, tuple[Any, ...]]
) -> None:
    path = cut(reference[0], scratch / "run.mcap", counted(reference[0]) // 2)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    command = [*ZENOSTAT, "--log", "json", "node", "--resume", str(path), "--listen", endpoint]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as node:
        try:
            until(lambda: run("status", "office", "--connect", endpoint).returncode == 0, "the node goes on")
            with zenostat.connect(endpoint, affinity=Affinity.OFF) as bus:
                with Day(bus) as day:
                    day.play()
                assert outcome(bus) == reference[1]
        finally:
            node.terminate()
            _, errors = node.communicate()
    assert node.returncode in (0, 143), errors
    check(path, reference[0])


def test_resume__command_names_what_does_not_go_together(
    scratch: Path, reference: tuple[Path, tuple[Any, ...]]
) -> None:
    resume = ("node", "--resume", str(reference[0]))
    cases = {
        "leave --record out": (*resume, "--record", str(scratch / "a.mcap")),
        "--mode, --speed: the recording of --resume determines": (*resume, "--mode", "paced", "--speed", "2"),
        "No such file": ("node", "--resume", str(scratch / "none.mcap")),
    }
    for text, arguments in cases.items():
        done = run(*arguments, columns=500)
        assert done.returncode != 0
        assert text in done.stderr
        assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_resume__command_of_a_service_starts_a_recording_and_goes_on_with_it(scratch: Path) -> None:
    path, endpoint = scratch / "run.mcap", f"tcp/127.0.0.1:{free_port()}"
    options = ["--building", "ref-small-office", "--weather", "USA_CO_Denver", "--begin", "07-03", "--end", "07-03"]
    pace = ["--name", "office", "--mode", "paced", "--speed", "3600", "--listen", endpoint]
    for _ in range(3):
        before = _recorded(path)
        with subprocess.Popen([*ZENOSTAT, "node", *options, *pace, "--resume", str(path)]) as node:
            try:
                until(lambda before=before: _recorded(path) > before + 3, "it has recorded more steps")
            finally:
                os.kill(node.pid, signal.SIGKILL)
    result = verify(path)
    assert result.passed, str(result)
    assert result.steps == max(samples(path))[1]
    assert kinds(path).count(EventKind.RESUMED) == 2


def _recorded(path: Path) -> int:
    try:
        return len(samples(path))
    except InvalidRecording:
        return 0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_resume__recording_of_a_stranger_is_data(seed: int, scratch: Path, tank: dict[str, Any]) -> None:
    """Messages with random bytes either change nothing that counts, or are an error of the recording."""
    path, rng = scratch / "tank.mcap", np.random.default_rng(seed)
    with node_on_bus(scratch / "first", **tank, record=str(path)) as (_, bus):
        bus.write("tank", "pump", 3.0, priority=12, duration_s=600.0)
        levels(bus, 10)

    def change(_: int, item: Any) -> bytes:
        raw = bytearray(item.payload)
        if item.schema in ("Manifest", "Sample", "RecordedWeather") or rng.random() > 0.15 or not raw:
            return bytes(raw)
        for place in rng.integers(0, len(raw), rng.integers(1, 4)):
            raw[place] = rng.integers(256)
        return bytes(raw)

    hostile = cut(path, scratch / "hostile.mcap", counted(path), change)
    before = hostile.read_bytes()
    try:
        with node_on_bus(scratch / "second", **tank, resume=str(hostile)) as (_, bus):
            assert bus.status("tank").step == [10]
    except (InvalidRecording, PlantFailed):
        assert hostile.read_bytes() == before
