"""Calibrations with known truth: data that a perturbed model made, with noise, for three buildings.

python -m bench.calibration run FOLDER [--workers N] [BUILDING ...]   # calibrate; finished ones are kept
python -m bench.calibration table FOLDER    # show the results, and write them and the figure into docs/calibration.md
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import date, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from zenostat.cli.calibrate import prepare, write_files
from zenostat.lab.calibration.calibrate import calibrate
from zenostat.lab.calibration.objective import compare, objective, scales_of
from zenostat.models.building.model import read_building
from zenostat.models.calibration.model_edits import read_parameter
from zenostat.models.calibration.runs import ModelRuns
from zenostat.models.calibration.targets import TargetFinder
from zenostat.models.catalog import find_building, find_weather
from zenostat.topics import yaml12
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.units import conversion

WEATHER = "USA_IL_Chicago"
TRAINING = (("2017-01-09", "2017-01-22"), ("2017-07-10", "2017-07-23"))
HELD_OUT = (("2017-04-17", "2017-04-23"), ("2017-08-21", "2017-08-27"))
TRIALS = {"ref-small-office": 54, "ref-stand-alone-retail": 54, "ref-warehouse": 54}
"""Trials of each building: six generations of the sampler."""
REFINE = 20
"""Steps after the trials, at most."""

METER_NOISE, TEMPERATURE_NOISE_K = 0.05, 0.3
"""Standard deviations of the noise: of meters as share of the value, of temperatures."""

RANGES: Mapping[str, dict[str, Any]] = {
    "infiltration": {"low": 0.3, "high": 3.0, "log": True},
    "insulation": {"low": 0.4, "high": 2.5, "log": True},
    "lighting": {"low": 0.6, "high": 1.6},
    "equipment": {"low": 0.6, "high": 1.6},
    "people": {"low": 0.5, "high": 1.5},
    "outdoor_air": {"low": 0.5, "high": 2.0, "log": True},
    "cooling_efficiency": {"low": 0.6, "high": 1.4},
    "heating_efficiency": {"low": 0.75, "high": 1.2},
    "heating_setpoint": {"low": -2.0, "high": 2.0},
    "cooling_setpoint": {"low": -2.0, "high": 2.0},
}
"""Ranges of the parameters, by kind."""

CASES: Mapping[str, tuple[dict[str, float], tuple[str, ...]]] = {
    "ref-small-office": (
        {"infiltration": 1.7, "insulation": 0.65, "lighting": 1.25, "equipment": 0.8, "people": 0.75,
         "cooling_efficiency": 0.8, "heating_setpoint": -0.8},
        ("core_zn_air_temperature", "perimeter_zn_1_air_temperature"),
    ),
    "ref-stand-alone-retail": (
        {"infiltration": 0.6, "insulation": 1.5, "lighting": 0.8, "equipment": 1.3, "outdoor_air": 1.4,
         "cooling_efficiency": 1.2, "heating_setpoint": 0.9},
        ("core_retail_air_temperature", "back_space_air_temperature"),
    ),
    "ref-warehouse": (
        {"infiltration": 1.4, "insulation": 0.7, "lighting": 1.2, "equipment": 0.85, "heating_efficiency": 0.9,
         "cooling_setpoint": 0.7},
        ("office_air_temperature", "finestorage_air_temperature"),
    ),
}  # fmt: skip
"""True values and measured temperatures of each building."""

METERS = ("electricity_facility", "naturalgas_facility")
PAGE = Path(__file__).parents[1] / "docs" / "calibration.md"
FIGURE = PAGE.parent / "images" / "calibration.svg"
BEGIN_MARK, END_MARK = "<!-- tables of bench.calibration -->", "<!-- end of the tables -->"


def write_case(building: str, folder: Path, *, trials: int, workers: int) -> None:
    """Write the measured data and the parameters file of a case."""
    truth, temperatures = CASES[building]
    columns = {f"{name} [kWh]": name for name in METERS} | {f"{name} [degC]": name for name in temperatures}
    weather = find_weather(WEATHER).path
    finder = TargetFinder(read_building(find_building(building)), weather)
    targets = tuple(finder.find("the case", name) for name in columns.values())
    parameters = tuple(read_parameter(name, name) for name in truth)
    runs = ModelRuns(building, weather, parameters, targets)
    rng = np.random.Generator(np.random.PCG64([7, *building.encode()]))
    with (folder / "measured.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["time", *columns])
        for first, last in sorted((*TRAINING, *HELD_OUT)):
            hours = runs.simulate(truth, (date.fromisoformat(first), date.fromisoformat(last)))
            noisy = _with_noise(hours, len(METERS), rng)
            begin = datetime.fromisoformat(first)
            writer.writerows(
                [(begin + timedelta(hours=hour + 1)).isoformat(" "), *(f"{value:.5g}" for value in row)]
                for hour, row in enumerate(noisy.tolist())
            )
    fields = {
        "study": building,
        "timestamps": "end",
        "periods": [list(days) for days in TRAINING],
        "held_out": [list(days) for days in HELD_OUT],
        "parameters": {name: {"edit": name, **RANGES[name], "truth": value} for name, value in truth.items()},
        "trials": trials,
        "refine": REFINE,
        "workers": workers,
        "output": str(folder),
    }
    (folder / "parameters.yaml").write_text(yaml12.dump(fields), encoding="utf-8")


def _with_noise(hours: Any, meters: int, rng: np.random.Generator) -> Any:
    """Return meters in kWh and temperatures in degC, with noise."""
    way = conversion("J", "kWh")
    assert way is not None
    noise = rng.standard_normal(hours.shape)
    noisy = hours.copy()
    noisy[:, :meters] = hours[:, :meters] * way[0] * (1.0 + METER_NOISE * noise[:, :meters])
    noisy[:, meters:] = hours[:, meters:] + TEMPERATURE_NOISE_K * noise[:, meters:]
    return noisy


def run(folder: Path, buildings: Sequence[str], trials: int | None, workers: int) -> None:
    """Calibrate the buildings that the folder has no result of."""
    for building in buildings:
        case = folder / building
        case.mkdir(parents=True, exist_ok=True)
        if (case / "summary.json").exists():
            continue
        if not (case / "parameters.yaml").exists():
            write_case(building, case, trials=trials or TRIALS[building], workers=workers)
        measured = case / "measured.csv"
        config, data, runs = prepare(building, measured, case / "parameters.yaml", WEATHER, workers=workers)
        result = calibrate(
            config,
            data,
            runs,
            lambda number, _, result: print(number, result["state"], result["stages"][-1:], flush=True),
        )
        write_files(result, runs, measured)
        outside = replace(runs, scratch="")  # the folder of the calibration's own runs is gone
        true = {days: outside.simulate(CASES[building][0], days) for days in config.periods}
        truth_error = objective(compare(data, true), scales_of(data, config.periods), config.adjustable)
        plain = result.plain() | {
            "building": building, "errors": _errors(result), "truth_error": truth_error,
        }  # fmt: skip
        for determined in result.parameters:
            parameter = config.parameters[determined.name]
            plain["parameters"][determined.name] |= {
                "truth": parameter.truth,
                "place": parameter.to_unit(determined.value),
                "places": [parameter.to_unit(determined.low), parameter.to_unit(determined.high)],
                "true_place": parameter.to_unit(float(parameter.truth or 0.0)),
            }
        with atomic_file(case / "summary.json") as temporary:
            temporary.write_text(json.dumps(plain, indent=1) + "\n", encoding="utf-8")


def _errors(result: Any) -> list[list[str]]:
    from zenostat.lab.calibration.report import error_rows

    return [list(row) for row in error_rows(result)[1]]


PARAMETER_COLUMNS = (
    "building", "parameter", "truth", "calibrated", "interval", "share of range", "truth in it", "off by", "verdict",
)  # fmt: skip
ERROR_COLUMNS = ("building", "column", "model", "CV(RMSE)", "NMBE", "monthly CV(RMSE)", "monthly NMBE", "within limits")


def parameter_rows(summaries: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return a row for each parameter."""
    return [
        (
            summary["building"], name, f"{each['truth']:g}", f"{each['value']:.3g}",
            f"{each['low']:.3g} to {each['high']:.3g}", f"{100 * each['share']:.0f} %",
            "yes" if each["low"] <= each["truth"] <= each["high"] else "**no**",
            f"{100 * abs(each['place'] - each['true_place']):.0f} %", each["verdict"],
        )
        for summary in summaries
        for name, each in summary["parameters"].items()
    ]  # fmt: skip


def main() -> None:
    """Calibrate, or show the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=["run", "table"])
    parser.add_argument("folder", type=Path)
    parser.add_argument("buildings", nargs="*", default=list(CASES))
    parser.add_argument("--trials", type=int, help="trials of each building")
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    if arguments.action == "run":
        run(arguments.folder, arguments.buildings, arguments.trials, arguments.workers)
    files = [arguments.folder / building / "summary.json" for building in CASES]
    summaries = [json.loads(file.read_text(encoding="utf-8")) for file in files if file.exists()]
    errors = [(summary["building"], *row) for summary in summaries for row in summary["errors"]]
    for columns, rows in ((PARAMETER_COLUMNS, parameter_rows(summaries)), (ERROR_COLUMNS, errors)):
        shown = Table(*columns)
        for row in rows:
            shown.add_row(*row)
        Console().print(shown)
    if arguments.action == "table":
        _write_page(parameter_rows(summaries), errors, summaries)
        figure = next(iter(sorted((arguments.folder / next(iter(CASES))).glob("curves-electricity*.svg"))))
        shutil.copyfile(figure, FIGURE)


def _write_page(
    parameters: Sequence[Sequence[str]], errors: Sequence[Sequence[str]], summaries: Sequence[Mapping[str, Any]]
) -> None:
    """Replace the tables in the page."""
    text = _markdown(PARAMETER_COLUMNS, parameters) + "\n" + _statement(summaries) + "\n\n"
    text += _markdown(ERROR_COLUMNS, errors)
    marked = re.compile(f"{BEGIN_MARK}.*{END_MARK}", re.DOTALL)
    page = marked.sub(lambda _: f"{BEGIN_MARK}\n\n{text}\n{END_MARK}", PAGE.read_text(encoding="utf-8"))
    PAGE.write_text(page, encoding="utf-8")


def _statement(summaries: Sequence[Mapping[str, Any]]) -> str:
    """Return the result in sentences."""
    each = [parameter for summary in summaries for parameter in summary["parameters"].values()]
    known = [parameter for parameter in each if parameter["determined"]]
    inside = sum(parameter["low"] <= parameter["truth"] <= parameter["high"] for parameter in each)
    off = max((abs(parameter["place"] - parameter["true_place"]) for parameter in known), default=0.0)
    outside = max(map(_outside, each))
    errors = ", ".join(
        f"{summary['fits']['before']['error']:.2f} to {summary['fits']['after']['error']:.3f} "
        f"({summary['truth_error']:.3f} with the truth) in {summary['building']}"
        for summary in summaries
    )
    beyond = f"; in the others it is at most {100 * outside:.1f} % of the range outside" if outside else ""
    return (
        f"The error falls from {errors}. Of {len(each)} parameters, {len(known)} are determined; the calibrated value "
        f"of each of these is within {100 * off:.0f} % of its range of the truth. The truth is in the interval of "
        f"{inside} of {len(each)}{beyond}."
    )


def _outside(parameter: Mapping[str, Any]) -> float:
    """Return how far the truth is outside the interval of a parameter, as share of its range."""
    low, high = map(float, parameter["places"])
    true = float(parameter["true_place"])
    return max(low - true, true - high, 0.0)


def _markdown(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return "".join(f"| {' | '.join(row)} |\n" for row in (columns, ("---",) * len(columns), *rows))


if __name__ == "__main__":
    main()
