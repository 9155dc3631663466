"""Variables of a run of EnergyPlus alone, read through its API at the end of each zone timestep."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zenostat.models.building.model import Building, for_episode, write
from zenostat.models.catalog import find_weather

_RUN = """
import json, sys
from pyenergyplus.api import EnergyPlusAPI
model, weather, folder, points = sys.argv[1:]
api, rows = EnergyPlusAPI(), []
state, points = api.state_manager.new_state(), json.loads(points)
api.runtime.set_console_output_status(state, False)
for variable, key in points:
    api.exchange.request_variable(state, variable, key)
def read(running):
    if not api.exchange.warmup_flag(running) and api.exchange.kind_of_sim(running) == 3:
        handles = [api.exchange.get_variable_handle(running, *point) for point in points]
        assert min(handles) >= 0, points[handles.index(-1)]
        rows.append([api.exchange.get_variable_value(running, handle) for handle in handles])
api.runtime.callback_end_zone_timestep_after_zone_reporting(state, read)
code = api.runtime.run_energyplus(state, ["-w", weather, "-d", folder, model])
json.dump(rows, open(folder + "/rows.json", "w"))
sys.exit(code)
"""


def run(
    building: Building,
    points: Sequence[tuple[str, str]],
    folder: Path,
    *,
    begin: str,
    end: str,
    weather: str = "USA_IL_Chicago",
) -> NDArray[np.float64]:
    """Return the values of output variables, named with their keys; shape (steps, points)."""
    folder.mkdir(parents=True)
    model = write(for_episode(building, building.period(begin, end, None)), folder)
    command = [sys.executable, "-P", "-c", _RUN, model, find_weather(weather).path, folder, json.dumps(points)]
    code = subprocess.run([*map(str, command)], stdin=subprocess.DEVNULL).returncode
    report = folder / "eplusout.err"
    assert code == 0, report.read_text()[-3000:] if report.exists() else f"exit code {code}"
    return np.array(json.loads((folder / "rows.json").read_text()))
