"""Wrappers that log means during training: TensorBoard, Weights & Biases."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from typing_extensions import override

from zenostat.agent_sdk.wrappers.adapters import BuildingWrapper
from zenostat.agent_sdk.wrappers.base import EnvView, ResetBatch, StepBatch, Values, WrapperLogic
from zenostat.agent_sdk.wrappers.names import reject_wrappers, require_each_timestep
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.extras import import_extra


class _Means:
    """Sums and counts of named numbers."""

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
    """Base of logs of means over each episode and over every n steps.

    The means are of the reward, its terms and metrics, and the observations. A custom log overrides `write`, which
    receives the means, and may override `values`, which chooses what is averaged. A wrapper then names it as its
    logic: `class MyLog(BuildingWrapper): logic = MyMeans`.
    """

    def __init__(self, view: EnvView, every: int) -> None:
        super().__init__(view)
        is_number = isinstance(every, int | float | np.number) and not isinstance(every, bool)
        if not is_number or every < 1 or every % 1 != 0:  # NaN and infinity have the remainder NaN
            raise InvalidConfig(f"{view.wrapper_name}: every = {every!r}; a whole number of steps from 1 on expected")
        reject_wrappers(view.env, ["RewardVector"], f"{view.wrapper_name} logs a scalar reward; apply it before {{}}")
        require_each_timestep(view.env, view.wrapper_name)
        self._names, self._every = [f"observation.{name}" for name in view.names], every
        self._episodes = [_Means() for _ in range(view.slots)]
        self._window, self._since, self.steps = _Means(), 0, 0

    def write(self, values: Mapping[str, float], step: int) -> None:
        """Write means: those of an episode at its end (`episode/…`), and those of every n steps (`steps/…`).

        Args:
            values: means by name, for an episode with `episode/return` and `episode/steps`.
            step: the number of steps of all slots so far.
        """
        raise NotImplementedError

    @override
    def start(self, start: ResetBatch) -> Values:
        for slot in start.slots:
            self._episodes[slot] = _Means()
        return start.observations

    @override
    def step(self, step: StepBatch) -> tuple[Values, Values]:
        for row, slot in enumerate(step.slots):
            values = self.values(row, step)
            self.steps += 1
            self._since += 1
            self._window.add(values)
            self._episodes[slot].add(values)
            if self._since == self._every:
                self.write(self._window.means("steps"), self.steps)
                self._window, self._since = _Means(), 0
            if step.ends[row]:
                self._end(slot)
        return step.observations, step.rewards

    def values(self, row: int, step: StepBatch) -> dict[str, float]:
        """Return the numbers to average, by name, for one timestep of the slot `step.slots[row]`."""
        values = {"reward": float(step.rewards[row])}
        for group, key in (("reward", "reward_terms"), ("metric", "reward_metrics")):
            group_values = step.infos.get(row, key) or {}
            values |= {f"{group}.{name}": float(value) for name, value in group_values.items() if np.ndim(value) == 0}
        return values | dict(zip(self._names, np.ravel(step.observations[row]).tolist(), strict=True))

    def _end(self, slot: int) -> None:
        episode = self._episodes[slot]
        count, total = episode.counts["reward"], episode.sums["reward"]
        self.write(episode.means("episode") | {"episode/return": total, "episode/steps": float(count)}, self.steps)

    snapshot_aware = False  # a reset to a snapshot does not undo the steps that were logged

    def get_state(self) -> list[dict[str, Any]]:
        """Return the number of steps, so that a resumed training continues the count."""
        return [{"steps": self.steps} for _ in range(self.view.slots)]

    @override
    def set_state(self, slots: Any) -> None:
        self.steps = int(slots[0]["steps"])


class _TensorBoardMeans(MeansLog):
    def __init__(self, view: EnvView, folder: str | Path, every: int = 1000) -> None:
        super().__init__(view, every)
        self._writer: Any = import_extra("tensorboardX", "tensorboard", view.wrapper_name).SummaryWriter(str(folder))

    def write(self, values: Mapping[str, float], step: int) -> None:
        for name, value in values.items():
            self._writer.add_scalar(name, value, step)

    def close(self) -> None:
        if self._writer is not None:
            self._writer.close()
            self._writer = None


class TensorBoardLog(BuildingWrapper):
    """Write means to TensorBoard (needs the extra `tensorboard`).

    At each episode's end it writes `episode/…`: the means over the episode's steps, `episode/return` and
    `episode/steps`; every `every` steps `steps/…`: the means since the last write. The means are of the reward, its
    terms (`reward.`) and metrics (`metric.`), and the observations (`observation.`) as this wrapper returns them. The
    step is the number of steps of all slots.

    Args:
        folder: folder of TensorBoard's event file.
        every: interval of `steps/…` in steps; 1000 by default.

    Raises:
        InvalidConfig: the extra is missing, or an inner wrapper is a `RewardVector` or repeats actions.
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
        tags: str | Sequence[str] | None = None,
        artifacts: str | Path | Sequence[str | Path] = (),
    ) -> None:
        super().__init__(view, every)
        self._artifacts = [Path(path).absolute() for path in _several(artifacts)]
        names = [path.name for path in self._artifacts]
        if not all(names) or len(set(names)) < len(names):
            raise InvalidConfig(
                f"{view.wrapper_name}: artifacts {', '.join(map(str, self._artifacts))}; files and folders expected, "
                "each with another name, because the run has them without their paths"
            )
        wandb = self._wandb = import_extra("wandb", "wandb", view.wrapper_name)
        settings: dict[str, Any] = {"project": project, "name": name, "mode": mode, "config": dict(config or {})}
        settings |= {"entity": entity, "group": group, "tags": None if tags is None else _several(tags)}
        self._run: Any = wandb.init(**settings, dir=None if folder is None else str(folder), reinit="create_new")

    def write(self, values: Mapping[str, float], step: int) -> None:
        self._run.log(dict(values), step=step)

    def close(self) -> None:
        run, self._run = self._run, None
        if run is not None:
            try:
                self._log_artifacts(run)
            finally:
                run.finish()

    def _log_artifacts(self, run: Any) -> None:
        existing = [path for path in self._artifacts if path.exists()]
        if missing := [str(path) for path in self._artifacts if path not in existing]:
            warnings.warn(f"{self.view.wrapper_name}: artifacts that do not exist: {', '.join(missing)}", stacklevel=2)
        if existing:
            artifact = self._wandb.Artifact(f"run-{run.id}", type="output")
            for path in existing:
                if path.is_dir():
                    artifact.add_dir(str(path), name=path.name)
                else:
                    artifact.add_file(str(path), name=path.name)
            run.log_artifact(artifact)


def _several(values: Any) -> list[Any]:
    """Return one text or path, or several of them, as a list."""
    return [values] if isinstance(values, str | Path) else list(values)


class WeightsAndBiasesLog(BuildingWrapper):
    """Log means to a run of Weights & Biases (needs the extra `wandb`); the same means as `TensorBoardLog`.

    Args:
        project: name of the project.
        name: name of the run.
        every: interval of `steps/…` in steps; 1000 by default.
        mode: `offline`, the default, writes files that `wandb sync` uploads later; `online` needs a login.
        folder: folder of wandb's files; None is the working directory.
        config: the run's configuration.
        entity: the user or team that owns the run; None is the default of the login.
        group: the group of runs that it belongs to.
        tags: a tag of the run, or several.
        artifacts: a file or folder, or several with different names, that are logged as an artifact of the run when the
            environment is closed. Those that do not exist then are named in a warning.

    Raises:
        InvalidConfig: the extra is missing, artifacts have the same name, or an inner wrapper is a `RewardVector` or
            repeats actions.
    """

    logic = _WeightsAndBiasesMeans
