"""`zenostat calibrate`: fit a building model to measured data."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zenostat.cli.console import err, out, progress
from zenostat.cli.reports import command_line
from zenostat.cli.tables import show, show_json
from zenostat.cli.train import override_fields, set_option
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.extras import import_extra
from zenostat.topics.file_kinds import FileKind

if TYPE_CHECKING:
    from zenostat.lab.calibration.calibrate import CalibrationResult
    from zenostat.lab.calibration.config import Calibration
    from zenostat.lab.calibration.measured import MeasuredData
    from zenostat.models.calibration.runs import ModelRuns


def calibrate(
    model: Annotated[str, typer.Argument(help="Building model: an IDF or epJSON file, or a short name.")],
    measured: Annotated[Path, typer.Argument(metavar="MEASURED.csv", help="Measured data with timestamps.")],
    file: Annotated[Path, typer.Option("--parameters", metavar="FILE.yaml", help="Parameters file.")],
    weather: Annotated[str, typer.Option(help="Weather file of the measured period, or a name.")],
    workers: Annotated[
        int | None, typer.Option(min=1, max=256, help="Simulations at the same time; the result is the same.")
    ] = None,
    trials: Annotated[int | None, typer.Option(min=1, help="Number of trials.")] = None,
    output: Annotated[Path | None, typer.Option(help="Folder of the results.")] = None,
    fields: Annotated[list[str] | None, set_option("seed=1 or missing=leave_out")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Fit parameters of a building model to measured data with Optuna, and show how well each is determined.

    Example: `zenostat calibrate office.idf measured.csv --parameters office.yaml --weather site-2024.epw --workers 4`

    Ctrl-C ends it; the same command continues, with the same result to the bit. The folder of the results then has the
    calibrated model, a report, and tables.
    """
    from zenostat.lab.calibration.calibrate import calibrate as run

    config, data, runs = prepare(model, measured, file, weather, workers, trials, output, fields or ())
    _check_report()
    with progress() as bars:
        bar = bars.add_task(config.study, total=config.total, rate="")
        ended = 0

        def on_result(number: int, values: Any, result: dict[str, Any]) -> None:
            nonlocal ended
            ended += 1
            bars.update(bar, completed=max(number + 1, ended))
            if not as_json:
                count = f"[{number + 1}/{config.total}] " if bars.disable else ""
                out.print(f"{count}{_line(number, values, result)}")

        result = run(config, data, runs, on_result)
        bars.update(bar, completed=config.total)
    files = write_files(result, runs, measured)
    if as_json:
        show_json(result.plain())
        return
    _show(result)
    for path in files:
        out.print(str(path))


def prepare(
    model: str,
    measured: Path,
    file: Path,
    weather: str,
    workers: int | None = None,
    trials: int | None = None,
    output: Path | None = None,
    fields: Sequence[str] = (),
) -> tuple[Calibration, MeasuredData, ModelRuns]:
    """Read and check everything that a calibration needs, before anything is simulated.

    Raises:
        UsageError: an error of the parameters file, the measured data, the model or the weather.
    """
    from zenostat.bridge.recording.file import file_digest
    from zenostat.lab.calibration.calibrate import SCRATCH
    from zenostat.lab.calibration.config import read_calibration
    from zenostat.lab.calibration.headings import read_headings
    from zenostat.lab.calibration.measured import read_measured
    from zenostat.lab.config_file import read_file
    from zenostat.models import energyplus
    from zenostat.models.building.model import read_building
    from zenostat.models.calibration.model_edits import places, read_parameter
    from zenostat.models.calibration.runs import ModelRuns
    from zenostat.models.calibration.targets import TargetFinder
    from zenostat.models.catalog import find_building, find_weather
    from zenostat.models.weather.header import read_header

    options: dict[str, Any] = {"workers": workers, "trials": trials}
    options["output"] = None if output is None else str(output)
    overrides = {name: value for name, value in options.items() if value is not None}
    read = override_fields(read_file(file, FileKind.CALIBRATION), overrides, fields)
    if "sources" in read:
        raise InvalidConfig(f"{file}: sources: there is no such field")
    config = read_calibration({"study": file.stem, **read}, str(file))
    entry, climate = find_building(model), find_weather(weather)
    parameters = tuple(
        read_parameter(name, parameter.edit, parameter.objects, parameter.unit)
        for name, parameter in config.parameters.items()
    )
    config = config.with_starts({parameter.name: parameter.neutral for parameter in parameters})
    building = read_building(entry)
    for parameter in parameters:
        places(building.objects, parameter)
    _, headings = read_headings(measured, config)
    finder = TargetFinder(building, climate.path)
    targets = tuple(finder.find(f"{measured}, {heading.place}", heading.target) for heading in headings)
    header = read_header(climate.path)
    data = read_measured(measured, config, headings, targets, header.time_zone_h)
    scratch = str((config.folder / SCRATCH).absolute())
    runs = ModelRuns(model, climate.path, parameters, targets, config.sizing, scratch)
    runs.check([*config.periods, *config.held_out], {name: each.ends for name, each in config.parameters.items()})
    files = {"model": entry.path, "weather": climate.path, "measured": measured}
    sources = {name: file_digest(path) for name, path in files.items()} | {"engine": energyplus.version()}
    return config.model_copy(update={"sources": sources}), data, runs


def write_files(result: CalibrationResult, runs: ModelRuns, measured: Path) -> list[Path]:
    """Write the calibrated model, the report, and the tables of a result; return their paths."""
    from zenostat.lab.calibration.report import write_report

    folder, suffix = result.config.folder, ".idf" if runs.building.file.lower().endswith(".idf") else ".epJSON"
    model = folder / f"calibrated{suffix}"
    notes = [f"calibrated with {measured.name}: {name} = {value:.6g}" for name, value in result.values.items()]
    runs.write_model(result.values, model, notes)
    result.write(folder / "result.json")
    texts = descriptions(runs)
    page = write_report(result, texts, runs.building.name, measured.name, runs.weather.name, command_line())
    return [model, folder / "result.json", *page]


def descriptions(runs: ModelRuns) -> dict[str, tuple[str, str]]:
    """Return the unit of each parameter, and what it changes."""
    from zenostat.models.calibration.model_edits import describe_places, places

    return {each.name: (each.unit, describe_places(places(runs.building.objects, each))) for each in runs.parameters}


def _check_report() -> None:
    import_extra("matplotlib.figure", "plots", "the report of a calibration")


def _line(number: int, values: Any, result: dict[str, Any]) -> str:
    outcome = f"{result['stages'][-1]:.4g}" if result["state"] != "fail" else result["reason"].partition("\n")[0]
    shown = ", ".join(f"{name} {value:.4g}" for name, value in values.items())
    return f"trial {number}: {result['state']} {outcome} ({shown})"


def _show(result: CalibrationResult) -> None:
    from zenostat.lab.calibration.report import error_rows, parameter_rows

    columns, rows = error_rows(result)
    show("Errors", columns, rows, right=columns[2:], wrap=columns[:1])
    columns, rows = parameter_rows(result)
    show("Parameters", columns, rows, right=columns[1:-1], wrap=columns[-1:])
    states = ", ".join(f"{count} {state}" for state, count in result.states.items())
    err.print(f"trials: {states}")
