"""Contents of a recording, equal to what a client on the bus received: arrays, tables, the log, and the replay."""

import json
import sys
import threading
import warnings
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import zenoh
from support.csv_files import csv_rows
from support.nodes import SMALL, node_on_bus, until
from support.recordings import chunk_ends, rewrite
from support.run_cli import run_in_process as run

import zenostat
from zenostat import recording
from zenostat.agent_sdk.semantic import SemanticGraph
from zenostat.bridge.recording.reader import RecordingReader
from zenostat.bridge.recording.replay import Replay, ReplayRange
from zenostat.bridge.transport.session import open_session
from zenostat.eplus_node.verify_recording import RecordedPlant
from zenostat.models.catalog import find_weather
from zenostat.topics import codec, keys
from zenostat.topics.errors import InvalidConfig, InvalidRecording, NameInUse, RequestRejected, UnknownName
from zenostat.topics.messages import Claim, Command, Mode, Sample, Write
from zenostat.topics.recording import RecordedWeather

SETPOINT, CORE = "core_zn_cooling_setpoint", "core_zn_air_temperature"


def put(bus: zenostat.Bus, key: str, message: Any) -> None:
    bus.session.put(key, codec.encode(message), encoding=zenoh.Encoding(codec.encoding(type(message))))


@pytest.fixture(scope="module")
def seen(module_scratch: Path) -> Any:
    """A recording, and what a controller saw and did in the meantime."""
    path = module_scratch / "seen.mcap"
    samples: list[Sample] = []
    sources: list[str] = []
    with (
        node_on_bus(module_scratch / "seen", **SMALL, record=str(path)) as (_, bus),
        bus.controller("office", name="rbc") as link,
    ):
        name, geometry, systems = link.name, bus.geometry("office"), bus.systems("office")
        turtle = bus.semantic("office")
        for seed, steps in ((1, 30), (2, 5)):
            sample = link.reset(seed=seed)
            for step in range(steps):
                samples.append(sample.message)
                sources.append(sample.value_source[SETPOINT])
                if (seed, step) == (1, 4):
                    bus.write("office", SETPOINT, 27.0, priority=3, duration_s=3600.0, source="plc7")
                    with pytest.raises(RequestRejected, match="is claimed by"):
                        bus.write("office", SETPOINT, 26.0, priority=10, source="plc8")
                if (seed, step) == (1, 20):
                    put(
                        bus,
                        keys.ACTUATOR.at("office", name=SETPOINT, sender="plc7"),
                        Write(value=25.0, priority=5, source="plc7"),
                    )
                    put(
                        bus, keys.ACTUATOR.at("office", name="nothing", sender="plc7"), Write(value=25.0, source="plc7")
                    )
                    until(lambda: bus.status("office").rejected == 2, "both writes are handled")
                sample.send({SETPOINT: 24.0 + step % 3})
                if (seed, step) == (1, 10):
                    answer = Command(episode=[1], step=[3], values=bytes(8 * len(link.manifest.actuators)))
                    put(bus, keys.COMMAND.at("office", sender=name), answer)
                sample = link.receive()
            samples.append(sample.message)
            sources.append(sample.value_source[SETPOINT])
    return SimpleNamespace(
        path=path, samples=samples, sources=sources, name=name, geometry=geometry, systems=systems, turtle=turtle
    )


@pytest.mark.slow
def test_recording__arrays_are_what_the_client_saw(seen: Any) -> None:
    loaded = recording.load(seen.path)
    assert loaded.is_complete
    assert loaded.note == ""
    assert [(e.number, e.slot, e.seed, len(e)) for e in loaded.episodes] == [
        (0, 0, None, 1),
        (1, 0, 1, 31),
        (2, 0, 2, 6),
    ]
    day = loaded.episodes[1]
    messages = seen.samples[:31]
    assert day.values.tobytes() == b"".join(m.values for m in messages)
    assert day.effective.tobytes() == b"".join(m.effective for m in messages)
    assert day.step.tolist() == [m.step[0] for m in messages]
    assert day.time.astype("datetime64[s]").tolist() == [datetime.fromisoformat(m.time[0]) for m in messages]
    assert day.flags.tolist() == [m.flags[0] for m in messages]
    assert day.value_source(SETPOINT).tolist() == seen.sources[:31]
    assert day.weather == SMALL["weather"]
    assert day.fault_free_values is day.values
    assert np.array_equal(day[CORE], day.values[:, loaded.manifest.names.index(CORE)])
    setpoint = day.actuators.index(SETPOINT)
    assert np.isnan(day.orders[0]).all()
    assert day.orders[1:4, setpoint].tolist() == [24.0, 25.0, 26.0]
    assert day.orders[5:9, setpoint].tolist() == [27.0] * 4  # the write, for an hour
    assert day.orders[9, setpoint] == 24.0 + 8 % 3
    assert np.array_equal(day[SETPOINT][1:], day.orders[1:, setpoint])
    with pytest.raises(UnknownName, match=CORE):
        day["core_zn_temperature"]
    with pytest.raises(UnknownName, match="no actuator"):
        day.value_source(CORE)
    assert loaded.scenario.startswith("building: ref-small-office")
    assert {"model", "weather 1", "engine"} <= set(loaded.provenance["files"])


def test_recording__weather_of_each_episode_is_recorded(seen: Any) -> None:
    """Once for each start of an episode, as the file has it: Denver on 3 July, in 24 hours."""
    with RecordingReader(seen.path) as reader:
        weathers = [codec.decode(RecordedWeather, item.payload) for item in reader.messages({"RecordedWeather"})]
    lines = find_weather(SMALL["weather"]).path.read_text(encoding="latin-1").splitlines()[8:]
    rows = [line.split(",") for line in lines if line.split(",")[1:3] == ["7", "3"]]
    expected = np.array([[float(row[6]), float(row[13])] for row in rows])  # columns of the format EPW
    assert [(weather.episode, weather.slot) for weather in weathers] == [(0, 0), (1, 0), (2, 0)]
    for weather in weathers:
        assert weather.columns == ["dry_bulb_temperature", "global_horizontal_radiation"]
        assert weather.step_s == 3600.0
        assert np.array_equal(np.frombuffer(weather.values).reshape(24, 2), expected)


def test_recording__log_has_senders_times_and_results(seen: Any) -> None:
    loaded = recording.load(seen.path)
    writes = [(e.source, e.subject, e.result, e.simulated) for e in loaded.log if e.kind == "write"]
    assert [w[:2] for w in writes] == [
        ("plc7", f"{SETPOINT} = 27.0 at priority 3 for 3600 s"),
        ("plc8", f"{SETPOINT} = 26.0 at priority 10"),
        ("plc7", f"{SETPOINT} = 25 degC at priority 5"),
        ("plc7", "nothing = 25.0 at priority 8"),
    ]
    assert writes[0][2:] == ("accepted", "2017-07-03T01:00:00")
    assert writes[1][2].startswith("RequestRejected: priority 10 of")
    assert writes[2][2:] == ("accepted", "2017-07-03T05:00:00")
    assert writes[3][2].startswith("rejected: no actuator 'nothing'")
    commands = [e for e in loaded.log if e.kind == "command" and e.source == seen.name]
    late = [e for e in commands if not e.is_accepted]
    assert [e.result.partition(":")[0] for e in late] == ["late"]
    assert "answers step [3] of episode [1]" in late[0].subject
    assert sum(e.count for e in commands if e.is_accepted) == 35
    assert [e.kind for e in loaded.log if e.source == seen.name][:2] == ["claim", "reset"]
    times = [e.time for e in loaded.log]
    assert times == sorted(times)
    assert recording.load_log(seen.path) == loaded.log


def test_recording__log_command_selects_by_source(seen: Any) -> None:
    done = run("log", str(seen.path), "--source", "plc7")
    assert done.returncode == 0
    assert len(done.stdout.splitlines()) == 1 + 3
    fields = json.loads(run("log", str(seen.path), "--source", "plc*", "--rejected", "--json").stdout)
    assert [f["source"] for f in fields] == ["plc8", "plc7"]
    done = run("log", str(seen.path), "--source", "plc9")
    assert done.returncode != 0
    assert "did you mean" in done.stderr


def test_recording__tables_have_exact_numbers(seen: Any, folder: Path) -> None:
    loaded = recording.load(seen.path)
    csv_file, parquet_file = folder / "run.csv", folder / "run.parquet"
    assert run("export", str(seen.path), "--to", "csv", "--out", str(csv_file)).returncode == 0
    assert run("export", str(seen.path), "--out", str(parquet_file)).returncode == 0
    rows = csv_rows(csv_file)
    table = pq.read_table(parquet_file)
    assert len(rows) == table.num_rows == 38
    expected = np.concatenate([episode[CORE] for episode in loaded.episodes])
    assert [float(row[CORE]) for row in rows] == expected.tolist()
    assert table[CORE].to_numpy().tolist() == expected.tolist()
    assert table.schema.field(CORE).metadata[b"unit"] == b"degC"
    assert [row[f"{SETPOINT}.source"] for row in rows[1:32]] == seen.sources[:31]
    assert table[f"{SETPOINT}.source"].to_pylist() == [row[f"{SETPOINT}.source"] for row in rows]
    assert rows[1]["time"].startswith("2017-07-03T00:00:00")
    done = run("export", str(seen.path), "--out", str(folder / "missing" / "run.parquet"))
    assert "there is no folder" in done.stderr


class Frame(dict[str, Any]):
    """Part of `pandas.DataFrame` that is used."""

    def set_index(self, name: str) -> tuple[Any, dict[str, Any]]:
        return self[name], {key: value for key, value in self.items() if key != name}


def test_recording__pandas_gets_the_simulated_time_as_its_index(seen: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    day = recording.load(seen.path).episodes[1]
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=Frame))
    index, columns = day.to_pandas()
    assert index[4] == np.datetime64("2017-07-03T01:00")
    assert columns[CORE].tolist() == day[CORE].tolist()
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InvalidConfig, match="pip install pandas"):
        day.to_pandas()


def test_recording__cut_file_is_loaded_up_to_its_last_chunk_and_is_reported(seen: Any, folder: Path) -> None:
    whole = rewrite(seen.path, folder / "whole.mcap")
    cut = folder / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[: chunk_ends(whole)[1] + 3])
    with pytest.warns(UserWarning, match="it was cut off after byte"):
        loaded = recording.load(cut)
    assert not loaded.is_complete
    assert "cut off" in loaded.note
    with pytest.warns(UserWarning, match="it was cut off after byte"):
        assert recording.load_log(cut) == loaded.log
    assert 0 < sum(map(len, loaded.episodes)) < 38


# Replay


@pytest.fixture
def session(folder: Path) -> Iterator[tuple[zenoh.Session, str]]:
    endpoint = f"unixsock-stream/{folder}/bus"
    with open_session(listen=[endpoint], role=keys.Role.NODE) as opened:
        yield opened, endpoint


def test_recording__replay_is_the_node_again(seen: Any, session: tuple[zenoh.Session, str]) -> None:
    opened, endpoint = session
    with (
        RecordingReader(seen.path) as reader,
        Replay(reader, opened, speed=1e6, semantic=RecordedPlant(reader, exact=True).semantic_turtle) as replay,
        zenostat.connect(endpoint, affinity="off") as bus,
        bus.listen("office") as samples,
    ):
        assert bus.nodes() == ["office"]
        manifest = bus.manifest("office")
        others = {"instance", "replay", "mode", "speed", "statistics", "history_samples", "history_bytes"}
        assert manifest.replay
        assert manifest.model_dump(exclude=others) == reader.manifest.model_dump(exclude=others)
        assert manifest.history_samples == 0  # a replay keeps none
        counts = list[int]()
        running = threading.Thread(target=lambda: counts.append(replay.run(threading.Event())))
        running.start()
        received = [next(samples).message for _ in range(38)]
        running.join()
        assert counts == [38]
        assert received[1:] == seen.samples[:31] + seen.samples[31:]
        assert bus.status("office").step == [5]
        assert bus.latest("office") == received[-1]
        assert bus.scenario("office") == reader.scenario
        assert bus.geometry("office") == seen.geometry
        assert bus.systems("office") == seen.systems
        assert bus.semantic("office") == seen.turtle
        with pytest.raises(RequestRejected, match="is the replay of a recording and takes no requests"):
            bus.claim("office", Claim(controller="rbc"))
        with pytest.raises(NameInUse, match="'office' is on this bus already"):
            _enter_second(seen.path, endpoint)


def _enter_second(path: Path, endpoint: str) -> None:
    with open_session(connect=[endpoint]) as other, RecordingReader(path) as reader, Replay(reader, other):
        pass


def test_recording__part_is_replayed_under_another_name_at_its_pace(
    seen: Any, session: tuple[zenoh.Session, str]
) -> None:
    opened, endpoint = session
    part = ReplayRange(datetime(2017, 7, 3, 2), datetime(2017, 7, 3, 3))
    with (
        RecordingReader(seen.path) as reader,
        Replay(reader, opened, name="again", speed=1e6, selected=part) as replay,
        zenostat.connect(endpoint, affinity="off") as bus,
    ):
        assert bus.manifest("again").node == "again"
        waits = [wait_s for wait_s, _, sample in replay._schedule() if sample is not None]
        assert waits == pytest.approx([900.0 / 1e6] * 5)
        assert replay.run(threading.Event()) == 5
        assert bus.latest("again").time == ["2017-07-03T03:00:00"]
        stop = threading.Event()
        stop.set()
        assert replay.run(stop) == 0
    with (
        RecordingReader(seen.path) as reader,
        Replay(reader, opened, selected=ReplayRange(begin=datetime(2018, 1, 1))) as replay,
        pytest.raises(InvalidConfig, match="has no samples in the selected time"),
    ):
        replay.run(threading.Event())


def test_recording__replay_cuts_pauses_to_a_minute_or_two_timesteps_of_a_paced_node(
    seen: Any, session: tuple[zenoh.Session, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clock was set forward by an hour in the middle of the recording."""
    with RecordingReader(seen.path) as reader:
        recorded = [*reader.messages({"Sample", "Event"})]
        begin, middle, end = recorded[0].time_ns, recorded[20].time_ns, recorded[-1].time_ns
        shifted = [
            item._replace(time_ns=item.time_ns + 3600 * 10**9 if number >= 20 else item.time_ns)
            for number, item in enumerate(recorded)
        ]
        monkeypatch.setattr(reader, "messages", lambda _: iter(shifted))
        rest_s = (recorded[19].time_ns - begin + end - middle) / 1e9
        assert sum(wait_s for wait_s, *_ in Replay(reader, session[0])._schedule()) == pytest.approx(rest_s + 60.0)
        paced = {"mode": Mode.PACED, "step_s": 900.0, "speed": 0.5}
        monkeypatch.setattr(reader, "manifest", reader.manifest.model_copy(update=paced))
        waits = sum(wait_s for wait_s, *_ in Replay(reader, session[0])._schedule())
        assert waits == pytest.approx(rest_s + 3600.0)  # two timesteps, each of half an hour


def test_recording__replay_command(seen: Any, folder: Path) -> None:
    endpoint = f"unixsock-stream/{folder}/bus"
    done = run("replay", str(seen.path), "--speed", "1e9", "--listen", endpoint, "--name", "again")
    assert done.returncode == 0, done.stderr
    assert "again: replayed 38 samples" in done.stdout
    done = run("replay", str(seen.path), "--from", "soon", "--listen", endpoint)
    assert done.returncode != 0
    assert "--from soon: expected a date and time" in done.stderr


def test_recording__brick_file_is_the_semantic_model_of_the_node(seen: Any, scratch: Path) -> None:
    file = scratch / "office.ttl"
    done = run("model", str(seen.path), "--brick", str(file))
    assert done.returncode == 0, done.stderr
    assert file.read_text() == SemanticGraph.parse(seen.turtle).turtle()
    done = run("model", str(seen.path), "--brick", str(file), "--node", "twin")
    assert done.returncode == 0, done.stderr
    assert '"zenostat/v3/twin/actuator/*/core_zn_cooling_setpoint"' in file.read_text()


@pytest.mark.parametrize(
    ("provenance", "reason"),
    [
        ({"kind": "python"}, r"recorded a Python class, which has no semantic model$"),
        ({"files": {}}, r"has no digest of its model"),
        ({"files": {"model": {"path": "/a.idf", "sha256": "0"}}}, r"has changed since; expected the content .* 0$"),
        (
            {"settings": {"building": "/gone/a.idf"}, "files": {"model": {"path": "/gone/a.idf", "sha256": "0"}}},
            r"no semantic model without the model that it recorded, /gone/a\.idf: ",
        ),
    ],
)
def test_recording__semantic_model_names_what_is_missing(
    seen: Any, scratch: Path, provenance: dict[str, Any], reason: str
) -> None:
    with RecordingReader(seen.path) as reader:
        changed = {**reader.provenance, **provenance}
    path = rewrite(seen.path, scratch / "changed.mcap", provenance=changed)
    with RecordingReader(path) as reader, pytest.raises(InvalidRecording, match=reason):
        RecordedPlant(reader, exact=True).semantic_turtle("office")


def test_recording__loading_warns_of_nothing_where_nothing_is_wrong(seen: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        recording.load(seen.path)
