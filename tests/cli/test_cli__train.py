"""`zenostat train` and `zenostat tune` as a user calls them: errors, logs, and older folders."""

import json
import os
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from support.csv_files import csv_rows
from support.run_cli import output_of, plain, run_in_process, run_program

from zenostat.cli.train import override_fields
from zenostat.lab.calibration.config import read_calibration
from zenostat.lab.training.config import read_training
from zenostat.lab.tuning.tuning_file import read_tuning
from zenostat.topics import yaml12

pytest.importorskip("stable_baselines3")
torch = pytest.importorskip("torch")

from stable_baselines3.common.save_util import load_from_zip_file  # noqa: E402

DAY = {"zones": 2, "begin": "07-03", "end": "07-03", "steps_per_hour": 1}
TRAINING: dict[str, Any] = {
    "algorithm": "a2c", "scenario": "Fake-v1", "arguments": DAY, "steps": 20, "threads": 1, "output": "out",
    "parameters": {"n_steps": 5, "policy_kwargs": {"net_arch": [8]}}, "evaluation": False,
}  # fmt: skip
STUDY: dict[str, Any] = {
    "study": "s", "training": {**TRAINING, "evaluation": {"every_steps": 10}}, "trials": 5, "output": "study",
    "parameters": {"parameters.gamma": [0.9, 0.99]},
}  # fmt: skip
RULES: dict[str, Any] = {
    "study": "r", "controller": "rbc", "scenario": "Fake-v1", "arguments": {**DAY, "control": "building"}, "trials": 3,
    "output": "study", "parameters": {"margin": {"low": 0.0, "high": 1.5}},
}  # fmt: skip
CALIBRATION: dict[str, Any] = {
    "timestamps": "end", "periods": [["2017-01-09", "2017-01-22"]], "trials": 9,
    "parameters": {"lighting": {"edit": "lighting", "low": 0.6, "high": 1.6}},
}  # fmt: skip


def write(folder: Path, name: str, fields: dict[str, Any], **changes: Any) -> str:
    (folder / name).write_text(yaml12.dump({**fields, **changes}))
    return name


def error_of(*command: str, cwd: Path) -> str:
    """The one sentence with which a command ends before it starts anything."""
    done = run_in_process(*command, cwd=cwd)
    assert done.returncode == 2, (done.stdout, done.stderr)
    assert "Traceback" not in done.stderr
    assert not done.stdout
    return plain(done.stderr)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a short training in `out`."""
    folder = tmp_path_factory.mktemp("trained")
    output = output_of("train", write(folder, "t.yaml", TRAINING), cwd=folder)
    assert "out: 20 steps" in output
    return folder


def test_cli__training_that_ends_before_its_first_evaluation_says_so(tmp_path: Path) -> None:
    late = {"every_steps": 21, "references": []}
    output = plain(output_of("train", write(tmp_path, "t.yaml", TRAINING, evaluation=late), cwd=tmp_path))
    assert "out: 20 steps, without an evaluation: the training ended before the first" in output


@pytest.mark.parametrize("command", ["train", "tune"])
def test_cli__help_has_an_example_and_fits_80_columns(command: str) -> None:
    output = output_of(command, "--help")
    assert f"Example: zenostat {command} examples/{'train' if command == 'train' else 'tune'}.yaml" in plain(output)
    assert max(map(len, output.splitlines())) <= 80


@pytest.mark.parametrize(
    ("command", "fields", "read"),
    [("train", TRAINING, read_training), ("tune", STUDY, read_tuning), ("calibrate", CALIBRATION, read_calibration)],
)
def test_cli__examples_of_set_are_fields_of_the_file(command: str, fields: dict[str, Any], read: Any) -> None:
    text = " ".join(plain(output_of(command, "--help")).replace("│", " ").split())
    examples = re.search(r"A field of the file, as (\S+) or (\S+); repeatable", text)
    assert examples, text
    read(override_fields(fields, {}, examples.groups()))


@pytest.mark.parametrize(
    ("command", "text"),
    [
        (["train", "none.yaml"], "there is no file"),
        (["train", "empty"], "empty is a folder; expected a YAML file"),
        (["train", "empty", "--resume"], "empty is not the folder of a training: it has no training.yaml"),
        (["train", "none", "--resume"], "there is no file"),
        (["train", "--resume"], "--resume: name the folder of a training"),
        (["train"], "algorithm: it is missing; scenario: it is missing; steps: it is missing"),
        (["train", "t.yaml", "--set", "gamma"], "--set gamma: expected a field and a value"),
        (["train", "t.yaml", "--algorithm", "pro"], "did you mean 'ppo'"),
        (["train", "t.yaml", "--set", "log=[tensorbord]"], "log.0"),
        (["train", "t.yaml", "--set", "log=tensorboard"], "error: t.yaml: log: a list expected, got 'tensorboard'"),
        (["train", "t.yaml", "--set", "evaluation={every_step: 3}"],
            "error: t.yaml: evaluation.every_step: there is no such field; did you mean 'every_steps'"),
        (["train", "t.yaml", "--set", "normalization=3"], "error: t.yaml: normalization: a mapping expected, got 3"),
        (["train", "t.yaml", "--set", "parameters.policy_kwargs={net_arc: [8]}"],
            "error: parameters.policy_kwargs: a2c has no 'net_arc'; did you mean 'net_arch'"),
        (["train", "s.yaml"], "error: s.yaml is a tuning file, not a training file: use zenostat tune"),
        (["tune", "t.yaml"], "error: t.yaml is a training file, not a tuning file: use zenostat train"),
        (["tune", "s.yaml", "--set", "training=s.yaml"], "s.yaml is a tuning file, not a training file"),
        (["tune", "s.yaml", "--set", "parameters.slots=2"],
            "error: s.yaml: parameters.slots: a range as {low: 1, high: 9}, or a list of choices expected, got 2"),
        (["evaluate", "t.yaml", "--controller", "rbc"], "is a training file, not a scenario file: use zenostat train"),
        (["tune", "none.yaml"], "there is no file"),
        (["tune", "s.yaml", "--set", "tirals=3"], "did you mean 'trials'"),
        (["tune", "s.yaml", "--set", "training.algorithm=pro"], "did you mean 'ppo'"),
        (["tune", "r.yaml", "--set", "controller=rcb"], "no controller 'rcb'; did you mean 'rbc'"),
        (["tune", "r.yaml", "--set", "training=t.yaml"], "either a training or a controller"),
        (["evaluate", "Fake-v1", "--controller", "r.yaml"], "r.yaml: study: there is no such field"),
        (["evaluate", "Fake-v1", "--controller", "s.yaml"], "s.yaml is a tuning file, not a controller file"),
    ],
)  # fmt: skip
def test_cli__bad_input_is_one_sentence_before_anything_starts(command: list[str], text: str, tmp_path: Path) -> None:
    if command[0] == "tune":
        pytest.importorskip("optuna")
    write(tmp_path, "t.yaml", TRAINING)
    write(tmp_path, "s.yaml", STUDY)
    write(tmp_path, "r.yaml", RULES)
    (tmp_path / "empty").mkdir()
    assert text in error_of(*command, cwd=tmp_path)
    assert not (tmp_path / "out").exists()
    assert not (tmp_path / "study").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "text"),
    [
        (["t.yaml"], "out already has a training: resume it, or choose another output folder"),
        (["out"], "out is the folder of a training: --resume continues it"),
        (["out", "--resume", "--seed", "4"], "out is another training and cannot be resumed: seed was 0, now 4"),
    ],
)
def test_cli__folder_that_exists_is_not_overwritten(command: list[str], text: str, trained: Path) -> None:
    before = (trained / "out" / "model.zip").read_bytes()
    assert text in error_of("train", *command, cwd=trained)
    assert (trained / "out" / "model.zip").read_bytes() == before


def test_cli__folder_of_an_older_version_is_one_sentence(trained: Path, tmp_path: Path) -> None:
    shutil.copytree(trained / "out", tmp_path / "old")
    versions = tmp_path / "old" / "versions.json"
    versions.write_text(json.dumps({**json.loads(versions.read_text()), "format": 0, "zenostat": "0.0.9"}))
    text = "old was written by Zenostat 0.0.9 in format 0"
    assert text in error_of("train", "old", "--resume", cwd=tmp_path)
    assert text in error_of("report", "old", "--out", "r.html", cwd=tmp_path)


def test_cli__options_override_the_file_and_resume_continues(trained: Path, tmp_path: Path) -> None:
    write(tmp_path, "t.yaml", TRAINING)
    first = run_in_process("train", "t.yaml", "--steps", "10", "--output", "short", cwd=tmp_path)
    assert first.returncode == 0, first.stderr
    again = run_in_process("train", "short", "--resume", "--steps", "20", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert weights(tmp_path / "short") == weights(trained / "out")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Heartbeat of storage")
def test_cli__study_whose_trainings_are_invalid_ends_with_the_reason(tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    from support.tuning import load_tuning

    from zenostat.lab.tuning.study import Tuning
    from zenostat.topics.errors import InvalidConfig

    tuning = Tuning(load_tuning(tmp_path / write(tmp_path, "s.yaml", STUDY, output=str(tmp_path / "study"))))
    for _ in range(2):
        tuning._check_first_trials(tuning.study.ask(), "dqn needs one discrete action")
    with pytest.raises(InvalidConfig, match="no trial of the study can be run: dqn needs one"):
        tuning._check_first_trials(tuning.study.ask(), "dqn needs one discrete action")
    valid = Tuning(load_tuning(tmp_path / "s.yaml"))
    for reason in ("bad", None, "bad", "bad", "bad", "bad"):  # one that was valid: the others are points of the space
        valid._check_first_trials(valid.study.ask(), reason)


@pytest.mark.slow
@pytest.mark.process
def test_cli__study_of_a_controller_prints_its_trials_and_the_best_is_a_file(tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    done = run_program("tune", write(tmp_path, "r.yaml", RULES), cwd=tmp_path, columns=120)
    assert done.returncode == 0, done.stderr
    text = plain(done.stdout)
    assert "(default)" in text
    assert text.endswith("study/best.yaml")
    rows = csv_rows(tmp_path / "study" / "trials.csv")
    assert [row["margin"] == "" for row in rows] == [True, False, False]
    best = yaml12.read_mapping(tmp_path / "study" / "best.yaml")
    assert best["controller"] == "rbc"
    again = run_program("tune", "r.yaml", cwd=tmp_path)  # nothing is left to do
    assert (again.returncode, "trial 0:" in again.stdout) == (0, False)


def weights(folder: Path) -> list[tuple[str, bytes]]:
    """Weights of a training's last model."""
    _, parameters, _ = load_from_zip_file(folder / "model.zip")
    return [(name, value.numpy().tobytes()) for name, value in sorted(parameters["policy"].items())]


@pytest.mark.slow
def test_cli__log_of_tensorboard_has_the_values_of_the_csv_file(tmp_path: Path) -> None:
    pytest.importorskip("tensorboardX")
    write(tmp_path, "t.yaml", TRAINING, log=["tensorboard"], steps=1000, normalization=False)
    done = run_in_process("train", "t.yaml", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    rows = csv_rows(tmp_path / "out" / "progress.csv")
    expected = {int(row["time/total_timesteps"]): float(row["rollout/ep_rew_mean"]) for row in rows}
    assert expected
    assert scalars(tmp_path / "out" / "tensorboard", "rollout/ep_rew_mean") == pytest.approx(expected, rel=1e-6)


def scalars(folder: Path, name: str) -> dict[int, float]:
    """Values of a TensorBoard log by step: records of TensorFlow's format with events as protocol buffers."""
    from tensorboardX.proto.event_pb2 import Event

    values: dict[int, float] = {}
    for path in sorted(folder.iterdir()):
        raw, place = path.read_bytes(), 0
        while place < len(raw):  # length (8 bytes), its checksum (4), the event, its checksum (4)
            size = int.from_bytes(raw[place : place + 8], "little")
            event = Event.FromString(raw[place + 12 : place + 12 + size])
            for value in event.summary.value:
                if value.tag == name:
                    values[event.step] = value.simple_value
            place += 16 + size
    return values


@pytest.mark.slow
def test_cli__tensorboards_own_reader_reads_the_log(tmp_path: Path) -> None:
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    pytest.importorskip("tensorboardX")
    write(tmp_path, "t.yaml", TRAINING, log=["tensorboard"], steps=1000)
    assert run_in_process("train", "t.yaml", cwd=tmp_path).returncode == 0
    events = accumulator.EventAccumulator(str(tmp_path / "out" / "tensorboard")).Reload()
    assert "rollout/ep_rew_mean" in events.Tags()["scalars"]


@pytest.mark.slow
@pytest.mark.process
def test_cli__weights_and_biases_offline(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("wandb")
    for name in [name for name in os.environ if name.startswith("WANDB")]:
        monkeypatch.delenv(name)  # the service that another test of this process started
    settings = {"mode": "offline", "project": "office"}
    write(tmp_path, "t.yaml", TRAINING, log=["wandb"], wandb=settings, steps=1000)
    done = run_program("train", "t.yaml", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (log,) = (tmp_path / "out").rglob("*.wandb")
    assert b"rollout/ep_rew_mean" in log.read_bytes()
    assert (tmp_path / "out" / "wandb-run").read_text().strip() in log.name
