"""Wrappers that write logs."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.csv_files import csv_rows
from support.wrapped_fakes import MIDDLE, episode, fake, fakes

from zenostat import wrappers as w
from zenostat.agent_sdk.testing import FakeEnv
from zenostat.topics.errors import InvalidConfig


def test_wrappers__log_has_n_rows_with_n_steps(tmp_path: Path) -> None:
    env = w.EpisodeLog(w.ReducedObservation(fake(), ["core", "hour"]), tmp_path / "log")
    steps = episode(env, lambda: MIDDLE)
    rows = csv_rows(tmp_path / "log" / "episode-000001.csv")
    assert list(rows[0]) == [
        "time", "observation.core", "observation.hour", "action.heat", "action.cool", "effective.heat",
        "effective.cool", "effective.occupants", "reward", "reward.energy", "reward.comfort", "metric.joules",
    ]  # fmt: skip
    assert [row["time"] for row in rows] == [info["time"] for *_, info in steps[1:]]
    assert [float(row["observation.core"]) for row in rows] == [float(o[0]) for o, *_ in steps[1:]]
    assert [float(row["reward"]) for row in rows] == [reward for _, reward, *_ in steps[1:]]
    values = [float(rows[0][name]) for name in list(rows[0])[1:]]
    assert values == [24.5, 0.0, 20.0, 26.0, 20.0, 26.0, 0.0, -4.5, -4.0, -0.5, 4000.0]


def test_wrappers__files_of_a_log_have_their_names_when_they_are_whole(tmp_path: Path) -> None:
    env = w.EpisodeLog(fake(), tmp_path)
    env.reset()
    assert list(tmp_path.iterdir()) == [], "sample 0 is no row"
    env.step(MIDDLE)
    assert [file.name for file in tmp_path.iterdir()] == [".episode-000001.csv"]
    env.reset()
    assert [file.name for file in tmp_path.iterdir()] == ["episode-000001-left.csv"]
    episode(env, lambda: MIDDLE)
    env.reset()
    env.step(MIDDLE)
    env.close()
    env.close()
    whole = {"episode-000001-left.csv": 1, "episode-000002.csv": 24, "episode-000003-left.csv": 1}
    assert {file.name: len(csv_rows(file)) for file in tmp_path.iterdir()} == whole
    again = w.EpisodeLog(fake(), tmp_path)
    episode(again, lambda: MIDDLE)
    assert len(csv_rows(tmp_path / "episode-000004.csv")) == 24


def test_wrappers__log_of_a_vector_has_a_file_a_slot_and_episode(tmp_path: Path) -> None:
    many = w.EpisodeLog(fakes(2), tmp_path)
    many.reset(seed=1)
    for _ in range(24 + 1 + 3):
        many.step(np.stack([MIDDLE, MIDDLE]))
    many.close()
    assert {file.name: len(csv_rows(file)) for file in tmp_path.iterdir()} == {
        f"slot-0{slot}-episode-00000{name}.csv": count for slot in (0, 1) for name, count in (("1", 24), ("2-left", 3))
    }


def test_wrappers__parquet_has_the_same_as_csv(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    env = w.EpisodeLog(w.EpisodeLog(fake(), tmp_path / "one"), tmp_path / "two", "parquet")
    episode(env, lambda: MIDDLE)
    table = parquet.read_table(tmp_path / "two" / "episode-000001.parquet").to_pylist()
    rows = csv_rows(tmp_path / "one" / "episode-000001.csv")
    assert [{name: str(value) for name, value in row.items()} for row in table] == rows


def test_wrappers__log_without_its_extra_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("pyarrow", "tensorboardX", "wandb"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InvalidConfig, match=r"EpisodeLog needs pyarrow .*pip install -e '\S+\[parquet\]'"):
        w.EpisodeLog(fake(), tmp_path, "parquet")
    with pytest.raises(InvalidConfig, match=r"pip install -e '\S+\[tensorboard\]'"):
        w.TensorBoardLog(fake(), tmp_path)
    with pytest.raises(InvalidConfig, match=r"pip install -e '\S+\[wandb\]'"):
        w.WeightsAndBiasesLog(fake(), "office")
    with pytest.raises(InvalidConfig, match="EpisodeLog logs a scalar reward; apply it before RewardVector"):
        w.EpisodeLog(w.RewardVector(fake(), ["energy"]), tmp_path)


class Board:
    """Stands for TensorBoard's writer."""

    def __init__(self, folder: str) -> None:
        self.folder, self.scalars, self.closed = folder, list[tuple[str, float, int]](), 0

    def add_scalar(self, name: str, value: float, step: int) -> None:
        self.scalars.append((name, value, step))

    def close(self) -> None:
        self.closed += 1


@pytest.mark.parametrize("vectors", [False, True])
def test_wrappers__means_of_episodes_and_of_n_steps(monkeypatch: pytest.MonkeyPatch, vectors: bool) -> None:
    boards: list[Board] = []

    class Module:
        @staticmethod
        def SummaryWriter(folder: str) -> Board:  # noqa: N802
            boards.append(Board(folder))
            return boards[-1]

    monkeypatch.setitem(sys.modules, "tensorboardX", Module)  # type: ignore[arg-type]
    env: Any = w.TensorBoardLog(fakes(1) if vectors else fake(), "here", every=10)
    action = MIDDLE[None] if vectors else MIDDLE
    env.reset(seed=1)
    rewards, cores = [], []
    for _ in range(24):
        observation, reward, *_ = env.step(action)
        rewards.append(float(np.ravel(reward)[0]))
        cores.append(float(np.ravel(observation)[5]))
    (board,) = boards
    logged = {(name, step): value for name, value, step in board.scalars}
    assert {step for name, step in logged if name.startswith("steps/")} == {10, 20}
    assert logged["steps/reward", 20] == pytest.approx(np.mean(rewards[10:20]))
    assert logged["episode/reward", 24] == pytest.approx(np.mean(rewards))
    assert logged["episode/return", 24] == pytest.approx(np.sum(rewards))
    assert logged["episode/steps", 24] == 24
    assert logged["episode/reward.energy", 24] == pytest.approx(-4.0)
    assert logged["episode/metric.joules", 24] == pytest.approx(4000.0)
    assert logged["episode/observation.core", 24] == pytest.approx(np.mean(cores))
    env.reset()
    for _ in range(24):
        env.step(action)
    assert [value for name, value, step in board.scalars if name == "episode/steps"] == [24, 24]
    env.close()
    env.close()
    assert (board.folder, board.closed) == ("here", 1)


@pytest.mark.parametrize("every", [10.5, float("nan"), float("inf"), True, 0, -5, "10", None], ids=repr)
def test_wrappers__interval_of_means_that_is_no_number_of_steps(every: Any) -> None:
    with pytest.raises(InvalidConfig, match=r"TensorBoardLog: every = .*; a whole number of steps from 1 on expected"):
        w.TensorBoardLog(fake(), "here", every=every)


def test_wrappers__tensorboards_own_files(tmp_path: Path) -> None:
    pytest.importorskip("tensorboardX")
    env = w.TensorBoardLog(fake(), tmp_path)
    episode(env, lambda: MIDDLE)
    env.close()
    (file,) = tmp_path.iterdir()
    assert b"episode/return" in file.read_bytes()


@pytest.mark.slow
def test_wrappers__weights_and_biases_offline(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("wandb")
    monkeypatch.setenv("WANDB_SILENT", "true")
    (tmp_path / "model.txt").write_text("weights")
    env = w.WeightsAndBiasesLog(
        fake(),
        "office",
        folder=tmp_path,
        every=5,
        group="summer",
        tags=["a"],
        entity="us",
        artifacts=[tmp_path / "model.txt"],
    )
    run = env._logic._run
    assert (run.group, run.tags, run.entity) == ("summer", ("a",), "us")
    episode(env, lambda: MIDDLE)
    env.close()
    assert list(tmp_path.rglob("*.wandb"))


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_wrappers__term_that_appears_later_has_a_column(tmp_path: Path, kind: Any) -> None:
    def late(values: Any, begin: Any) -> dict[str, float]:
        return {"base": -1.0} | ({"late": -2.0} if begin.hour >= 2 else {})

    if kind == "parquet":
        parquet = pytest.importorskip("pyarrow.parquet")
    env = w.EpisodeLog(FakeEnv(zones=1, steps_per_hour=1, reward=late), tmp_path, kind)
    env.reset(seed=0)
    for _ in range(4):
        env.step(env.action_space.sample())
    env.close()
    (file,) = tmp_path.iterdir()
    rows = parquet.read_table(file).to_pylist() if kind == "parquet" else csv_rows(file)
    empty = None if kind == "parquet" else ""
    assert [row["reward.late"] for row in rows] == [empty, empty, *(type(rows[2]["reward.late"])(-2.0),) * 2]
    assert [float(row["reward.base"]) for row in rows] == [-1.0] * 4


@pytest.mark.parametrize("name", [None, "file"])
def test_episode_log__folder_that_cannot_be_one(name: str | None, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("text")
    with pytest.raises(InvalidConfig, match=r"EpisodeLog: folder=.*a folder for the tables expected"):
        w.EpisodeLog(fake(), name and tmp_path / name)


class Run:
    """Stands for a run of Weights & Biases, and for its module."""

    id = "1"

    def __init__(self, *, fails: bool = False) -> None:
        self.fails, self.settings, self.files, self.finished = fails, dict[str, Any](), list[tuple[str, str]](), 0

    def init(self, **settings: Any) -> "Run":
        self.settings = settings
        return self

    def Artifact(self, name: str, type: str) -> "Run":  # noqa: A002, N802  # wandb's names
        return self

    def add_file(self, path: str, name: str) -> None:
        if self.fails:
            raise OSError("the disk is full")
        self.files.append((path, name))

    def log_artifact(self, artifact: "Run") -> None:
        assert artifact is self

    def finish(self) -> None:
        self.finished += 1


def test_weights_and_biases__one_artifact_and_one_tag_need_no_list(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "model.zip").write_text("weights")
    for artifacts in (str(tmp_path / "model.zip"), tmp_path / "model.zip", [tmp_path / "model.zip"]):
        monkeypatch.setitem(sys.modules, "wandb", run := Run())  # type: ignore[arg-type]
        w.WeightsAndBiasesLog(fake(), "office", artifacts=artifacts, tags="summer").close()
        assert run.settings["tags"] == ["summer"]
        assert (run.files, run.finished) == ([(str(tmp_path / "model.zip"), "model.zip")], 1)


def test_weights_and_biases__artifacts_that_cannot_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "wandb", run := Run(fails=True))  # type: ignore[arg-type]
    for artifacts in (["a/model.zip", "b/model.zip"], "/"):
        with pytest.raises(InvalidConfig, match=r"WeightsAndBiasesLog: artifacts .*each with another name"):
            w.WeightsAndBiasesLog(fake(), "office", artifacts=artifacts)
    (tmp_path / "model.zip").write_text("weights")
    env = w.WeightsAndBiasesLog(fake(), "office", artifacts=[tmp_path / "model.zip", tmp_path / "none.zip"])
    with pytest.raises(OSError, match="full"), pytest.warns(UserWarning, match=r"artifacts that do not exist: .*none"):
        env.close()
    assert run.finished == 1
