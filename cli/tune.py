"""`zenostat tune`: search the parameters of a training or of a controller."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zenostat.cli.console import out, progress
from zenostat.cli.tables import show
from zenostat.cli.train import override_fields, set_option, stop_signals
from zenostat.topics.file_kinds import FileKind

if TYPE_CHECKING:
    from zenostat.lab.tuning.study_config import StudyConfig

_SHOWN = 15
_DEFAULT = "default"
"""Text for a trial that has the defaults of the controller."""


def tune(
    file: Annotated[Path, typer.Argument(metavar="FILE.yaml", help="Tuning file.")],
    workers: Annotated[
        int | None, typer.Option(min=1, max=256, help="Trials at the same time on this machine.")
    ] = None,
    trials: Annotated[int | None, typer.Option(min=1, help="Number of trials of the study.")] = None,
    storage: Annotated[
        str | None, typer.Option(help="URL of the database, as postgresql://user@host/name; default: a SQLite file.")
    ] = None,
    output: Annotated[Path | None, typer.Option(help="Folder of the results.")] = None,
    fields: Annotated[list[str] | None, set_option("sampler=random or pruner=false")] = None,
) -> None:
    """Search the parameters of a training or of a controller with Optuna, in processes, several at the same time.

    Example: `zenostat tune examples/tune.yaml --workers 2`

    The same command continues a study, and on other machines with the same database it joins in. Ctrl-C ends the
    running trials; they are repeated when the study continues.
    """
    from zenostat.lab.config_file import read_file
    from zenostat.lab.tuning.tuning_file import read_tuning

    options: dict[str, Any] = {"workers": workers, "trials": trials, "storage": storage}
    options["output"] = None if output is None else str(output)
    overrides = {name: value for name, value in options.items() if value is not None}
    read = override_fields(read_file(file, FileKind.TUNING), overrides, fields or ())
    config = read_tuning(read, str(file), file.parent)
    from zenostat.lab.tuning.study import Tuning
    from zenostat.lab.tuning.study_figures import write_results

    with stop_signals() as (stop, received), progress() as bars:
        bar = bars.add_task(config.study, total=config.trials, rate="")

        def show_trial(trial: Any) -> None:
            bars.update(bar, completed=tuning.ended())
            count = f"[{tuning.ended()}/{tuning.total()}] " if bars.disable else ""
            out.print(f"{count}{_line(trial)}")

        def show_wait() -> None:
            text = "waiting for trials that run elsewhere, or were lost with their machine or command"
            out.print(text, soft_wrap=True, markup=False)

        tuning = Tuning(config, show_trial, show_wait)
        bars.update(bar, completed=tuning.ended(), total=tuning.total())
        if bars.disable:
            out.print(f"{config.study}: {tuning.ended()} of {tuning.total()} trials have ended")
        is_finished = tuning.run(stop)
    _show(config, tuning.study)
    best = tuning.write_best()
    for path in (*write_results(tuning.study, config), *([best] if best else [])):
        out.print(str(path))
    if not is_finished:
        out.print("stopped; the same command continues the study")
        raise typer.Exit(128 + received[0])


def _line(trial: Any) -> str:
    from zenostat.lab.tuning.study import reason_of

    value = "" if trial.state.name == "FAIL" else _number(trial.value)
    outcome = ", ".join(text for text in (value, reason_of(trial)) if text)
    values = ", ".join(f"{name.rpartition('.')[2]} {_number(value)}" for name, value in trial.params.items())
    values = values or _DEFAULT
    return f"trial {trial.number}: {trial.state.name.lower()} {outcome} ({values})"


def _show(config: StudyConfig, study: Any) -> None:
    """Print the best trials, and how many there are of each state."""
    sign = -1 if config.direction == "maximize" else 1
    finished = sorted((t for t in study.trials if t.state.name == "COMPLETE"), key=lambda t: sign * t.value)
    names = list(config.parameters)
    rows = [
        (str(trial.number), _number(trial.value), *(_number(trial.params.get(name, _DEFAULT)) for name in names))
        for trial in finished[:_SHOWN]
    ]
    counts: dict[str, int] = {}
    for trial in study.trials:
        counts[trial.state.name.lower()] = counts.get(trial.state.name.lower(), 0) + 1
    title = f"{config.study}: {', '.join(f'{count} {state}' for state, count in counts.items())}"
    if not out.is_terminal:  # where tables have no titles
        out.print(title)
    headings = [name.removeprefix("parameters.") for name in names]
    show(title, ("trial", config.metric, *headings), rows, right=("trial", config.metric, *headings))


def _number(value: Any) -> str:
    return f"{value:,.5g}" if isinstance(value, float) else "" if value is None else str(value)
