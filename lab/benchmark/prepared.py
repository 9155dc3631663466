"""Controllers that the benchmark trains or tunes for each building and season, and the folders that keep them."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import fmean
from typing import Any

from zenostat.bridge.runtime.processor_time import tree_processor_s
from zenostat.lab.benchmark.definition import SETS, TUNED, Episode, digest_of
from zenostat.lab.benchmark.recipes import is_residual
from zenostat.lab.benchmark.results import current_versions
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.errors import InvalidConfig

_CURVE_POINTS = 25
_TIMES = "processor_s.json"


@dataclass(frozen=True)
class Preparation:
    """A training or a tuning of the benchmark.

    Attributes:
        cache: folder of the trainings and tunings.
        set: name of the set.
        controller: `ppo`, `sac` or `tuned`.
        building, season: what it is made for.
        training_seed: number of the training; None of a tuning.
        policies: folder that has finished ones and gets further ones; None: only the cache.
    """

    cache: Path
    set: str
    controller: str
    building: str
    season: str
    training_seed: int | None
    policies: Path | None = None

    @property
    def key(self) -> tuple[str, str, str, int | None]:
        """Controller, building, season and number of the training."""
        return (self.controller, self.building, self.season, self.training_seed)

    @property
    def name(self) -> str:
        """Its name in the results."""
        return "/".join(str(part) for part in self.key if part is not None)

    def __str__(self) -> str:
        return f"{'tuning' if self.training_seed is None else 'training'} {self.name}"

    @property
    def fields(self) -> dict[str, Any]:
        """Fields of its training file, or the arguments of the tuning."""
        of_set = SETS[self.set]
        if self.training_seed is None:
            return of_set.tuning_arguments(self.building, self.season)
        return of_set.training(self.controller, self.building, self.season, self.training_seed, self.rule)

    @property
    def tuning(self) -> Preparation | None:
        """The tuning that comes first; None if the training does not build on a tuned rule."""
        if self.training_seed is None or not is_residual(self.controller, self.building, self.season):
            return None
        return replace(self, controller=TUNED, training_seed=None)

    @property
    def rule(self) -> dict[str, Any] | None:
        """Parameters of the tuned rule on which a training builds, if any."""
        tuning = self.tuning
        return None if tuning is None else dict(read_record(tuning.file)["parameters"])

    @property
    def configuration(self) -> str:
        """Hash of its fields, in which a tuned rule is represented by the hash of its tuning."""
        if self.tuning is None:
            return digest_of(self.fields)
        rule = {"configuration": self.tuning.configuration}
        assert self.training_seed is not None
        fields = SETS[self.set].training(self.controller, self.building, self.season, self.training_seed, rule)
        return digest_of(fields)

    @property
    def folder(self) -> Path:
        """Folder of the training, named after its configuration and the versions that determine its weights."""
        digest = digest_of([self.configuration, self.rule, current_versions()])
        return self.cache / f"{self.name.replace('/', '-')}-{digest[:12]}"

    @property
    def file(self) -> Path:
        """The finished controller: a policy, or parameters with their record."""
        return self.folder.with_name(f"{self.folder.name}{self._suffix}")

    @property
    def published(self) -> Path | None:
        """Its file in the folder of policies."""
        return None if self.policies is None else self.policies / f"{self.name.replace('/', '-')}{self._suffix}"

    @property
    def _suffix(self) -> str:
        return ".json" if self.training_seed is None else ".npz"


def preparation_of(episode: Episode, set_name: str, cache: Path, policies: Path | None = None) -> Preparation:
    """Return what an episode of `ppo`, `sac` or `tuned` needs."""
    task = episode.task
    return Preparation(cache, set_name, episode.controller, task.building, task.season, episode.training_seed, policies)


def ensure_prepared(preparation: Preparation) -> tuple[Preparation, dict[str, Any]]:
    """Train or tune if neither the cache nor the folder of policies has it, and return its record for the results.

    An interrupted training is resumed, to the bit.

    Raises:
        InvalidConfig: the folder of policies has one of another configuration, or a file that cannot be read.
    """
    published = preparation.published
    if not preparation.file.is_file() and published is not None and published.is_file():
        check_published(preparation)
        preparation.cache.mkdir(parents=True, exist_ok=True)
        with atomic_file(preparation.file) as temporary:
            shutil.copyfile(published, temporary)
    if not preparation.file.is_file():
        preparation.cache.mkdir(parents=True, exist_ok=True)
        with _measured(preparation):
            (_tune if preparation.training_seed is None else _train)(preparation)
    if published is not None and not published.is_file():
        published.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(published) as temporary:
            shutil.copyfile(preparation.file, temporary)
    record = read_record(preparation.file)
    return preparation, {**record, "processor_s": _measured_s(preparation) or record.get("processor_s")}


def check_published(preparation: Preparation) -> Path:
    """Return the file of a training or tuning in the folder of policies.

    Raises:
        InvalidConfig: there is no such folder or file, or it cannot be read or is one of another configuration.
    """
    path = preparation.published
    if path is None or not path.is_file():
        where = "no folder of policies is named" if path is None else f"there is no file {path}"
        raise InvalidConfig(f"{preparation.name}: {where}; `zenostat benchmark --policies FOLDER` makes it")
    if read_record(path)["configuration"] != preparation.configuration:
        raise InvalidConfig(f"{path} was made for another definition: choose another folder of policies")
    return path


def read_record(file: Path) -> dict[str, Any]:
    """Return the record of a finished training or tuning.

    Raises:
        InvalidConfig: the file is damaged.
    """
    if file.suffix == ".json":
        try:
            record = json.loads(file.read_text(encoding="utf-8"))
        except (ValueError, RecursionError) as error:
            raise InvalidConfig(f"{file} has no tuned parameters: {error}") from None
    else:
        from zenostat.agent_sdk.controllers.network_policy import load_network

        policy = load_network(file)
        record = {**policy.record, "weights": policy.digest()}
    if not isinstance(record, dict) or "configuration" not in record:
        raise InvalidConfig(f"{file} was not made by the benchmark: it has no configuration")
    if file.suffix == ".json" and not isinstance(record.get("parameters"), dict):
        raise InvalidConfig(f"{file} was not made by the benchmark: it has no parameters")
    return record


def _train(preparation: Preparation) -> None:
    from zenostat.agent_sdk.controllers.training_folder import CURVE, EVALUATIONS, is_training
    from zenostat.lab.training import export_policy, read_training, train

    folder = preparation.folder
    config = read_training({**preparation.fields, "output": str(folder)}, str(preparation))
    train(config, resume=is_training(folder))
    record = {
        "configuration": preparation.configuration,
        "curve": _curve(folder / CURVE, config.steps),
        "evaluations": _evaluations(folder / EVALUATIONS),
        "parameters": preparation.rule,
    }
    export_policy(folder, record).save(preparation.file)


def _curve(file: Path, steps: int) -> dict[str, Any]:
    """Return the means of the training episodes' rewards in equal parts of the training."""
    parts: dict[int, list[float]] = {}
    with file.open(newline="", encoding="utf-8") as opened:
        for row in csv.DictReader(opened):
            part = -(-int(row["step"]) * _CURVE_POINTS // steps)
            parts.setdefault(min(part, _CURVE_POINTS), []).append(float(row["reward"]))
    known = sorted(parts)
    return {
        "steps": [round(part * steps / _CURVE_POINTS) for part in known],
        "rewards": [round(fmean(parts[part]), 3) for part in known],
    }


def _evaluations(file: Path) -> dict[str, Any]:
    """Return the mean reward of each evaluation of a training."""
    evaluations: dict[int, list[float]] = {}
    with file.open(newline="", encoding="utf-8") as opened:
        for row in csv.DictReader(opened):
            evaluations.setdefault(int(row["step"]), []).append(float(row["reward"]))
    return {"steps": [*evaluations], "rewards": [round(fmean(rewards), 3) for rewards in evaluations.values()]}


def _tune(preparation: Preparation) -> None:
    from zenostat.lab.tuning import tune_controller

    tuned = tune_controller(**preparation.fields)
    record = {
        "configuration": preparation.configuration,
        "parameters": dict(tuned.parameters),
        "value": tuned.value,
        "default_value": tuned.default_value,
    }
    with atomic_file(preparation.file) as temporary:
        temporary.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


@contextmanager
def _measured(preparation: Preparation) -> Iterator[None]:
    """Add the processor time of what runs within to that of earlier attempts."""
    begin = tree_processor_s()
    try:
        yield
    finally:
        total = (_measured_s(preparation) or 0.0) + tree_processor_s() - begin
        with atomic_file(_times(preparation)) as temporary:
            temporary.write_text(json.dumps(total), encoding="utf-8")


def _times(preparation: Preparation) -> Path:
    return preparation.folder.with_name(f"{preparation.folder.name}-{_TIMES}")


def _measured_s(preparation: Preparation) -> float | None:
    try:
        return round(float(json.loads(_times(preparation).read_text(encoding="utf-8"))), 2)
    except (OSError, ValueError):
        return None
