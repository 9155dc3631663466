"""A report from recordings has the numbers of the evaluation that they record."""

import shlex
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from support.nodes import SMALL, node_on_bus
from support.recordings import rewrite
from support.run_cli import run_in_process as run

from zenostat import recording
from zenostat.bridge.recording.reader import RecordedItem, RecordingReader
from zenostat.lab.evaluate import evaluate
from zenostat.topics.errors import InvalidConfig, InvalidRecording
from zenostat.views.report import compare_recordings

NOISE = {"weather_noise": {"dry_bulb_temperature": {"sigma": 3.0, "mu": 0.0, "tau_h": 5.0}}}
LIMIT = {"points": ["core_zn_air_temperature"], "high": 24.5, "duration_h": 0.5}
PRICES, FACTORS = {"electricity": 0.25, "gas": 0.1}, {"electricity": 0.4}


@pytest.fixture(scope="module")
def evaluated(module_scratch: Path) -> Any:
    """An evaluation of two controllers in two noisy episodes, and the folder of its recordings."""
    folder = module_scratch / "runs"
    evaluation = evaluate(
        {**SMALL, **NOISE, "affinity": "off"}, ["baseline", "rbc"], episodes=2, seed=4, prices=PRICES,
        reward={"kind": "normalized"},  # which keeps its maxima from one episode to the next
        emissions=FACTORS, trace=True, record=folder,
    )  # fmt: skip
    return evaluation, sorted(folder.iterdir(), reverse=True)  # the controller first


@pytest.mark.slow
def test_recording__numbers_are_those_of_the_evaluation_to_the_bit(evaluated: Any) -> None:
    evaluation, files = evaluated
    expected = evaluation.comparison()
    comparison = compare_recordings(files, prices=PRICES, emissions=FACTORS)
    assert [r.name for r in comparison.runs] == ["baseline", "rbc"] == [r.name for r in expected.runs]
    assert comparison.sources == expected.sources
    assert comparison.scenario == expected.scenario != ""
    for ours, theirs in zip(comparison.runs, expected.runs, strict=True):
        assert [m.metrics() for m in ours.results] == [m.metrics() for m in theirs.results]
        assert ours.results == theirs.results
        assert (
            (ours.seeds, ours.weather_names) == (theirs.seeds, theirs.weather_names) == ((4, 5), ("USA_CO_Denver",) * 2)
        )
        a, b = ours.trajectory, theirs.trajectory
        assert (a.begin, a.steps, a.sources) == (b.begin, 96, b.sources)
        for name in ("values", "effective", "source_index"):
            assert getattr(a, name).tobytes() == getattr(b, name).tobytes(), name
        assert {k: v.tobytes() for k, v in a.terms.items()} == {k: v.tobytes() for k, v in b.terms.items()}
        for one, other in zip(ours.weathers, theirs.weathers, strict=True):
            assert one is not None
            assert one.step_s == other.step_s
            assert one.temperature.tobytes() == other.temperature.tobytes()
            assert one.solar.tobytes() == other.solar.tobytes()
        assert not np.array_equal(ours.weathers[0].temperature, ours.weathers[1].temperature)  # the noise


@pytest.mark.slow
def test_recording__command_writes_the_report_of_the_evaluation(evaluated: Any, scratch: Path) -> None:
    evaluation, files = evaluated
    page, other = scratch / "report.html", scratch / "evaluation.html"
    words = ["report", *map(str, files), "--out", str(page), "--price", "electricity=0.25", "--price", "gas=0.1"]
    words += ["--emissions", "electricity=0.4"]
    result = run(*words)
    assert result.returncode == 0, result.stderr
    assert not result.stderr
    assert str(page) in result.stdout
    evaluation.report(other, command=shlex.join(["zenostat", *words]))
    assert page.read_text() == other.read_text()


@pytest.fixture(scope="module")
def interrupted(module_scratch: Path) -> Path:
    """A recording of a node with a baseline and a limit: an episode of 20 steps, a complete one, and one of 10."""
    path = module_scratch / "interrupted.mcap"
    settings = {**SMALL, "terminate": [LIMIT], "baseline": True, "record": str(path)}
    with (
        node_on_bus(module_scratch / "interrupted", **settings) as (_, bus),
        bus.controller("office", name="rbc") as link,
    ):
        for steps in (20, 96, 10):
            sample = link.reset()
            for _ in range(steps):
                sample.send({"core_zn_cooling_setpoint": 27.0})
                sample = link.receive()
    return path


@pytest.mark.slow
def test_recording__only_complete_episodes_are_compared_with_the_parallel_baseline(interrupted: Path) -> None:
    with pytest.warns(UserWarning, match="is not in the report") as warned:
        comparison = compare_recordings([interrupted])
    assert [str(w.message).rpartition(": ")[2] for w in warned] == [
        "it has steps 0 to 20 of 96",
        "it has steps 0 to 10 of 96",
    ]
    baseline, controlled = comparison.runs
    assert (baseline.name, controlled.name) == ("baseline", "office")
    episode = next(e for e in recording.load(interrupted).episodes if len(e) == 97)
    # The limit holds for 1,800 s, which are two timesteps, of the controlled building and of the baseline alike.
    for ours, table in ((controlled, episode.values), (baseline, episode.baseline)):
        outside = table[:, episode.manifest.names.index(LIMIT["points"][0])] > LIMIT["high"]
        after = np.flatnonzero(outside[1:-1] & outside[2:])
        end = int(after[0]) + 2 if len(after) else 96
        assert ours.results[0].steps == ours.trajectory.steps == end
        assert ours.results[0].terminated == bool(len(after))
        assert ours.trajectory.values.tobytes() == table[: end + 1].tobytes()
    assert controlled.results[0].terminated
    assert controlled.trajectory.sources == ("", "rbc")  # without the numbers that make a name unique on the bus
    assert not baseline.trajectory.source_index.any()


@pytest.mark.slow
def test_recording__warnings_name_the_slots(scratch: Path) -> None:
    path = scratch / "slots.mcap"
    settings = {**SMALL, "weather": [SMALL["weather"]], "slots": 2, "record": str(path)}
    with node_on_bus(scratch / "slots", **settings) as (_, bus), bus.controller("office") as link:
        link.reset()
        for _ in range(4):
            link.send()
            link.receive()
    with pytest.warns(UserWarning, match="is reported in part") as warned:
        compare_recordings([path])
    texts = [str(w.message).removeprefix(f"{path}: ") for w in warned]
    assert texts == [f"episode 1 of slot {n} is reported in part: it has steps 0 to 4 of 96" for n in (0, 1)]


@pytest.mark.slow
def test_recording__episode_in_part_is_reported_where_no_episode_is_complete(interrupted: Path, tmp_path: Path) -> None:
    samples = 0

    def first_samples(_: int, item: RecordedItem) -> bytes | None:
        nonlocal samples
        samples += item.schema == "Sample"
        return item.payload if samples < 15 else None

    part = rewrite(interrupted, tmp_path / "part.mcap", first_samples)
    with pytest.warns(UserWarning, match="is reported in part: it has steps 0 to 12 of 96"):
        comparison = compare_recordings([part])
    assert [run_.results[0].steps for run_ in comparison.runs] == [12, 12]
    samples = 100
    nothing = rewrite(interrupted, tmp_path / "nothing.mcap", first_samples)
    with pytest.raises(InvalidRecording, match="has no timestep"):
        compare_recordings([nothing])


ROOM = """
class Room:
    step_s, steps = 600.0, 6
    sensors = {"room_temperature": "degC"}
    meters = {"electricity": "J"}
    actuators = {"heater": ("W", 0.0, 3000.0, 500.0)}

    def reset(self, seed):
        return {"room_temperature": 20.0, "electricity": 0.0}

    def step(self, commands):
        return {"room_temperature": 20.0, "electricity": 600.0 * commands["heater"]}
"""


@pytest.mark.slow
def test_recording__one_of_several_parallel_baselines_is_the_reference(tmp_path: Path) -> None:
    (tmp_path / "room.py").write_text(ROOM)
    files = []
    for watts in (300.0, 600.0):
        files.append(tmp_path / f"heat_{watts:.0f}.mcap")
        env = gym.make(
            "zenostat/Plant-v1", plant=f"{tmp_path / 'room.py'}:Room", reward=None, baseline=True, record=str(files[-1])
        )
        env.reset(seed=0)
        while not env.step(np.array([watts], np.float32))[3]:
            pass
        env.close()
    for chosen in (files, files[:1]):
        runs = compare_recordings(chosen).runs
        assert [of.name for of in runs][:1] == ["baseline"]
        assert [of.results[0].mean_power_w for of in runs] == pytest.approx([500.0, 300.0, 600.0][: len(chosen) + 1])


@pytest.mark.slow
def test_recording__recordings_that_cannot_be_compared_are_one_error(
    evaluated: Any, interrupted: Path, tmp_path: Path
) -> None:
    _, files = evaluated
    with RecordingReader(files[0]) as reader:
        other = reader.manifest.model_copy(update={"step_s": 600.0})
    changed = rewrite(files[0], tmp_path / "changed.mcap", manifest=other)
    with pytest.raises(InvalidConfig, match=r"in steps of 900 s; .* in steps of 600 s: a report compares"):
        compare_recordings([files[1], changed])
    with pytest.raises(InvalidConfig, match="each of them once"):
        compare_recordings([files[0], files[0]])
    with pytest.raises(InvalidConfig, match="at least one recording"):
        compare_recordings([])
    result = run("report", str(interrupted))
    assert result.returncode != 0
    assert "expected --out FILE.html" in result.stderr
