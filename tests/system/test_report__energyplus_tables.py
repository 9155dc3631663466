"""The months, end uses and the peak of a report are those of EnergyPlus's own tables of the same run."""

import sqlite3
from contextlib import closing
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from support.nodes import WEATHER, node_on_bus

from zenostat.metrics.trajectory import Trajectory
from zenostat.metrics.trajectory_recorder import TrajectoryRecorder
from zenostat.models import catalog
from zenostat.models.building.model import read_building
from zenostat.views.report.figures import months
from zenostat.views.report.figures.base import Curve
from zenostat.views.report.quantities import Quantities

BUILDING = "ref-small-office"
"""It uses electricity and gas."""
PERIOD = {"begin": "03-20", "end": "05-10"}
"""More than 45 days, so that the report has months, two of them cut."""
REPORTS = (
    "DemandEndUseComponentsSummary",
    *(f"EndUseEnergyConsumption{fuel}Monthly" for fuel in ("Electricity", "NaturalGas")),
)
TABLE: dict[str, dict[str, Any]] = {
    "Output:SQLite": {"SQLite": {"option_type": "SimpleAndTabular"}},
    "Output:Table:SummaryReports": {"reports": {"reports": [{"report_name": name} for name in REPORTS]}},
    "OutputControl:Table:Style": {"style": {"column_separator": "HTML", "unit_conversion": "JtoKWH"}},
    "OutputControl:Files": {"files": {"output_sqlite": "Yes", "output_tabular": "Yes"}},
}
ROUNDING_KWH = 0.006

pytestmark = [pytest.mark.process, pytest.mark.slow]


@pytest.fixture(scope="module")
def episode(tmp_path_factory: pytest.TempPathFactory) -> tuple[Trajectory, Path]:
    """An episode without commands, and the folder of EnergyPlus's output."""
    folder = tmp_path_factory.mktemp("tables")
    own = read_building(catalog.find_building(BUILDING)).objects
    edits = {kind: dict.fromkeys(own.get(kind, {})) | objects for kind, objects in TABLE.items()}
    settings = {"building": BUILDING, "weather": WEATHER, "steps_per_hour": 4, "edits": edits, **PERIOD}
    with (
        node_on_bus(folder, monitoring=True, output_dir=str(folder / "output"), **settings) as (_, bus),
        bus.controller("office") as link,
    ):
        recorder = TrajectoryRecorder(link.manifest)
        for sample in link:
            recorder.add(sample)
            sample.send()
        return recorder.trajectory({}), folder / "output"


def rows(folder: Path, report: str) -> list[tuple[str, str, str]]:
    """Row, column with unit, and value of a table."""
    query = "SELECT RowName, ColumnName, Units, Value FROM TabularDataWithStrings WHERE ReportName = ?"
    (path,) = folder.rglob("eplusout.sql")
    with closing(sqlite3.connect(path)) as file:
        return [
            (row, f"{column} [{unit}]", value.strip()) for row, column, unit, value in file.execute(query, (report,))
        ]


def test_energy_of_each_month_and_end_use__equals_energyplus(episode: tuple[Trajectory, Path]) -> None:
    trajectory, folder = episode
    quantities = Quantities(trajectory)
    figure = months.end_uses_by_period([Curve("own", 0, quantities)])
    assert list(figure.data["month"]) == ["2017-03", "2017-04", "2017-05"]
    meters = {(use.label, use.fuel): use.index - len(trajectory.manifest.sensors) for use in quantities.roles.end_uses}
    shown = {
        trajectory.manifest.meters[meters[use.label, use.fuel]].meter.upper(): column
        for use, column in zip(quantities.end_uses, list(figure.data.values())[1:], strict=True)
    }
    tables = {}
    for report in REPORTS[1:]:
        for month, column, value in rows(folder, report):
            meter, _, unit = column.partition(" ")
            if month in ("March", "April", "May") and float(value) > 0.0:
                assert unit == "[kWh]"
                tables[meter, month] = float(value)
    assert len(tables) >= 3 * 7
    assert {meter for meter, _ in tables} <= set(shown)  # the table rounds a pump's 2 Wh to nothing
    assert {meter.partition(":")[2] for meter in shown} == {"ELECTRICITY", "NATURALGAS"}
    for meter, column in shown.items():
        own = [tables.get((meter, month), 0.0) for month in ("March", "April", "May")]
        assert list(column) == pytest.approx(own, abs=ROUNDING_KWH), meter


def test_peaks_and_their_times__equal_energyplus(episode: tuple[Trajectory, Path]) -> None:
    trajectory, folder = episode
    quantities = Quantities(trajectory)
    peaks = {fuel: int(quantities.energy_kwh[fuel].argmax()) for fuel in ("electricity", "natural gas")}
    begins = {fuel: trajectory.begin + place * trajectory.manifest.timestep for fuel, place in peaks.items()}
    assert quantities.peak_time == begins["electricity"] + trajectory.manifest.timestep
    for fuel, column in (("electricity", "Electricity [W]"), ("natural gas", "Natural Gas [W]")):
        table = {row: value for row, name, value in rows(folder, REPORTS[0]) if name == column}
        assert label_in_table(begins[fuel], trajectory.manifest.timestep) == table["Time of Peak"]
        watts = quantities.energy_kwh[fuel][peaks[fuel]] / quantities.step_h * 1e3
        assert watts == pytest.approx(float(table["Total End Uses"]), abs=0.011)


def label_in_table(begin: datetime, timestep: timedelta) -> str:
    """Return the time of a peak as EnergyPlus's tables have it.

    They add the length of a timestep to its end, and count the minutes of the sum from the full hour of the end, but
    the hours from the begin: 15:45 to 16:00 is "15:15", and 05:00 to 05:15 is "05:30".
    """
    minutes = (begin + timestep).minute + round(timestep / timedelta(minutes=1))
    return f"{begin:%d-%b-%H}:{minutes:02}".upper()
