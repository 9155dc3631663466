"""Results of a study as files: a table of the trials and figures."""

from __future__ import annotations

import csv
import importlib.util
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from optuna.trial import FrozenTrial, TrialState

from zenostat.lab.tuning.search_space import DEFAULT, encode
from zenostat.lab.tuning.study import reason_of
from zenostat.lab.tuning.study_config import StudyConfig
from zenostat.topics.atomic_file import atomic_file

TABLE = "trials.csv"
_COLUMNS = 3


def write_results(study: optuna.Study, config: StudyConfig) -> list[Path]:
    """Write `trials.csv`, and if Matplotlib is installed the figures `history`, `importance`, `slices` and `parallel`.

    Returns:
        The paths of the table and of the figures as PNG; each is also there as SVG.
    """
    trials = study.get_trials(deepcopy=False)
    table = config.folder / TABLE
    with atomic_file(table) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        names = list(config.parameters)
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["trial", "state", config.metric, "steps", "seconds", *names, "reason"])
        for trial in trials:
            seconds = "" if trial.duration is None else f"{trial.duration.total_seconds():.1f}"
            values = [trial.params.get(name, "") for name in names]
            reason = reason_of(trial)
            value = "" if trial.value is None else trial.value
            writer.writerow([trial.number, trial.state.name, value, trial.last_step or "", seconds, *values, reason])
    finished = [trial for trial in trials if trial.state is TrialState.COMPLETE]
    searched = [trial for trial in finished if DEFAULT not in trial.user_attrs]
    if importlib.util.find_spec("matplotlib") is None or not searched:
        return [table]
    from zenostat.views.report.figures.base import draw
    from zenostat.views.report.svg import save

    rows = -(-len(config.parameters) // _COLUMNS)
    figures: dict[str, tuple[float, Callable[[Any], None]]] = {
        "history": (3.0, lambda figure: _history(figure, trials, config)),
        "slices": (2.4 * rows, lambda figure: _slices(figure, searched, config)),
        "parallel": (3.2, lambda figure: _parallel(figure, searched, config)),
    }
    if importances := _importances(study, searched):
        figures["importance"] = (0.7 + 0.3 * len(importances), lambda figure: _importance(figure, importances))
    return [
        table,
        *(save(draw(name, height, fill), config.folder, name)[1] for name, (height, fill) in figures.items()),
    ]


def _importances(study: optuna.Study, finished: list[FrozenTrial]) -> dict[str, float]:
    """Return the importance of each parameter by PED-ANOVA, 0 to 1; empty where it cannot be computed."""
    if len({trial.value for trial in finished}) < 2 or len(finished) < 4:
        return {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        evaluator = optuna.importance.PedAnovaImportanceEvaluator()  # the default before 5.0 needs scikit-learn
        return optuna.importance.get_param_importances(study, evaluator=evaluator)


def _history(figure: Any, trials: list[FrozenTrial], config: StudyConfig) -> None:
    from zenostat.views.report.figures.base import legend_above
    from zenostat.views.report.theme import LIGHT

    axis = figure.subplots()
    marks = {TrialState.COMPLETE: ("o", "series-2"), TrialState.PRUNED: ("x", "series-1")}
    for state, (mark, color) in marks.items():
        chosen = [trial for trial in trials if trial.state is state and trial.value is not None]
        if chosen:
            numbers, values = [trial.number for trial in chosen], [trial.value for trial in chosen]
            axis.plot(numbers, values, mark, color=LIGHT[color], markersize=4, label=state.name.lower())
    finished = [trial for trial in trials if trial.state is TrialState.COMPLETE]
    best = np.maximum if config.direction == "maximize" else np.minimum
    bests = best.accumulate(np.array([trial.value for trial in finished], np.float64))
    axis.step([trial.number for trial in finished], bests, where="post", color=LIGHT["series-3"], label="best so far")
    for trial in trials:
        if trial.state is TrialState.FAIL:
            axis.axvline(trial.number, color=LIGHT["line"], linewidth=0.7)
    axis.xaxis.get_major_locator().set_params(integer=True)
    axis.set_xlabel("trial (vertical line: failed)" if any(t.state is TrialState.FAIL for t in trials) else "trial")
    axis.set_ylabel(config.metric)
    legend_above(axis)


def _importance(figure: Any, importances: dict[str, float]) -> None:
    from zenostat.views.report.theme import LIGHT

    axis = figure.subplots()
    names = list(importances)[::-1]
    axis.barh([_short(name) for name in names], [importances[name] for name in names], color=LIGHT["series-2"])
    axis.grid(visible=False)
    axis.set_xlim(0, 1)
    axis.set_xlabel("importance (PED-ANOVA)")


def _slices(figure: Any, finished: list[FrozenTrial], config: StudyConfig) -> None:
    from zenostat.views.report.theme import LIGHT

    names = list(config.parameters)
    columns = min(len(names), _COLUMNS)
    axes = np.ravel(figure.subplots(-(-len(names) // columns), columns, sharey=True, squeeze=False))
    for axis, name in zip(axes, names, strict=False):
        places, labels = _places(name, finished, config)
        axis.plot(places, [trial.value for trial in finished], "o", color=LIGHT["series-2"], markersize=4, alpha=0.7)
        axis.set_xlabel(_short(name))
        if labels is not None:
            axis.set_xticks(range(len(labels)), labels)
            axis.set_xlim(-0.5, len(labels) - 0.5)
        elif config.parameters[name].log:
            axis.set_xscale("log")
            axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
            axis.xaxis.set_minor_formatter(lambda *_: "")
    for axis in axes[len(names) :]:
        axis.set_visible(False)
    axes[0].set_ylabel(config.metric)


def _parallel(figure: Any, finished: list[FrozenTrial], config: StudyConfig) -> None:
    """One line per trial over the parameters, darker the better its value."""
    from zenostat.views.report.theme import LIGHT

    axis = figure.subplots()
    names = list(config.parameters)
    columns = []
    for name in names:
        places, labels = _places(name, finished, config)
        is_log = config.parameters[name].log
        scaled = np.log10(np.array(places, np.float64)) if is_log else np.array(places, np.float64)
        low, high = (0.0, len(labels) - 1.0) if labels is not None else (scaled.min(), scaled.max())
        columns.append((scaled - low) / (high - low) if high > low else np.full(len(scaled), 0.5))
        texts = (labels[0], labels[-1]) if labels is not None else (f"{min(places):.4g}", f"{max(places):.4g}")
        place = len(columns) - 1
        axis.text(place, -0.04, texts[0], ha="center", va="top", color=LIGHT["muted"], fontsize=7.5)
        axis.text(place, 1.04, texts[1], ha="center", va="bottom", color=LIGHT["muted"], fontsize=7.5)
    values = np.array([trial.value for trial in finished], np.float64)
    order = np.argsort(values if config.direction == "maximize" else -values)
    for rank, number in enumerate(order.tolist()):
        is_best = rank == len(order) - 1
        color = LIGHT["series-3"] if is_best else LIGHT["series-2"]
        strength = 1.0 if is_best else 0.15 + 0.55 * rank / max(len(order) - 1, 1)
        axis.plot(range(len(names)), [column[number] for column in columns], color=color, alpha=strength)
    axis.set_xticks(range(len(names)), [_short(name) for name in names])
    axis.tick_params(axis="x", pad=14)
    axis.set_yticks([])
    axis.set_ylim(-0.02, 1.02)
    axis.grid(visible=True, axis="x")
    axis.spines[:].set_visible(False)
    axis.set_title("one line per trial, stronger where better; orange: the best", pad=18)


def _places(name: str, finished: list[FrozenTrial], config: StudyConfig) -> tuple[list[Any], list[str] | None]:
    """Return the places of the trials on an axis, and its labels if the parameter has choices."""
    values = [trial.params[name] for trial in finished]
    choices = config.parameters[name].choices
    if choices is None:
        return values, None
    labels = [str(encode(choice)) for choice in choices]
    return [labels.index(str(value)) for value in values], labels


def _short(name: str) -> str:
    return name.rpartition(".")[2]
