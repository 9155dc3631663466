"""Surfaces as EnergyPlus itself computes them: the `HeatTransfer Surface` and `Shading Surface` lines of its EIO file.

`simulate` runs a model's geometry and constructions for a day, without HVAC and internal gains: two seconds at most.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from support.energyplus_alone import run_energyplus
from zenostat.models.catalog import find_weather
from zenostat.models.input_format.source_model import ModelObjects

WEATHER = find_weather("USA_CO_Denver").path

_GEOMETRY = (
    *("BuildingSurface", "Wall:", "Roof", "Ceiling:", "Floor:", "Fenestration", "Window", "Door", "GlazedDoor"),
    *("Shading", "Building", "Compliance", "GlobalGeometryRules", "Space", "Construction", "Material", "Schedule"),
    *("Site:", "SurfaceProperty", "Version"),
)
_DAY = {"begin_month": 1, "begin_day_of_month": 1, "end_month": 1, "end_day_of_month": 1}


@dataclass(frozen=True)
class EioSurface:
    """A line of the EIO file; `corners` are in world coordinates, from the upper left one."""

    name: str
    area_m2: float
    azimuth_deg: float
    tilt_deg: float
    corners: NDArray[np.float64]


def simulate(objects: ModelObjects, folder: Path, extra: ModelObjects | None = None) -> Path:
    """Run the geometry of a model with some more objects; return the folder of EnergyPlus's files."""
    kept = {kind: items for kind, items in objects.items() if kind.startswith(_GEOMETRY) or kind == "Zone"}
    kept |= {
        "Timestep": {"t": {"number_of_timesteps_per_hour": 4}},
        "RunPeriod": {"day": _DAY},
        "SimulationControl": {"c": {"run_simulation_for_sizing_periods": "No"}},
        "Output:Surfaces:List": {"l": {"report_type": "DetailsWithVertices"}},
    }
    folder.mkdir(parents=True)
    model = folder / "in.epJSON"
    model.write_text(json.dumps(kept | dict(extra or {})))
    assert run_energyplus(model, WEATHER, folder).returncode == 0, (folder / "eplusout.err").read_text()[-3000:]
    return folder


def surfaces(folder: Path) -> list[EioSurface]:
    """Return the surfaces of a run, without the mirror images of shading surfaces and without internal mass."""
    rows = [line.split(",") for line in (folder / "eplusout.eio").read_text(encoding="latin-1").splitlines()]
    kept = [row for row in rows if row[0] in ("HeatTransfer Surface", "Shading Surface")]
    return [_surface(row) for row in kept if row[2] != "Internal Mass" and not row[1].startswith("Mir-")]


def _surface(row: list[str]) -> EioSurface:
    """Read a row: its tenth column is the gross area, and it ends with the number of corners and their coordinates."""
    sizes = range(3, len(row) // 3)
    (size,) = [n for n in sizes if row[-3 * n - 1].strip() == str(n) and not row[-3 * n - 2].strip().isdigit()][:1]
    corners = np.array([float(text) for text in row[-3 * size :]]).reshape(-1, 3)
    return EioSurface(row[1], float(row[10]), float(row[12]), float(row[13]), corners)
