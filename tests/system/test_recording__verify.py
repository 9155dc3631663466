"""A recording of a real node verifies to the bit, whatever happened to the node; what was changed in it is named."""

from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import psutil
import pytest
from support.nodes import SMALL, NodeProgram, node_on_bus, until
from support.recordings import rewrite
from support.run_cli import run_in_process as run

import zenostat
from zenostat.bridge.recording.reader import RecordingReader
from zenostat.eplus_node.verify_recording import verify
from zenostat.metrics.recording import load
from zenostat.models.catalog import find_building
from zenostat.topics import codec
from zenostat.topics.errors import InvalidConfig, InvalidRecording, RequestRejected
from zenostat.topics.messages import Event, EventKind, Flag, RecordingState

TWO = {"weather": ["USA_CO_Denver", "USA_FL_Miami"]}
NOISE = {"weather_noise": {"dry_bulb_temperature": {"sigma": 3.0, "mu": 0.0, "tau_h": 5.0}}}
FAULTS = """
seed: 3
faults:
  - {kind: bias, points: [core_zn_air_temperature], offset: 2.5}
  - {kind: noise, points: [perimeter_zn_1_air_temperature], sigma: 0.5}
  - {kind: drop, points: [perimeter_zn_2_air_temperature], when: {from_step: 5, to_step: 9}}
  - {kind: bias, actuators: [core_zn_cooling_setpoint], offset: -0.5, when: {from_step: 12, to_step: 30}}
  - {kind: latency, samples: true, delay_ms: 2}
  - {kind: duplicate, samples: true, probability: 0.3}
"""
SETPOINT = "core_zn_cooling_setpoint"


def setpoints(manifest: Any, rng: np.random.Generator) -> np.ndarray[Any, Any]:
    low = np.array([a.low if a.low is not None else 0.0 for a in manifest.actuators])
    high = np.array([a.high if a.high is not None else 1.0 for a in manifest.actuators])
    return rng.uniform(low, high, (manifest.slots, len(low)))


@pytest.fixture(scope="module")
def eventful(module_scratch: Path) -> Path:
    """A recording of three slots with noise, two weathers, faults, writes, expiries, snapshots and partial resets."""
    folder, rng = module_scratch, np.random.default_rng(5)
    (folder / "faults.yaml").write_text(FAULTS)
    path = folder / "eventful.mcap"
    settings = {**SMALL, **TWO, **NOISE, "slots": 3, "faults": str(folder / "faults.yaml"), "record": str(path)}
    with node_on_bus(folder / "eventful", **settings) as (_, bus), bus.controller("office", name="random") as link:
        sample = link.reset(seed=7)
        for number in range(40):
            sample.send(setpoints(link.manifest, rng))
            sample = link.receive()
            if number == 5:
                bus.write("office", SETPOINT, 27.0, priority=3, duration_s=3600.0, source="plc7")
            if number == 10:
                taken = bus.snapshot("office", controller=link.name)
            if number == 15:
                bus.write("office", SETPOINT, 26.0, priority=4, source="plc7")
            if number == 20:
                link.send(setpoints(link.manifest, rng), still=(1,))
                sample = link.receive()
        sample = link.reset(snapshot=taken.snapshot)
        for _ in range(10):
            sample.send(setpoints(link.manifest, rng))
            sample = link.receive()
        sample = link.reset(slots=[1], seed=11)
        for _ in range(100):
            if sample.truncated:
                break
            link.send(setpoints(link.manifest, rng))
            sample = link.receive()
        for _ in range(3):
            link.send(setpoints(link.manifest, rng), still=(0, 2))
            link.receive()
        link.reset(slots=[0], seed=12)
        link.send(setpoints(link.manifest, rng), still=(2,))
        link.receive()
    return path


@pytest.mark.slow
def test_recording__slots_noise_faults_writes_snapshots_and_partial_resets_verify_to_the_bit(eventful: Path) -> None:
    with RecordingReader(eventful) as reader:
        orders = [msgpack.unpackb(i.payload)["slots"] for i in reader.messages({"RecordedOrder"})]
        samples = [msgpack.unpackb(i.payload) for i in reader.messages({"Sample"})]
        assert reader.end.is_complete
    assert [0, 2] in orders  # the slot that paused
    assert any(s["values"] != s["fault_free_values"] for s in samples)
    result = verify(eventful)
    assert result.passed, str(result)
    assert result.difference is None
    assert not result.skipped
    assert result.steps == sum(map(len, orders))
    # At the start, reset, return to the snapshot, reset of one slot, and of one while another one is over.
    assert result.episodes == 3 + 3 + 3 + 1 + 1
    assert {(1,), (0, 1)} <= {*map(tuple, orders)}, "some go on after the others have ended"


@pytest.mark.slow
def test_recording__noise_from_the_third_day_two_controllers_and_a_fallback_policy_verify_to_the_bit(
    scratch: Path,
) -> None:
    """One of the controllers stops answering, and what it commanded is relinquished; each episode is a fork."""
    path, rng = scratch / "policies.mcap", np.random.default_rng(2)
    settings = {**SMALL, **NOISE, "noise_start": "third_day", "end": "07-06", "record": str(path)}
    policy = {"policy": "relinquish", "deadline_s": 0.5}
    zones = {"core": ["core_zn_heating_setpoint", SETPOINT], "north": ["perimeter_zn_3_cooling_setpoint"]}
    with (
        node_on_bus(scratch / "policies", **settings, **policy) as (_, bus),
        bus.controller("office", name="core", actuators=zones["core"]) as core,
    ):

        def steps(count: int, *others: Any) -> None:
            for _ in range(count):
                core.send({zones["core"][0]: rng.uniform(15, 20), SETPOINT: rng.uniform(24, 28)})
                for other in others:
                    other.send({zones["north"][0]: rng.uniform(24, 28)})
                for link in (core, *others):
                    link.receive()

        with bus.controller("office", name="north", actuators=zones["north"], priority=11) as north:
            core.reset(seed=1)
            while north.current().episode != 1:
                pass
            steps(5, north)
            steps(2)
        steps(4 * 96 - 7)
        core.reset(seed=2)
        steps(2 * 96 + 20)
    result = verify(path)
    assert result.passed, str(result)
    assert result.steps == 4 * 96 + 2 * 96 + 20
    first, second = (e for e in load(path).episodes if len(e) > 1)
    assert {name.partition("-")[0] for name in first.sources} == {"", "core", "north"}
    fallbacks = np.flatnonzero(first.flags & Flag.FALLBACK)
    assert {6, 7} <= {*first.step[fallbacks].tolist()}
    outdoors = [episode["outdoor_temperature"] for episode in (first, second)]
    assert np.array_equal(outdoors[0][: 2 * 96], outdoors[1][: 2 * 96])
    assert not np.array_equal(outdoors[0][2 * 96 : 2 * 96 + 20], outdoors[1][2 * 96 : 2 * 96 + 20])


@pytest.mark.slow
def test_recording__what_is_not_here_is_named_before_anything_is_simulated(eventful: Path, scratch: Path) -> None:
    with RecordingReader(eventful) as reader:
        provenance = reader.provenance
    files, settings = provenance["files"], provenance["settings"]
    other = {"path": files["engine"]["path"], "sha256": "0" * 64}
    cases = {
        "the engine .* has changed; a tolerance compares it nevertheless": {"files": {**files, "engine": other}},
        "the weather 2 .* has changed": {"files": {**files, "weather 2": {**files["weather 2"], "sha256": "1" * 64}}},
        "cannot be simulated here: no weather file at /nowhere/a.epw": {
            "settings": {**settings, "weather": ["/nowhere/a.epw", "USA_FL_Miami"]}
        },
        "cannot be simulated here: no building file at /nowhere/a.idf": {
            "settings": {**settings, "building": "/nowhere/a.idf"}
        },
    }
    for number, (text, changes) in enumerate(cases.items()):
        path = rewrite(eventful, scratch / f"{number}.mcap", provenance={**provenance, **changes})
        with pytest.raises(InvalidRecording, match=text):
            verify(path)
        done = run("verify", str(path), columns=500)
        assert done.returncode != 0
        assert "Traceback" not in done.stderr
        assert len(done.stderr.strip().splitlines()) == 1
        assert len(load(path).episodes) == len(load(eventful).episodes)  # what can be read is read


@pytest.mark.slow
def test_recording__changed_file_of_the_model_is_named(scratch: Path) -> None:
    """Its last hours are read after the recorded ones; each sample is equal to the bit."""
    table, path = scratch / "people.csv", scratch / "day.mcap"
    table.write_text("0.5\n" * 8760)
    schedule = {"file_name": str(table), "column_number": 1, "rows_to_skip_at_top": 0, "number_of_hours_of_data": 8760}
    settings = {**SMALL, "edits": {"Schedule:File": {"people": schedule}}, "record": str(path)}
    with node_on_bus(scratch / "day", **settings) as (_, bus), bus.controller("office") as link:
        for number, _ in enumerate(link):
            if number == 5:
                break
    assert verify(path).passed
    table.write_text("0.5\n" * 8700 + "0.7\n" * 60)
    with pytest.raises(InvalidRecording, match=r"the file of Schedule:File 'people' .*people\.csv has changed"):
        verify(path)
    result = verify(path, tolerance=0.01)
    assert result.passed
    assert result.notes == [f"the file of Schedule:File 'people' {table} has changed"]
    done = run("node", "--resume", str(path), columns=500)
    assert done.returncode != 0, "the node does not go on with another file"
    assert "the file of Schedule:File 'people'" in done.stderr


@pytest.mark.slow
def test_recording__changed_model_is_a_regression_test(scratch: Path) -> None:
    model, path = scratch / "office.idf", scratch / "day.mcap"
    model.write_bytes(find_building("ref-small-office").path.read_bytes())
    settings = {**SMALL, "building": str(model), "record": str(path)}
    with node_on_bus(scratch / "day", **settings) as (_, bus), bus.controller("office") as link:
        for number, _ in enumerate(link):
            if number == 20:
                break
    text = model.read_text(encoding="latin-1")
    lower = text.replace("10.76", "8.0")  # W/m2 of lights
    assert lower != text
    model.write_text(lower, encoding="latin-1")
    with pytest.raises(InvalidRecording, match=r"the model .*office\.idf has changed"):
        verify(path)
    result = verify(path, tolerance=0.01)
    assert not result.passed
    assert result.steps == 20
    assert result.difference is None
    assert result.greatest["outdoor_temperature"] == 0.0
    assert result.greatest["core_zn_air_temperature"] > 0.01
    done = run("verify", str(path), "--tolerance", "0.01")
    assert done.returncode == 1
    assert "core_zn_air_temperature" in done.stdout
    assert run("verify", str(path), "--tolerance", "1e12").returncode == 0
    model.unlink()
    with pytest.raises(InvalidRecording, match=r"cannot be simulated here: no building file at .*office\.idf"):
        verify(path)


def test_recording__killed_node_leaves_a_file_that_verifies_to_its_end(scratch: Path) -> None:
    path = scratch / "killed.mcap"
    program = NodeProgram(scratch / "killed", **SMALL, record=str(path), monitoring=True, baseline=True)
    try:
        with zenostat.connect(program.endpoint, affinity="off") as bus, bus.controller("office") as link:
            sample = link.current()
            for _ in range(30):
                sample.send()
                sample = link.receive()

            def written() -> int:
                with RecordingReader(path) as reader:
                    return sum(1 for _ in reader.messages({"Sample"}))

            until(lambda: path.stat().st_size > 10_000 and written() == 31, "the last chunk is written")
            with RecordingReader(path) as reader:
                list(reader.messages())
                assert reader.end.text == "it is still being recorded"
    finally:
        program.kill()
        program.close()
    result = verify(path)
    assert result.passed, str(result)
    assert result.steps == 30
    assert "cut off" in result.end


@pytest.mark.slow
def test_recording__running_node_is_recorded_from_its_next_reset(shared_node: NodeProgram, scratch: Path) -> None:
    path = scratch / "running.mcap"
    with zenostat.connect(shared_node.endpoint, affinity="off") as bus, bus.controller("office") as link:
        link.reset()
        link.send()
        link.receive()
        assert bus.record("office", path).state is RecordingState.ARMED
        assert bus.status("office").recording.state is RecordingState.ARMED
        with pytest.raises(RequestRejected, match="recording to"):
            bus.record("office", path)
        link.send()
        link.receive()
        assert not path.exists()
        link.reset()
        for _ in range(3):
            link.send()
            link.receive()
        status = bus.stop_recording("office")
        assert status.state is RecordingState.ENDED
        assert status.messages > 9
        with pytest.raises(RequestRejected, match="not recording"):
            bus.stop_recording("office")
    result = verify(path)
    assert result.passed, str(result)
    assert (result.steps, result.episodes) == (3, 1)


@pytest.mark.slow
def test_recording__recording_from_within_an_episode_names_what_it_cannot_verify(
    shared_node: NodeProgram, scratch: Path
) -> None:
    path = scratch / "now.mcap"
    with zenostat.connect(shared_node.endpoint, affinity="off") as bus, bus.controller("office") as link:
        link.reset()
        before = bus.snapshot("office", controller=link.name)
        assert bus.record("office", path, now=True).state is RecordingState.RECORDING
        for _ in range(2):
            link.send()
            link.receive()
        link.reset(snapshot=before.snapshot)
        link.send()
        link.receive()
        link.reset()
        link.send()
        link.receive()
        bus.stop_recording("office")
    result = verify(path)
    assert result.passed, str(result)
    assert (result.steps, result.episodes) == (1, 1)
    assert result.skipped[0].startswith("4 samples of episodes whose start is not in the recording")
    assert "taken before the recording began" in result.skipped[1]


@pytest.mark.slow
def test_recording__recording_without_a_timestep_is_reported(shared_node: NodeProgram, scratch: Path) -> None:
    path = scratch / "none.mcap"
    with zenostat.connect(shared_node.endpoint, affinity="off") as bus, bus.controller("office") as link:
        bus.record("office", path)
        link.reset()
        bus.stop_recording("office")
    result = verify(path)
    assert (result.passed, result.steps, result.points > 0) == (True, 0, True)
    assert str(result) == "identical: the first sample of 1 episode, after which there is no timestep"


@pytest.mark.slow
def test_recording__full_disk_stops_the_recording_by_name_and_not_the_node(scratch: Path) -> None:
    path = scratch / "full.mcap"
    with node_on_bus(scratch / "full", **SMALL, record=str(path)) as (program, bus), bus.controller("office") as link:
        until(lambda: bus.status("office").recording.messages, "the first chunk is written")
        limit = path.stat().st_size + 1000  # less than the next chunk
        node = psutil.Process(program.pid)
        unlimited = node.rlimit(psutil.RLIMIT_FSIZE)
        node.rlimit(psutil.RLIMIT_FSIZE, (limit, unlimited[1]))
        for sample in link:
            if sample.step == 50:
                break
        status = until(
            lambda: (r := bus.status("office").recording).state is RecordingState.STOPPED and r, "it has stopped"
        )
        assert status.reason == f"cannot write {path}: File too large"
        link.send()
        assert link.receive().step == 51  # the node goes on
        node.rlimit(psutil.RLIMIT_FSIZE, unlimited)
        assert bus.record("office", scratch / "second.mcap", now=True).state is RecordingState.RECORDING
    assert path.stat().st_size <= limit
    assert verify(path).passed
    with RecordingReader(scratch / "second.mcap") as reader:
        events = [codec.decode(Event, item.payload) for item in reader.messages({"Event"})]
    assert events[0].kind is EventKind.RECORDING


@pytest.mark.slow
def test_recording__recording_that_cannot_begin_is_an_error_before_anything_starts(scratch: Path) -> None:
    path = scratch / "run.mcap"
    path.write_text("mine")
    for settings in ({}, {"record_overwrite": True}, {"check": True}):
        with pytest.raises(InvalidConfig, match=r"run\.mcap exists"):
            NodeProgram(scratch / "node", **SMALL, record=str(path), **settings)
    assert path.read_text() == "mine"
    with pytest.raises(InvalidConfig, match=r"suffix \.mcap"):
        NodeProgram(scratch / "node", **SMALL, record=str(scratch / "run.csv"))


def test_recording__record_command_starts_and_ends_a_recording(shared_node: NodeProgram, scratch: Path) -> None:
    path, at = scratch / "command.mcap", ("--connect", shared_node.endpoint)
    done = run("record", "office", "--out", str(path), "--now", *at)
    assert done.stdout == f"office: recording to {path}\n"
    done = run("status", *at, columns=300)
    assert f"recording to {path}" in done.stdout
    done = run("record", "office", "--stop", *at)
    assert f"to {path}" in done.stdout
    with RecordingReader(path) as reader:
        assert list(reader.messages())
        assert reader.end.is_complete
    done = run("record", "office", "--out", str(path), *at)
    assert done.returncode != 0
    assert "exists; choose another name" in done.stderr
    assert run("record", "office", "--out", str(path), "--overwrite", *at).returncode == 0
    assert run("record", "office", "--stop", *at).returncode == 0  # armed, not begun
    path.write_text("mine")
    assert "is not a recording" in run("record", "office", "--out", str(path), "--overwrite", *at).stderr
    for words in ((), ("--out", str(path), "--stop")):
        assert "expected either --out FILE.mcap, or --stop" in run("record", "office", *words, *at).stderr
