"""A model of one zone in a box, for rules that are tried with EnergyPlus."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from support.energyplus_alone import run_energyplus
from zenostat.models.catalog import bundled_weathers
from zenostat.models.input_format.source_model import ObjectsOfType

_WALLS = {
    "Roof": ("Roof", ((0, 5, 3), (0, 0, 3), (5, 0, 3), (5, 5, 3))),
    "South": ("Wall", ((0, 0, 3), (0, 0, 0), (5, 0, 0), (5, 0, 3))),
    "East": ("Wall", ((5, 0, 3), (5, 0, 0), (5, 5, 0), (5, 5, 3))),
    "North": ("Wall", ((5, 5, 3), (5, 5, 0), (0, 5, 0), (0, 5, 3))),
    "West": ("Wall", ((0, 5, 3), (0, 5, 0), (0, 0, 0), (0, 0, 3))),
}
_FLOOR = ((0, 0, 0), (0, 5, 0), (5, 5, 0), (5, 0, 0))


def _surface(kind: str, corners: tuple[tuple[int, int, int], ...], boundary: str) -> dict[str, Any]:
    axes = ("vertex_x_coordinate", "vertex_y_coordinate", "vertex_z_coordinate")
    outdoors = boundary == "Outdoors"
    return {
        "surface_type": kind,
        "construction_name": "Heavy",
        "zone_name": "Box",
        "outside_boundary_condition": boundary,
        "sun_exposure": "SunExposed" if outdoors else "NoSun",
        "wind_exposure": "WindExposed" if outdoors else "NoWind",
        "vertices": [dict(zip(axes, corner, strict=True)) for corner in corners],
    }


def box_model(schedule: str = "Always") -> dict[str, ObjectsOfType]:
    """Return the objects of a box of 25 m2 with lights, without HVAC, for a day; the lights follow `schedule`."""
    surfaces = {name: _surface(kind, corners, "Outdoors") for name, (kind, corners) in _WALLS.items()}
    return {
        "Version": {"Version 1": {"version_identifier": "25.2"}},
        "Building": {"Box": {}},
        "Timestep": {"Timestep 1": {"number_of_timesteps_per_hour": 4}},
        "GlobalGeometryRules": {
            "GlobalGeometryRules 1": {
                "starting_vertex_position": "UpperLeftCorner",
                "vertex_entry_direction": "Counterclockwise",
                "coordinate_system": "World",
            }
        },
        "SimulationControl": {
            "SimulationControl 1": {
                "run_simulation_for_sizing_periods": "No",
                "run_simulation_for_weather_file_run_periods": "Yes",
            }
        },
        "RunPeriod": {"Day": {"begin_month": 1, "begin_day_of_month": 1, "end_month": 1, "end_day_of_month": 1}},
        "Material": {
            "Concrete": {
                "roughness": "Rough",
                "thickness": 0.2,
                "conductivity": 1.7,
                "density": 2300.0,
                "specific_heat": 900.0,
            }
        },
        "Construction": {"Heavy": {"outside_layer": "Concrete"}},
        "Zone": {"Box": {}},
        "BuildingSurface:Detailed": {"Floor": _surface("Floor", _FLOOR, "Adiabatic"), **surfaces},
        "ScheduleTypeLimits": {"Any number": {}},
        "Schedule:Constant": {"Always": {"schedule_type_limits_name": "Any number", "hourly_value": 1.0}},
        "Lights": {
            "Lights": {
                "zone_or_zonelist_or_space_or_spacelist_name": "Box",
                "schedule_name": schedule,
                "design_level_calculation_method": "LightingLevel",
                "lighting_level": 100.0,
            }
        },
    }


def exit_code(objects: dict[str, ObjectsOfType], folder: Path) -> int:
    """Return the exit code of EnergyPlus for a model."""
    folder.mkdir()
    path = folder / "in.epJSON"
    path.write_text(json.dumps(objects))
    return run_energyplus(path, bundled_weathers()[0].path, folder).returncode
