"""The energy of the HVAC is what EnergyPlus's own table of end uses has, for each bundled building and fuel.

One run of each building is read twice: from the bus, and from the report that EnergyPlus writes at its end.
"""

import sqlite3
from collections import defaultdict
from contextlib import closing
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from support.builders import view
from support.nodes import WEATHER, NodeProgram

import zenostat
from zenostat.agent_sdk.rewards import LinearReward
from zenostat.metrics.energy_meters import FUELS
from zenostat.metrics.episode_metrics import EpisodeMetrics, MetricsAccumulator
from zenostat.metrics.roles import roles
from zenostat.models import catalog
from zenostat.models.building.model import read_building
from zenostat.topics.messages import Manifest

QUICK = ("ref-warehouse", "office-small")
"""A building whose pumps are of a plant loop, and one with electric water heaters."""

BUILDINGS = [
    pytest.param(entry.name, marks=() if entry.name in QUICK else (pytest.mark.slow, pytest.mark.timeout(1200)))
    for entry in catalog.bundled_buildings()
]
USES = {"Heating", "Cooling", "Fans", "Pumps", "Heat Rejection", "Humidification", "Heat Recovery"}
"""Rows of EnergyPlus's table."""

TABLE = {
    "Output:SQLite": {"SQLite": {"option_type": "SimpleAndTabular"}},
    "Output:Table:SummaryReports": {
        "reports": {"reports": [{"report_name": "AnnualBuildingUtilityPerformanceSummary"}]}
    },
    "OutputControl:Table:Style": {"style": {"column_separator": "HTML", "unit_conversion": "JtoKWH"}},
    "OutputControl:Files": {"files": {"output_sqlite": "Yes", "output_tabular": "Yes"}},
}
"""Output objects instead of the model's own: energies in kWh with two decimals."""

ROUNDING_KWH = 0.005 * len(USES)

KWH = 3.6e6

pytestmark = pytest.mark.process


def _edits(building: str) -> dict[str, dict[str, Any]]:
    own = read_building(catalog.find_building(building)).objects
    return {kind: dict.fromkeys(own.get(kind, {})) | objects for kind, objects in TABLE.items()}


def _episode(node: NodeProgram) -> tuple[Manifest, NDArray[np.float64]]:
    """Samples of an episode without commands, shape (steps + 1, points)."""
    with zenostat.connect(node.endpoint, affinity="off") as bus, bus.controller("office") as link:
        samples = []
        for sample in link:
            samples.append(sample.values)
            sample.send()
        return link.manifest, np.array(samples)


def _table_of_end_uses(folder: Path) -> dict[str, float]:
    """Energy of the HVAC's end uses in kWh by fuel (`NaturalGas`), where there is any."""
    query = (
        "SELECT ColumnName, Units, RowName, Value FROM TabularDataWithStrings "
        "WHERE ReportName = 'AnnualBuildingUtilityPerformanceSummary' AND TableName = 'End Uses'"
    )
    totals: dict[str, float] = defaultdict(float)
    (report,) = folder.rglob("eplusout.sql")
    with closing(sqlite3.connect(report)) as file:
        rows = file.execute(query).fetchall()
    assert {row[2] for row in rows} > USES
    for fuel, unit, use, value in rows:
        if use in USES and fuel != "Water":
            assert unit == "kWh"
            totals[fuel.replace(" ", "")] += float(value)
    return {fuel: total for fuel, total in totals.items() if total > 0.0}


def _summary(folder: Path) -> dict[tuple[str, str], float]:
    """Other numbers of EnergyPlus's summary by row and column, in kWh, m² and hours."""
    query = (
        "SELECT RowName, ColumnName, Value FROM TabularDataWithStrings "
        "WHERE ReportName = 'AnnualBuildingUtilityPerformanceSummary' AND TableName IN "
        "('Site and Source Energy', 'Comfort and Setpoint Not Met Summary')"
    )
    (report,) = folder.rglob("eplusout.sql")
    with closing(sqlite3.connect(report)) as file:
        return {(row, column): float(value) for row, column, value in file.execute(query) if value.strip()}


def _check_summary(result: EpisodeMetrics, summary: dict[tuple[str, str], float]) -> None:
    intensity = summary["Total Site Energy", "Energy Per Total Building Area"]
    assert result.site_kwh_m2 == pytest.approx(intensity, abs=0.006)
    for kind, hours in (("Heating", result.unmet_heating_h), ("Cooling", result.unmet_cooling_h)):
        own = summary[f"Time Setpoint Not Met During Occupied {kind}", "Facility"]
        assert hours == pytest.approx(own, abs=0.006), kind


def _metered(manifest: Manifest, samples: NDArray[np.float64]) -> dict[str, float]:
    """Energy of the meters `HVAC:…` in kWh by fuel, where there is any."""
    columns = {
        meter.meter.removeprefix("HVAC:"): len(manifest.sensors) + index
        for index, meter in enumerate(manifest.meters)
        if meter.meter.startswith("HVAC:")
    }
    totals = {fuel: float(samples[1:, column].sum()) / KWH for fuel, column in columns.items()}
    return {fuel: total for fuel, total in totals.items() if total > 0.0}


def _check_all_that_show_it(
    manifest: Manifest, samples: NDArray[np.float64], metered: dict[str, float]
) -> EpisodeMetrics:
    """Metrics, KPIs, the live view, reports and the linear reward have the same energy."""
    by_fuel = {fuel: metered.get(name, 0.0) for fuel, name in FUELS.items()}
    accumulator, block = MetricsAccumulator(manifest), samples[1:]
    begin = datetime.fromisoformat(manifest.begin)
    for step, values in enumerate(samples):
        at = begin + step * manifest.timestep
        accumulator.add(view(manifest, at, step=step, **dict(zip(manifest.names, values, strict=True))))
    result = accumulator.result()
    assert result.hvac_kwh == pytest.approx({fuel: by_fuel[fuel] for fuel in result.hvac_kwh})
    assert result.kpis["ener_tot"] == pytest.approx(sum(metered.values()) / (manifest.floor_area_m2 or 1.0))
    power = roles(manifest).hvac_power
    assert power.label == "HVAC"
    assert block[:, power.index].sum() * power.to_kw * manifest.step_s / 3600.0 == pytest.approx(by_fuel["electricity"])
    reward = LinearReward().bind(manifest)
    watts = [reward(values, begin).metrics["power_w"] for values in block]
    assert sum(watts) * manifest.step_s / KWH == pytest.approx(by_fuel["electricity"])
    return result


@pytest.mark.variants
@pytest.mark.parametrize("building", BUILDINGS)
def test_hvac_energy__equals_energyplus_end_use_table(building: str, folder: Path) -> None:
    settings: dict[str, Any] = {"begin": "05-02", "end": "05-02", "steps_per_hour": 4, "edits": _edits(building)}
    output = folder / "output"
    with NodeProgram(
        folder, building=building, weather=WEATHER, monitoring=True, output_dir=str(output), **settings
    ) as node:
        manifest, samples = _episode(node)
    table, metered = _table_of_end_uses(output), _metered(manifest, samples)
    assert metered.keys() == table.keys()
    assert metered == pytest.approx(table, abs=ROUNDING_KWH, rel=1e-5)
    result = _check_all_that_show_it(manifest, samples, metered)
    _check_summary(result, _summary(output))
