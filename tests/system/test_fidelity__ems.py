"""Output variables of EMS programs are what EnergyPlus reports for a timestep, whenever their programs run.

A program that runs after a report changes its variables for the next report; EnergyPlus's own convention is the
only one.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.data_packs import sinergym
from support.energyplus_reference import Case, check_equal, run_both
from support.nodes import WEATHER

CALLING_POINTS = {
    "begin": "BeginTimestepBeforePredictor",
    "inside": "InsideHVACSystemIterationLoop",
    "before_system": "EndOfSystemTimestepBeforeHVACReporting",
    "after_system": "EndOfSystemTimestepAfterHVACReporting",
    "before_zone": "EndOfZoneTimestepBeforeZoneReporting",
    "after_zone": "EndOfZoneTimestepAfterZoneReporting",
}


def _programs() -> dict[str, Any]:
    """EMS programs at each calling point that copy the HVAC's power to output variables of each frequency and kind."""
    edits: dict[str, Any] = {
        "EnergyManagementSystem:Sensor": {
            "power": {
                "output_variable_or_output_meter_index_key_name": "Whole Building",
                "output_variable_or_output_meter_name": "Facility Total HVAC Electricity Demand Rate",
            }
        }
    }
    variables = edits["EnergyManagementSystem:OutputVariable"] = {}
    globals_ = edits["EnergyManagementSystem:GlobalVariable"] = {}
    managers = edits["EnergyManagementSystem:ProgramCallingManager"] = {}
    programs = edits["EnergyManagementSystem:Program"] = {}
    for name, point in CALLING_POINTS.items():
        globals_[name] = {"variables": [{"erl_variable_name": f"v_{name}"}]}
        programs[f"p_{name}"] = {"lines": [{"program_line": f"SET v_{name} = power + 1"}]}
        managers[name] = {"energyplus_model_calling_point": point, "programs": [{"program_name": f"p_{name}"}]}
        for kind in ("Averaged", "Summed"):
            for frequency in ("SystemTimestep", "ZoneTimestep"):
                variables[f"{name} {kind} {frequency}"] = {
                    "ems_variable_name": f"v_{name}",
                    "type_of_data_in_variable": kind,
                    "update_frequency": frequency,
                }
    return edits


@pytest.mark.slow
def test_ems_variables__equal_the_report_at_each_calling_point(folder: Path) -> None:
    """The HVAC of this building divides most timesteps."""
    edits = _programs()
    case = Case("ref-small-office", WEATHER, "04-10", "04-10", 4, edits)
    sensors = {}
    for name in edits["EnergyManagementSystem:OutputVariable"]:
        identifier = name.replace(" ", "_").lower()
        sensors[f"{identifier}_instant"] = [name, "EMS", "instant"]
        sensors[identifier] = [name, "EMS", "sum" if "Summed" in name else "mean"]
    sensors["power"] = ["Facility Total HVAC Electricity Demand Rate", "Whole Building", "instant"]
    manifest, got, expected = run_both(case, folder, sensors=sensors, meters={}, actuators={})
    check_equal(manifest, got, expected)
    column = manifest.names.index
    lagging = got[:, column("after_system_averaged_systemtimestep_instant")]
    assert len(np.unique(lagging)) > 10
    current = got[:, column("before_system_averaged_systemtimestep_instant")]
    assert np.array_equal(current, got[:, column("power")] + 1)
    assert not np.array_equal(lagging, current)


@pytest.mark.parametrize(
    "building",
    ["2ZoneDataCenterHVAC_wEconomizer_DX", pytest.param("2ZoneDataCenterHVAC_wEconomizer_CW", marks=pytest.mark.slow)],
)
def test_power_utilization_effectiveness__equals_the_report(building: str, folder: Path) -> None:
    sinergym()
    case = Case(building, WEATHER, "07-01", "07-02", 4)
    name = "Power Utilization Effectiveness"
    sensors = {kind: [name, "EMS", kind] for kind in ("instant", "mean")}
    manifest, got, expected = run_both(case, folder, sensors=sensors, meters={}, actuators={})
    check_equal(manifest, got, expected)
    assert got.min() > 1.0  # by definition: all power over that of the IT equipment
    assert len(np.unique(got)) > 100
