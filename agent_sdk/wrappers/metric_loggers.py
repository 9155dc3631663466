"""Means for those who watch a training: TensorBoard, Weights & Biases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from agent_sdk.wrappers.adapters import BuildingWrapper
from agent_sdk.wrappers.base import EnvView, ResetBatch, StepBatch, Values, WrapperLogic
from agent_sdk.wrappers.extras import load
from agent_sdk.wrappers.names import refuse_inside
from topics.errors import InvalidConfig


class _Mean:
    """Sums of named numbers, and how often each came."""

    def __init__(self) -> None:
        self.sums: dict[str, float] = {}
        self.counts: dict[str, int] = {}

    def add(self, values: Mapping[str, float]) -> None:
        for name, value in values.items():
            self.sums[name] = self.sums.get(name, 0.0) + value
            self.counts[name] = self.counts.get(name, 0) + 1

    def means(self, group: str) -> dict[str, float]:
        return {f"{group}/{name}": self.sums[name] / self.counts[name] for name in self.sums}


class MeansLog(WrapperLogic):
    """Base of loggers: means of each episode and of every n steps.

    They are of the reward, its terms and measures and the observations. A logger of one's own overrides `write`, which
    gets them, and may override `values`, which says what is averaged; then a wrapper names it:
    `class MyLog(Single): core = MyCore` (`agent_sdk.wrappers.single`, or `Vector` of `agent_sdk.wrappers.vector`).
    """

    def __init__(self, view: EnvView, every: int) -> None:
        super().__init__(view)
        if every < 1:
            raise InvalidConfig(f"{view.who}: every should be a number of steps, not {every!r}")
        refuse_inside(view.env, ["RewardVector"], f"{view.who} logs a number as reward; put it before {{}}")
        self._names, self._every = [f"observation.{name}" for name in view.names], every
        self._episodes = [_Mean() for _ in range(view.slots)]
        self._window, self._since, self.steps = _Mean(), 0, 0

    def write(self, values: Mapping[str, float], step: int) -> None:
        """Hands numbers on: those of an episode at its end (`episode/…`), those of every n steps (`steps/…`).

        Args:
            values: means by name; with them `episode/return` and `episode/steps`.
            step: the number of steps of all slots so far.
        """
        raise NotImplementedError

    def start(self, start: ResetBatch) -> Values:
        """See `WrapperLogic`."""
        for slot in start.slots:
            self._episodes[slot] = _Mean()
        return start.observations

    def step(self, step: StepBatch) -> tuple[Values, Values]:
        """See `WrapperLogic`."""
        for row, slot in enumerate(step.slots):
            values = self.values(row, step)
            self.steps += 1
            self._since += 1
            self._window.add(values)
            self._episodes[slot].add(values)
            if self._since == self._every:
                self.write(self._window.means("steps"), self.steps)
                self._window, self._since = _Mean(), 0
            if step.ends[row]:
                self._end(slot)
        return step.observations, step.rewards

    def values(self, row: int, step: StepBatch) -> dict[str, float]:
        """Numbers of one timestep of the slot `step.slots[row]`, by name; their means are logged."""
        values = {"reward": float(step.rewards[row])}
        for group, key in (("reward", "reward_terms"), ("measure", "reward_metrics")):
            said = step.infos.get(row, key) or {}
            values |= {f"{group}.{name}": float(value) for name, value in said.items() if np.ndim(value) == 0}
        return values | dict(zip(self._names, np.ravel(step.observations[row]).tolist(), strict=True))

    def _end(self, slot: int) -> None:
        episode = self._episodes[slot]
        count, total = episode.counts["reward"], episode.sums["reward"]
        self.write(episode.means("episode") | {"episode/return": total, "episode/steps": float(count)}, self.steps)

    snapshot_aware = False  # steps that were taken were taken

    def get_state(self) -> list[dict[str, Any]]:
        """The number of steps, so that a training that goes on goes on counting."""
        return [{"steps": self.steps} for _ in range(self.view.slots)]

    def set_state(self, slots: Any) -> None:
        """See `WrapperLogic`."""
        self.steps = int(slots[0]["steps"])


class _TensorBoardMeans(MeansLog):
    def __init__(self, view: EnvView, folder: str | Path, every: int = 1000) -> None:
        super().__init__(view, every)
        self._writer: Any = load("tensorboardX", "tensorboard", view.who).SummaryWriter(str(folder))

    def write(self, values: Mapping[str, float], step: int) -> None:
        """See `MeansLog`."""
        for name, value in values.items():
            self._writer.add_scalar(name, value, step)

    def close(self) -> None:
        """See `WrapperLogic`."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None


class TensorBoardLog(BuildingWrapper):
    """Writes means for TensorBoard (needs the extra `tensorboard`).

    `episode/…` at each episode's end: the means over its steps, `episode/return` and `episode/steps`; `steps/…` every
    `every` steps: the means since the last time. Of the reward, its terms (`reward.`) and measures (`measure.`) and
    the observations (`observation.`), as this wrapper gives them. The step is the number of steps of all slots.

    Args:
        folder: of TensorBoard's event file.
        every: steps.

    Raises:
        InvalidConfig: the extra is missing, or a `RewardVector` within.
    """

    logic = _TensorBoardMeans


class _WeightsAndBiasesMeans(MeansLog):
    def __init__(
        self,
        view: EnvView,
        project: str,
        name: str | None = None,
        every: int = 1000,
        mode: Literal["offline", "online", "disabled"] = "offline",
        folder: str | Path | None = None,
        config: Mapping[str, Any] | None = None,
        entity: str | None = None,
        group: str | None = None,
        tags: Sequence[str] | None = None,
        artifacts: Sequence[str | Path] = (),
    ) -> None:
        super().__init__(view, every)
        wandb = self._wandb = load("wandb", "wandb", view.who)
        self._artifacts = [Path(path) for path in artifacts]
        given: dict[str, Any] = {"project": project, "name": name, "mode": mode, "config": dict(config or {})}
        given |= {"entity": entity, "group": group, "tags": None if tags is None else list(tags)}
        self._run: Any = wandb.init(**given, dir=None if folder is None else str(folder), reinit="create_new")

    def write(self, values: Mapping[str, float], step: int) -> None:
        """See `MeansLog`."""
        self._run.log(dict(values), step=step)

    def close(self) -> None:
        """See `WrapperLogic`."""
        if self._run is not None:
            self._log_artifacts()
            self._run.finish()
            self._run = None

    def _log_artifacts(self) -> None:
        there = [path for path in self._artifacts if path.exists()]
        if there:
            artifact = self._wandb.Artifact(f"run-{self._run.id}", type="output")
            for path in there:
                if path.is_dir():
                    artifact.add_dir(str(path), name=path.name)
                else:
                    artifact.add_file(str(path), name=path.name)
            self._run.log_artifact(artifact)


class WeightsAndBiasesLog(BuildingWrapper):
    """Logs means to a run of Weights & Biases (needs the extra `wandb`); what, as `TensorBoardLog`.

    Args:
        project: the project's name.
        name: the run's.
        every: steps.
        mode: `offline` writes files that `wandb sync` sends later; `online` needs a login.
        folder: where wandb keeps its files; None is the present folder.
        config: what the run is to be known by.
        entity: the user or team that the run belongs to; None is the login's own.
        group: of runs that belong together.
        tags: words to find the run by.
        artifacts: files and folders that are logged as an artifact of the run when the environment is closed.

    Raises:
        InvalidConfig: the extra is missing, or a `RewardVector` within.
    """

    logic = _WeightsAndBiasesMeans
