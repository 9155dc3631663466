"""EnergyPlus with no building: only the outdoor air of a run period or of design days, which takes 0.2 s."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from support.energyplus_alone import run_energyplus

STEPS_PER_HOUR = 4
DRY_BULB = "Site Outdoor Air Drybulb Temperature"
_PLACE = "1"
_CLOCK = "2"


@dataclass(frozen=True)
class Outdoors:
    """Result of a run of EnergyPlus: its exit code, its messages, and the days and values of each environment."""

    code: int
    errors: str
    days: list[list[tuple[int, int, str]]]  # by environment: month, day, weekday
    values: list[NDArray[np.float64]]  # by environment: (timesteps, variables)


def run(folder: Path, weather: Path, begin: date | None, end: date | None, **more: Any) -> Outdoors:
    """The run period `begin` to `end`, or the design days in `more` without one; `variables` are reported."""
    variables: Sequence[str] = more.pop("variables", [DRY_BULB])
    run_period: dict[str, Any] = more.pop("run_period", {})
    sizing = "No" if begin else "Yes"
    objects: dict[str, Any] = {
        "Version": {"v": {"version_identifier": "25.2"}},
        "Building": {"b": {}},
        "GlobalGeometryRules": {
            "g": {
                "starting_vertex_position": "UpperLeftCorner",
                "vertex_entry_direction": "Counterclockwise",
                "coordinate_system": "Relative",
            }
        },
        "Timestep": {"t": {"number_of_timesteps_per_hour": STEPS_PER_HOUR}},
        "SimulationControl": {
            "s": {
                "run_simulation_for_sizing_periods": sizing,
                "run_simulation_for_weather_file_run_periods": "Yes" if begin else "No",
            }
        },
        "Output:Variable": {
            v: {"key_value": "*", "variable_name": v, "reporting_frequency": "Timestep"} for v in variables
        },
        **more,
    }
    if begin and end:
        ends = (("begin", begin), ("end", end))
        dates = [
            {f"{side}_year": day.year, f"{side}_month": day.month, f"{side}_day_of_month": day.day}
            for side, day in ends
        ]
        objects["RunPeriod"] = {"r": dates[0] | dates[1] | run_period}
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "in.epJSON").write_text(json.dumps(objects))
    done = run_energyplus(folder / "in.epJSON", weather, folder)
    days, values = _read(folder / "eplusout.eso", variables)
    return Outdoors(done.returncode, (folder / "eplusout.err").read_text(), days, values)


def _read(eso: Path, variables: Sequence[str]) -> tuple[list[list[tuple[int, int, str]]], list[NDArray[np.float64]]]:
    columns: dict[str, int] = {}
    days: list[list[tuple[int, int, str]]] = []
    rows: list[list[list[float]]] = []
    lines = iter(eso.read_text().splitlines())
    for line in lines:
        if line.startswith("End of Data Dictionary"):
            break
        for column, name in enumerate(variables):
            if f",{name} [" in line:
                columns[line.split(",", 1)[0]] = column
    for line in lines:
        parts = line.split(",")
        if parts[0] == _PLACE:
            days.append([])
            rows.append([])
        elif parts[0] == _CLOCK:
            day = (int(parts[2]), int(parts[3]), parts[8].strip())
            if not days[-1] or days[-1][-1] != day:
                days[-1].append(day)
            rows[-1].append([float("nan")] * len(variables))
        elif parts[0] in columns:
            rows[-1][-1][columns[parts[0]]] = float(parts[1])
    return days, [np.array(block) for block in rows]
