"""Trainings, studies and recordings in a folder: settings, curves and states, read while they run."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from statistics import fmean
from typing import Any

from zenostat.agent_sdk.controllers.controller_file import ControllerFile, read_controller_file
from zenostat.agent_sdk.controllers.training_folder import (
    CHECKPOINTS,
    CURVE,
    EVALUATIONS,
    LOCK,
    MODEL,
    REFERENCES,
    SCENARIO,
    TRAINING,
    read_training_fields,
)
from zenostat.metrics.learning_curve import MEAN_OF, by_step, moving_mean, reference_means
from zenostat.topics.errors import InvalidConfig, UnknownName, UsageError, did_you_mean
from zenostat.views.room.csv_table import CsvTable
from zenostat.views.room.numbers import number, numbers

REPORT = "report.html"
MAX_RUNS = 500
MAX_RECORDINGS = 500
MAX_POINTS = 1000
"""Largest number of points of a curve that are sent."""

_SCANNED_S = 1.0
_MAX_DEPTH = 6
_RECORDING = ".mcap"
_NOT_ENTERED = (CHECKPOINTS, "tensorboard", "wandb")
_PROGRESS_STEP = "time/total_timesteps"
_TRIALS, _REQUEST, _RESULT, _BEST = "trials", "trial.json", "result.json", "best.yaml"


class TrainingRun:
    """The folder of a training.

    Args:
        folder: of the training.
        name: its path below the folder of all trainings.
    """

    def __init__(self, folder: Path, name: str) -> None:
        self.folder, self.name = folder, name
        self._tables: dict[str, CsvTable] = {}
        self._fields: dict[str, Any] = {}
        self._fields_changed_ns, self._problem = -1, ""

    def table(self, file: str) -> Mapping[str, list[float | None]]:
        """Return the columns of one of its CSV files, as they are now."""
        table = self._tables.setdefault(file, CsvTable(self.folder / file))
        table.update()
        return table.columns

    @property
    def progress_files(self) -> list[str]:
        """Names of the logs of stable-baselines3; a training that was resumed has several."""
        return sorted((path.name for path in self.folder.glob("progress*.csv")), key=lambda name: (len(name), name))

    def summary(self, locked: frozenset[int]) -> dict[str, Any]:
        """Return its entry in the list of trainings; `locked`: the files that processes have locked."""
        fields = self._training_fields()
        episodes, evaluations = self.table(CURVE), self.table(EVALUATIONS)
        rewards = [value for value in episodes.get("reward", []) if value is not None]
        means = by_step(evaluations.get("step", []), evaluations.get("reward", []))
        steps = [each for table in (episodes, evaluations) for each in table.get("step", [])[-1:]]
        steps += [each for file in self.progress_files for each in self.table(file).get(_PROGRESS_STEP, [])[-1:]]
        progress = [name for file in self.progress_files for name in self.table(file) if name != _PROGRESS_STEP]
        return {
            "name": self.name,
            "problem": self._problem,
            "algorithm": str(fields.get("algorithm", "")),
            "scenario": str(fields.get("scenario", "")),
            "seed": fields.get("seed"),
            "steps": fields.get("steps"),
            "step": max((step for step in steps if step is not None), default=0),
            "episodes": len(rewards),
            "reward": number(fmean(rewards[-MEAN_OF:])) if rewards else None,
            "evaluation": number(means[-1].mean) if means else None,
            "best": number(max(each.mean for each in means)) if means else None,
            "references": self.references("reward"),
            "state": self._state(locked),
            "has_report": (self.folder / REPORT).is_file(),
            "has_scenario": (self.folder / SCENARIO).is_file(),
            "metrics": [
                "episode",
                *(f"evaluation:{name}" for name in evaluations if name not in ("step", "seed")),
                *(f"progress:{name}" for name in dict.fromkeys(progress)),
            ],
        }

    def _training_fields(self) -> dict[str, Any]:
        try:
            changed_ns = (self.folder / TRAINING).stat().st_mtime_ns
            if changed_ns != self._fields_changed_ns:
                self._fields, self._problem = {}, ""
                self._fields_changed_ns = changed_ns
                self._fields = read_training_fields(self.folder)
        except (OSError, InvalidConfig) as error:
            self._problem = str(error)
        return self._fields

    def _state(self, locked: frozenset[int]) -> str:
        with suppress(OSError):
            if (self.folder / LOCK).stat().st_ino in locked:
                return "training"
        return "finished" if (self.folder / MODEL).is_file() else "stopped"

    def references(self, metric: str) -> dict[str, float]:
        """Return the mean of a metric by reference controller."""
        return reference_means(self.folder / REFERENCES, metric)

    def curve(self, metric: str) -> dict[str, Any]:
        """Return a metric over the training's steps.

        Args:
            metric: `episode`, the mean reward of the last hundred episodes; `evaluation:NAME`, the mean over the
                episodes of each evaluation with its extremes; or `progress:NAME` of stable-baselines3's log.

        Raises:
            UnknownName: there is no such metric.
        """
        kind, _, name = metric.partition(":")
        references: dict[str, float] = {}
        if metric == "episode":
            rows = _moving_means(self.table(CURVE))
            references = self.references("reward")
        elif kind == "evaluation":
            table = self.table(EVALUATIONS)
            rows = list(by_step(table["step"], table[name])) if name in table and "step" in table else []
            references = self.references(name)
        elif kind == "progress":
            rows = [row for file in self.progress_files for row in _progress(self.table(file), name)]
        else:
            raise UnknownName(f"metric {metric!r}: expected episode, evaluation:NAME or progress:NAME")
        rows = _thinned(rows)
        has_extremes = any(low != high for _, _, low, high in rows)
        return {
            "name": self.name,
            "metric": metric,
            "step": [step for step, *_ in rows],
            "mean": numbers([mean for _, mean, _, _ in rows]),
            "low": numbers([low for _, _, low, _ in rows]) if has_extremes else None,
            "high": numbers([high for _, _, _, high in rows]) if has_extremes else None,
            "references": {name: number(value) for name, value in references.items()},
        }


_Row = tuple[float, float, float, float]
"""Step, mean, lowest and highest value."""


def _moving_means(table: Mapping[str, list[float | None]]) -> list[_Row]:
    """Return the mean reward of each episode and those before it, at most a hundred."""
    pairs = [
        (step, value)
        for step, value in zip(table.get("step", []), table.get("reward", []), strict=True)
        if step is not None and value is not None
    ]
    means = moving_mean([value for _, value in pairs]).tolist()
    return [(step, mean, mean, mean) for (step, _), mean in zip(pairs, means, strict=True)]


def _progress(table: Mapping[str, list[float | None]], name: str) -> Iterator[_Row]:
    """Yield the values of a log."""
    for step, value in zip(table.get(_PROGRESS_STEP, []), table.get(name, []), strict=False):
        if step is not None and value is not None:
            yield step, value, value, value


def _thinned(rows: list[_Row]) -> list[_Row]:
    """Return at most `MAX_POINTS` rows, the last one among them, with the extremes of those that are left out."""
    stride = -(-len(rows) // MAX_POINTS)
    if stride <= 1:
        return rows
    groups = [rows[at : at + stride] for at in range(0, len(rows), stride)]
    return [
        (group[-1][0], group[-1][1], min(row[2] for row in group), max(row[3] for row in group)) for group in groups
    ]


class Trainings:
    """All trainings, studies and recordings below a folder; thread-safe, and read once for all pages.

    Args:
        folder: of trainings.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._lock = folder.resolve(), threading.Lock()
        self._runs: dict[str, TrainingRun] = {}
        self._recordings: dict[str, Path] = {}
        self._best: dict[str, Path] = {}
        self._content: dict[str, Any] = {}
        self._read_s = float("-inf")

    def content(self) -> dict[str, Any]:
        """Return all trainings, studies and recordings; what is older than a second is read again."""
        with self._lock:
            if time.monotonic() - self._read_s > _SCANNED_S:
                self._content = self._scan()
                self._read_s = time.monotonic()
            return self._content

    def run(self, name: str) -> TrainingRun:
        """Return a training by its name.

        Raises:
            UnknownName: there is none of that name.
        """
        self.content()
        with self._lock:
            if name not in self._runs:
                raise UnknownName(f"no training {name!r} in the folder; {did_you_mean(name, self._runs)}")
            return self._runs[name]

    def recording(self, name: str) -> Path:
        """Return the file of a recording by its name, its path below the folder.

        Raises:
            UnknownName: there is none of that name, or it is a link.
        """
        self.content()
        with self._lock:
            path = self._recordings.get(name)
        if path is None or not _is_file(path):
            raise UnknownName(f"no recording {name!r} in the folder; {did_you_mean(name, self._recordings)}")
        return path

    def tuned(self) -> dict[str, ControllerFile]:
        """Return the best controller of each study of controllers, by the name of the study."""
        self.content()
        with self._lock:
            files = dict(self._best)
        tuned = {}
        for name, path in files.items():
            with suppress(UsageError):  # that of a study of trainings, or damaged
                tuned[name] = read_controller_file(path)
        return tuned

    def curve(self, name: str, metric: str) -> dict[str, Any]:
        """Return the curve of a training; see `TrainingRun.curve`."""
        run = self.run(name)
        with self._lock:
            return run.curve(metric)

    def _scan(self) -> dict[str, Any]:
        runs: dict[str, TrainingRun] = {}
        recordings: dict[str, Path] = {}
        best: dict[str, Path] = {}
        studies = []
        for folder, names in _folders(self._folder):
            name = folder.relative_to(self._folder).as_posix()
            if TRAINING in names and len(runs) < MAX_RUNS:
                runs[name] = self._runs.get(name) or TrainingRun(folder, name)
            if _TRIALS in names:
                studies.append(_study(folder, name))
                if _is_file(folder / _BEST):
                    best[name] = folder / _BEST
            files = [folder / each for each in sorted(names) if each.endswith(_RECORDING)]
            for path in filter(_is_file, files[: MAX_RECORDINGS - len(recordings)]):
                recordings[path.relative_to(self._folder).as_posix()] = path
        self._runs, self._recordings, self._best = runs, recordings, best
        locked = _locked_files()
        summaries = [run.summary(locked) for run in runs.values()]
        return {
            "runs": summaries,
            "studies": [study for study in studies if study["trials"]],
            "recordings": [_recording(name, path, runs) for name, path in recordings.items()],
        }


def _folders(root: Path) -> Iterator[tuple[Path, list[str]]]:
    """Yield the folders below a folder with the names in each, sorted; links are not followed."""
    for path, folders, files in os.walk(root):
        depth = len(Path(path).relative_to(root).parts)
        yield Path(path), [*folders, *files]
        folders[:] = sorted(
            name for name in folders if depth < _MAX_DEPTH and not name.startswith(".") and name not in _NOT_ENTERED
        )


def _is_file(path: Path) -> bool:
    """Return whether a path is a regular file, and no link to one."""
    return path.is_file() and not path.is_symlink()


def _recording(name: str, path: Path, runs: Mapping[str, TrainingRun]) -> dict[str, Any]:
    """Return a recording's entry in the list: its size, and the training in whose folder it lies."""
    parents = [parent.as_posix() for parent in Path(name).parents]
    try:
        size = path.stat().st_size
    except OSError:  # it was removed
        size = 0
    return {"name": name, "bytes": size, "run": next((parent for parent in parents if parent in runs), None)}


def _locked_files() -> frozenset[int]:
    """Return the inodes of files with a lock; asking for a lock could make a training that begins fail."""
    try:
        lines = Path("/proc/locks").read_text(encoding="ascii").splitlines()
    except OSError:
        return frozenset()
    fields = [line.split() for line in lines]
    return frozenset(int(part.rpartition(":")[2]) for parts in fields for part in parts if part.count(":") == 2)


def _study(folder: Path, name: str) -> dict[str, Any]:
    """Return a study by the folders of its trials: their values, and the parameters in which they differ."""
    trials, parameters = [], []
    metric = ""
    for path in sorted((folder / _TRIALS).iterdir()):
        request, result = _json(path / _REQUEST), _json(path / _RESULT)
        if not request or not path.name.isdigit():
            continue
        metric = metric or str(request.get("metric", ""))
        # Nothing else of the request: the address of its database may contain a password.
        training = {each: value for each, value in _mapping(request, "training").items() if each != "output"}
        parameters.append(dict(_flat(training or _mapping(request, "parameters"))))
        value = result.get("value")
        trials.append(
            {
                "number": int(path.name),
                "state": str(result.get("state", "running")),
                "value": number(value) if isinstance(value, int | float) else None,
                "reason": str(result.get("reason", ""))[:500],
                "run": f"{name}/{_TRIALS}/{path.name}/training" if training else None,
            }
        )
    varied = [key for key in dict.fromkeys(key for each in parameters for key in each) if _varies(key, parameters)]
    for trial, each in zip(trials, parameters, strict=True):
        trial["parameters"] = {key: each[key] for key in varied if key in each}
    return {"name": name, "metric": metric, "varied": varied, "trials": trials}


def _mapping(content: Mapping[str, Any], name: str) -> dict[str, Any]:
    value = content.get(name)
    return value if isinstance(value, dict) else {}


def _flat(fields: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in fields.items():
        if isinstance(value, Mapping) and value:
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def _varies(key: str, parameters: list[dict[str, Any]]) -> bool:
    return len({json.dumps(each.get(key), sort_keys=True) for each in parameters}) > 1


def _json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_bytes())
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}
