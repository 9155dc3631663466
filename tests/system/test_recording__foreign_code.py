"""A recording is data: whatever it names, reading or verifying it imports nothing and runs nothing."""

import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import msgpack
import pytest
from support.recordings import record_samples, rewrite
from support.run_cli import run_in_process as run

from zenostat.agent_sdk.testing import fake_plant
from zenostat.bridge.python_plant.class_file import class_file
from zenostat.bridge.recording.reader import RecordingReader
from zenostat.eplus_node.verify_recording import verify
from zenostat.topics.errors import InvalidConfig, InvalidRecording, UsageError
from zenostat.topics.recording import RecordedSnapshot

COUNTER = """
import subprocess
from pathlib import Path
from subprocess import Popen

Path(__file__).with_name("imported").touch()

class Counter:
    step_s = 60.0
    duration_s = 600.0
    sensors = {"count": "1"}
    actuators = {"add": ("1", 0.0, 1.0, 0.0)}

    def reset(self, seed):
        self.count = 0.0
        return {"count": 0.0}

    def step(self, commands):
        self.count += commands["add"]
        return {"count": self.count}

    def save(self):
        return self.count

    def restore(self, state):
        self.count = state
"""


@pytest.fixture(scope="module")
def counter(module_scratch: Path) -> Path:
    """A recording of a class, with a snapshot to which it returns."""
    (module_scratch / "counter.py").write_text(COUNTER)
    path = module_scratch / "counter.mcap"
    env = gym.make("zenostat/Building-v1", plant=f"{module_scratch}/counter.py:Counter", record=str(path), reward=None)
    env.reset(seed=0)
    env.step(env.action_space.sample())
    snapshot = env.unwrapped.snapshot()
    env.step(env.action_space.sample())
    env.reset(options={"snapshot": snapshot})
    env.step(env.action_space.sample())
    env.close()
    return path


def provenance_of(path: Path, **changes: Any) -> dict[str, Any]:
    with RecordingReader(path) as reader:
        return {**reader.provenance, **changes}


@pytest.fixture
def hostile(counter: Path, tmp_path: Path) -> tuple[Path, Path]:
    """A recording whose provenance names a command, and the file that the command would create."""
    created = tmp_path / "created"
    provenance = provenance_of(
        counter, settings={"plant": "subprocess:Popen", "plant_arguments": {"args": ["touch", str(created)]}}
    )
    return rewrite(counter, tmp_path / "hostile.mcap", provenance=provenance), created


@pytest.mark.slow
def test_recording__verify_never_runs_what_a_recording_names(hostile: tuple[Path, Path]) -> None:
    path, created = hostile
    for tolerance in (None, 0.0):
        with pytest.raises(InvalidRecording, match=r"no code that a recording names is run: name the class yourself"):
            verify(path, tolerance=tolerance)
    assert not created.exists()


@pytest.mark.parametrize("words", [("verify",), ("verify", "--tolerance", "1"), ("log",), ("report",), ("export",)])
def test_recording__no_command_runs_what_a_recording_names(hostile: tuple[Path, Path], words: tuple[str, ...]) -> None:
    path, created = hostile
    known = set(sys.modules)
    output = ("--out", str(path.parent / f"out.{'html' if words[0] == 'report' else 'csv'}"))
    run(words[0], str(path), *words[1:], *(output if words[0] in ("report", "export") else ()))
    assert not created.exists()
    assert "counter" not in set(sys.modules) - known


@pytest.mark.slow
@pytest.mark.process
def test_recording__class_that_the_user_names_is_verified(counter: Path) -> None:
    plant = f"{counter.with_name('counter.py')}:Counter"
    result = verify(counter, plant=plant)
    assert (result.passed, result.steps, result.notes) == (True, 3, [])


@pytest.mark.process
def test_recording__class_that_the_file_only_imports_is_not_called(counter: Path, tmp_path: Path) -> None:
    """The recorded arguments would otherwise be those of a class of the recording's choice."""
    created = tmp_path / "created"
    settings = {"plant": "counter.py:Popen", "plant_arguments": {"args": ["touch", str(created)]}}
    path = rewrite(counter, tmp_path / "popen.mcap", provenance=provenance_of(counter, settings=settings))
    with pytest.raises(InvalidConfig, match=r"counter\.py does not define 'Popen', but imports it from subprocess"):
        verify(path, plant=f"{counter.with_name('counter.py')}:Popen")
    assert not created.exists()


def test_recording__digests_are_compared_before_anything_is_imported(counter: Path, tmp_path: Path) -> None:
    (tmp_path / "counter.py").write_text(COUNTER + "\n# another file\n")
    with pytest.raises(InvalidRecording, match=r"the class .*counter\.py has changed; a tolerance compares it"):
        verify(counter, plant=f"{tmp_path}/counter.py:Counter")
    with pytest.raises(InvalidRecording, match=r"counter\.py:Other is not the recorded Counter"):
        verify(counter, plant=f"{counter.with_name('counter.py')}:Other")
    without = rewrite(counter, tmp_path / "without.mcap", provenance=provenance_of(counter, files={}))
    with pytest.raises(InvalidRecording, match="the recording has no digest of the class"):
        verify(without, plant=f"{tmp_path}/counter.py:Counter")
    assert not (tmp_path / "imported").exists()


@pytest.mark.slow
@pytest.mark.process
def test_recording__class_of_a_module_has_the_digest_of_the_file_that_defines_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "counters"
    package.mkdir()
    (package / "one.py").write_text(COUNTER)
    (package / "__init__.py").write_text("from counters.one import Counter\n")
    monkeypatch.chdir(tmp_path)
    env = gym.make("zenostat/Building-v1", plant="counters:Counter", record=str(tmp_path / "run.mcap"), reward=None)
    env.reset(seed=0)
    env.step(env.action_space.sample())
    env.close()
    assert verify(tmp_path / "run.mcap", plant="counters.one:Counter").passed
    with pytest.raises(InvalidRecording, match=r"__init__\.py has changed"):
        verify(tmp_path / "run.mcap", plant="counters:Counter")
    (package / "one.py").write_text(COUNTER + "\n")
    with pytest.raises(InvalidRecording, match=r"one\.py has changed"):
        verify(tmp_path / "run.mcap", plant="counters.one:Counter")


@pytest.mark.parametrize(
    ("field", "value"),
    [("output_dir", "/tmp"), ("keep_last", 1), ("config", "env.yaml"), ("scenario", "office"), ("faults", "f.yaml")],
)
def test_recording__provenance_sets_only_what_determines_the_results(
    counter: Path, tmp_path: Path, field: str, value: object
) -> None:
    settings = {"shrink_caches": True, "monitoring": False, field: value}
    provenance = {"kind": "energyplus", "settings": settings, "files": {}}
    path = rewrite(counter, tmp_path / "settings.mcap", provenance=provenance)
    with pytest.raises(InvalidRecording, match=rf"no recording has the setting {field}"):
        verify(path)


@pytest.mark.slow
@pytest.mark.process
def test_recording__name_of_a_snapshot_is_not_a_path(counter: Path, tmp_path: Path) -> None:
    outside = tmp_path / "outside"

    def renamed(_: int, item: Any) -> bytes:
        fields = msgpack.unpackb(item.payload)
        if fields.get("snapshot"):
            fields["snapshot"] = str(outside)
        return msgpack.packb(fields)

    path = rewrite(counter, tmp_path / "path.mcap", renamed)
    with RecordingReader(path) as reader:
        assert any(item.schema == RecordedSnapshot.__name__ for item in reader.messages())
    result = verify(path, plant=f"{counter.with_name('counter.py')}:Counter")
    assert (result.steps, result.difference) == (3, None)
    assert result.audit.problems, "the change itself is found"
    assert not outside.exists()


@pytest.mark.parametrize("value", [[], {"kind": "python", "settings": []}, {"kind": 3}, {"files": {"class": "x"}}])
def test_recording__provenance_that_is_not_one_is_named(tmp_path: Path, value: Any) -> None:
    source = record_samples(tmp_path / "source.mcap", 3)
    path = rewrite(source, tmp_path / "other.mcap", provenance=value)
    with pytest.raises(UsageError, match="is damaged"):
        verify(path)


def test_recording__module_is_found_without_importing_its_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "loud"
    package.mkdir()
    (package / "__init__.py").write_text("raise RuntimeError('imported')\n")
    (package / "quiet.py").write_text("class Quiet: pass\n")
    monkeypatch.chdir(tmp_path)
    assert class_file("loud.quiet:Quiet") == package / "quiet.py"
    assert class_file("zenostat.agent_sdk.testing.fake_plant:FakePlant").samefile(str(fake_plant.__file__))
    for unknown in ("loud.nothing:Quiet", "nowhere:Quiet", "loud.quiet.more:Quiet", "nothing.py:Quiet", "math:Quiet"):
        with pytest.raises(InvalidConfig, match="no file"):
            class_file(unknown)
