"""Learning curve of a training: episodes and evaluations as CSV files and as a picture."""

from __future__ import annotations

import csv
import importlib.util
from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np

from zenostat.agent_sdk.controllers.training_folder import CURVE, EVALUATIONS, REFERENCES
from zenostat.metrics.episode_metrics import EpisodeMetrics
from zenostat.metrics.learning_curve import MEAN_OF, by_step, moving_mean, reference_means
from zenostat.topics.atomic_file import atomic_file

PICTURE = "curve"
_COLUMNS = ("step", "slot", "reward", "steps")
_STYLES = ("--", ":", "-.")


class CurveFile:
    """Rows of a CSV file that grows during a training; each row is on disk when it is added.

    Args:
        path: the file.
        until: keep the rows of an earlier run up to this training step; None: begin a new file.

    Attributes:
        rows: all rows; the first column is the training step.
    """

    def __init__(self, path: Path, until: int | None = None) -> None:
        self._path = path
        self._file: Any = None
        self.rows: list[dict[str, Any]] = [] if until is None else _read(path, until)
        with atomic_file(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
            _write(file, self.rows)

    def add(self, row: Mapping[str, Any]) -> None:
        """Add a row with the same columns as the others."""
        if self._file is None:
            self._file = self._path.open("a", newline="", encoding="utf-8", buffering=1)
        self.rows.append(dict(row))
        _write(self._file, self.rows[-1:], header=len(self.rows) == 1)

    def close(self) -> None:
        """Close the file; idempotent."""
        if self._file is not None:
            self._file.close()
            self._file = None


def _write(file: Any, rows: Sequence[Mapping[str, Any]], *, header: bool = True) -> None:
    if not rows:
        return
    writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
    if header:
        writer.writeheader()
    writer.writerows(rows)


def _read(path: Path, until: int) -> list[dict[str, Any]]:
    """Return the rows of a file up to a training step; a last line that is not complete is left out."""
    if not path.is_file():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if None not in row.values() and row["step"].isdigit()]
    return [{name: _number(text) for name, text in row.items()} for row in rows if int(row["step"]) <= until]


def reference_rewards(folder: Path) -> dict[str, float]:
    """Return the mean reward of an episode by reference of a training; empty if none was evaluated."""
    return reference_means(folder / REFERENCES, "reward")


def _number(text: str) -> int | float | None:
    if not text:
        return None
    return int(text) if text.lstrip("-").isdigit() else float(text)


class LearningCurve:
    """Episodes of a training and its evaluations.

    Args:
        folder: where `curve.csv` and `evaluations.csv` are written.
        until: as for `CurveFile`.
    """

    def __init__(self, folder: Path, until: int | None = None) -> None:
        self._folder = folder
        self.episodes = CurveFile(folder / CURVE, until)
        self.evaluations = CurveFile(folder / EVALUATIONS, until)

    def add_episodes(self, step: int, infos: Sequence[Mapping[str, Any]]) -> None:
        """Add the episodes that ended in a step: those whose info has an `episode`."""
        for slot, info in enumerate(infos):
            if (episode := info.get("episode")) is not None:
                values = (step, slot, float(episode["r"]), int(episode["l"]))
                self.episodes.add(dict(zip(_COLUMNS, values, strict=True)))

    def add_evaluation(self, step: int, seed: int, results: Sequence[EpisodeMetrics]) -> None:
        """Add the metrics of the episodes of an evaluation, the first of which has this seed."""
        for number, result in enumerate(results):
            self.evaluations.add({"step": step, "seed": seed + number, **result.metrics()})

    @property
    def mean_reward(self) -> float | None:
        """Mean reward of the last hundred episodes; None before the first has ended."""
        rewards = [row["reward"] for row in self.episodes.rows[-MEAN_OF:]]
        return float(np.mean(rewards)) if rewards else None

    def close(self) -> None:
        """Close the files, and draw the picture if Matplotlib is installed and there is anything to draw."""
        self.episodes.close()
        self.evaluations.close()
        if importlib.util.find_spec("matplotlib") is not None and (self.episodes.rows or self.evaluations.rows):
            self._draw()

    def _draw(self) -> None:
        from zenostat.views.report.figures.base import draw, legend_above
        from zenostat.views.report.svg import save
        from zenostat.views.report.theme import LIGHT

        steps, rewards = (
            np.array([row[name] for row in self.episodes.rows], np.float64) for name in ("step", "reward")
        )
        evaluations = by_step(*([row[name] for row in self.evaluations.rows] for name in ("step", "reward")))

        def fill(figure: Any) -> None:
            axis = figure.subplots()
            axis.plot(steps, rewards, ".", color=LIGHT["series-1"], markersize=3, alpha=0.5, label="training episode")
            if len(rewards) > 1:
                axis.plot(steps, moving_mean(rewards), color=LIGHT["series-1"], label=f"mean of {MEAN_OF} episodes")
            if evaluations:
                places, means, lows, highs = zip(*evaluations, strict=True)
                axis.plot(places, means, "o-", color=LIGHT["series-2"], markersize=4, label="evaluation, mean")
                if lows != highs:
                    axis.fill_between(places, lows, highs, color=LIGHT["series-2"], alpha=0.15, linewidth=0)
            for style, (name, reward) in zip(cycle(_STYLES), reference_rewards(self._folder).items(), strict=False):
                axis.axhline(reward, color=LIGHT["ink"], linestyle=style, linewidth=1, label=f"{name}, mean")
            axis.set_xlabel("training step")
            axis.set_ylabel("reward of an episode")
            axis.xaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
            axis.yaxis.set_major_formatter(lambda value, _: f"{value:,.5g}")
            legend_above(axis)

        save(draw(PICTURE, 3.2, fill), self._folder, PICTURE)
