"""A recording in the formats of other programs: the monitor's, and MCAP with protobuf messages."""

import math
import os
import shutil
from collections import defaultdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rerun as rr
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from rerun.chunk import RrdReader
from support.nodes import SMALL, WEATHER, NodeProgram, until
from support.recordings import rewrite
from support.run_cli import run_in_process as run

import zenostat
from zenostat import recording
from zenostat.bridge.transport.session import open_session
from zenostat.cli.monitor_stream import open_stream
from zenostat.metrics.recording.mcap_export import field_names

FAULTS = "faults: [{kind: bias, points: [core_zn_air_temperature], offset: 2.5}]"
CORE, SETPOINT = "core_zn_air_temperature", "core_zn_cooling_setpoint"


@pytest.fixture(scope="module")
def watched(module_scratch: Path) -> Any:
    """A recording of two slots with faults and a baseline, and what the monitor saved in the meantime."""
    path, live = module_scratch / "watched.mcap", module_scratch / "live.rrd"
    (module_scratch / "faults.yaml").write_text(FAULTS)
    settings = {**SMALL, "weather": [WEATHER], "slots": 2, "baseline": True, "monitoring": True}
    settings |= {"faults": str(module_scratch / "faults.yaml"), "record": str(path)}
    with (
        pytest.MonkeyPatch.context() as patch,
        NodeProgram(module_scratch / "watched", **settings) as program,
        open_session(connect=[program.endpoint]) as session,
        open_stream(session, "*", [rr.FileSink(str(live))], is_live=False) as stream,
        zenostat.connect(program.endpoint, affinity="off") as bus,
        bus.controller("office", name="rbc") as link,
    ):
        patch.setattr("zenostat.views.live.stream.MAX_WAIT_S", math.inf)  # how often it logs does not depend on load
        for steps in (96, 20):
            sample = link.reset(seed=1)
            for number in range(steps):
                values = np.zeros((2, len(link.manifest.actuators)))
                values[:] = [24.0 + number % 3 if "cooling" in a.name else 20.0 for a in link.manifest.actuators]
                link.send(values, bytes(values.size) if number else None)
                if number == 3:
                    bus.write("office", SETPOINT, 27.0, priority=3, duration_s=3600.0, source="plc7")
                sample = link.receive()
                stream.pump()
        assert sample.step == 20
        until(lambda: stream.pump() == 0 and stream.samples >= 97 + 21, "the monitor has all samples")
        assert stream.missed == 0
    return SimpleNamespace(path=path, live=live)


def logged(path: Path) -> tuple[dict[tuple[str, str], dict[int, Any]], dict[tuple[str, str], Any]]:
    """Contents of a Rerun recording: by entity and component, the value at each step, and the static ones."""
    moving: dict[tuple[str, str], dict[int, Any]] = defaultdict(dict)
    static = {}
    for chunk in RrdReader(str(path)).stream():
        columns = chunk.to_record_batch().to_pydict()
        for name, values in columns.items():
            if name.startswith(("rerun.controls", "log_t")) or name in ("step", "simulated"):
                continue
            if chunk.is_static:
                static[str(chunk.entity_path), name] = values[-1]
            elif "step" in columns:
                moving[str(chunk.entity_path), name].update(zip(columns["step"], values, strict=True))
    return moving, static


@pytest.mark.slow
def test_recording__rerun_recording_is_what_the_monitor_saved(watched: Any, scratch: Path) -> None:
    target = scratch / "run.rrd"
    result = run("export", str(watched.path), "--to", "rrd", "--out", str(target))
    assert result.returncode == 0, result.stderr
    assert "slot 0 is shown" in result.stderr
    (ours, our_static), (live, live_static) = logged(target), logged(watched.live)
    episodes = ("/office/episode_0001/", "/office/episode_0002/")  # the monitor missed how episode 0 began
    texts = ("/events", "/numbers", "/status")
    for mine, other in ((ours, live), (our_static, live_static)):
        of_ours = {key: v for key, v in mine.items() if key[0].startswith(episodes) and "row_id" not in key[1]}
        of_live = {key: v for key, v in other.items() if key[0].startswith(episodes) and "row_id" not in key[1]}
        assert {entity for entity, _ in of_ours} == {entity for entity, _ in of_live}
        for key in of_live:
            if not key[0].endswith(texts):
                assert repr(of_ours[key]) == repr(of_live[key]), key
    scalars = ours["/office/episode_0001/temperatures", "Scalars:scalars"]
    assert sorted(scalars) == list(range(97))
    assert any(entity.startswith("/office/episode_0001/building") for entity, _ in our_static)


def read(path: Path) -> dict[str, list[Any]]:
    """By topic: schema's name, channel's metadata, times and decoded message of each message."""
    messages = defaultdict(list)
    with path.open("rb") as file:
        for schema, channel, message, decoded in make_reader(
            file, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages(log_time_order=False):
            messages[channel.topic].append((schema, channel, message, decoded))
    return messages


@pytest.mark.slow
def test_recording__each_sample_is_a_protobuf_message_with_named_fields(watched: Any, scratch: Path) -> None:
    target = scratch / "run.plot.mcap"
    result = run("export", str(watched.path), "--to", "mcap", "--out", str(target))
    assert result.returncode == 0, result.stderr
    messages, loaded = read(target), recording.load(watched.path)
    epoch = np.datetime64(0, "ns")
    previous = 0
    with target.open("rb") as file:
        for _, _, message in make_reader(file).iter_messages(log_time_order=False):
            assert previous <= message.log_time == message.publish_time
            previous = message.log_time
    names, units = loaded.manifest.names, {p.name: p.unit for p in loaded.manifest.points}
    assert [len(e) for e in loaded.episodes if e.number == 1] == [97, 97]
    for episode in loaded.episodes:
        root = f"/office/episode_{episode.number:04}/slot_{episode.slot}"
        tables = {
            "points": (names, episode.values),
            "fault_free": (names, episode.fault_free_values),
            "baseline": (names, episode.baseline),
            "effective": (episode.actuators, episode.effective),
            "orders": (episode.actuators, episode.orders),
            "baseline_effective": (episode.actuators, episode.baseline_effective),
        }
        for topic, (fields, table) in tables.items():
            rows = messages[f"{root}/{topic}"]
            decoded = np.array([[getattr(row[3], name) for name in fields] for row in rows])
            assert decoded.tobytes() == np.ascontiguousarray(table).tobytes(), topic
            assert all(row[3].HasField(name) for row in rows for name in fields)  # zeros are written as well
            assert [row[3].step for row in rows] == episode.step.tolist()
            times = [epoch + np.timedelta64(row[2].log_time, "ns") for row in rows]
            assert times == list(episode.time)
            assert [row[3].timestamp.ToNanoseconds() for row in rows] == [row[2].log_time for row in rows]
            walls = [epoch + np.timedelta64(row[3].wall_time.ToNanoseconds(), "ns") for row in rows]
            assert walls == list(episode.wall_time)
        sources = [getattr(row[3], SETPOINT) for row in messages[f"{root}/sources"]]
        assert sources == episode.value_source(SETPOINT).tolist()
    schema, channel, *_ = messages["/office/episode_0001/slot_0/points"][0]
    assert (schema.name, schema.encoding, channel.message_encoding) == ("zenostat.Points", "protobuf", "protobuf")
    assert channel.metadata[f"unit.{CORE}"] == units[CORE] == "degC"
    events = messages["/office/episode_0001/slot_0/events"]
    assert events[0][0].name == "foxglove.Log"
    (write,) = [row for row in events if row[3].message.startswith("written")]
    assert (write[3].name, write[3].level) == ("plc7", 2)
    assert SETPOINT in write[3].message
    begin = np.datetime64(loaded.manifest.begin, "ns")
    step = (epoch + np.timedelta64(write[2].log_time, "ns") - begin) / np.timedelta64(900, "s")
    assert step in (3.0, 4.0)  # the step of the event


def test_recording__names_that_are_no_identifiers_become_unique_ones() -> None:
    names = ["a.b", "a-b", "a_b", "1st", "step", "timestamp", "ä"]
    assert field_names(names) == ["a_b", "a_b_2", "a_b_3", "_1st", "step_2", "timestamp_2", "_"]


@pytest.mark.slow
def test_recording__names_of_the_points_are_in_the_metadata(watched: Any, scratch: Path) -> None:
    loaded = recording.load(watched.path)
    old = loaded.manifest.sensors[0]
    dotted = old.model_copy(update={"name": "zone-1.temperature"})
    changed = loaded.manifest.model_copy(update={"sensors": (dotted, *loaded.manifest.sensors[1:])})
    path = rewrite(watched.path, scratch / "dotted.mcap", manifest=changed)
    recording.write_mcap(recording.load(path), scratch / "dotted.plot.mcap")
    (_, channel, _, decoded), *_ = read(scratch / "dotted.plot.mcap")["/office/episode_0001/slot_0/points"]
    assert channel.metadata["name.zone_1_temperature"] == "zone-1.temperature"
    assert channel.metadata["unit.zone_1_temperature"] == old.unit
    assert decoded.zone_1_temperature == loaded.episodes[2].values[0, 0]


@pytest.mark.slow
def test_recording__name_of_the_file_need_not_be_utf_8(watched: Any, scratch: Path) -> None:
    file = scratch / os.fsdecode(b"b\xfcro.mcap")  # in ISO 8859-1
    shutil.copyfile(watched.path, file)
    for to, suffix in (("mcap", ".plot.mcap"), ("parquet", ".parquet"), ("csv", ".csv"), ("rrd", ".rrd")):
        assert run("export", str(file), "--to", to).returncode == 0
        assert file.with_suffix(suffix).stat().st_size > 0
    with file.with_suffix(".plot.mcap").open("rb") as exported:
        about = next(each for each in make_reader(exported).iter_metadata() if each.name == "zenostat")
    assert about.metadata["recording"] == "b\N{REPLACEMENT CHARACTER}ro.mcap"
    report = scratch / "report.html"
    assert run("report", str(file), "--out", str(report)).returncode == 0
    assert "b\N{REPLACEMENT CHARACTER}ro.mcap" in report.read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("to", ["rrd", "mcap", "csv"])
def test_recording__what_cannot_be_exported_is_one_error(watched: Any, scratch: Path, to: str) -> None:
    empty = rewrite(
        watched.path, scratch / "empty.mcap", lambda _, item: None if item.schema == "Sample" else item.payload
    )
    result = run("export", str(empty), "--to", to, "--out", str(scratch / f"empty.{'x.' if to == 'mcap' else ''}{to}"))
    assert result.returncode != 0
    assert "empty.mcap has no samples" in result.stderr
    assert sorted(scratch.iterdir()) == [empty]  # nothing half-written
    result = run("export", str(empty), "--to", to, "--out", str(scratch / "run.txt"))
    assert f"expected a .{to} file" in result.stderr
    result = run("export", str(empty), "--to", to, "--out", f"/proc/run.{to}")
    assert f"--out /proc/run.{to}: no file can be written in /proc" in result.stderr
    result = run("export", str(empty), "--to", "mcap", "--out", str(empty))
    assert "that is the recording itself" in result.stderr
