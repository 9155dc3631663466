"""Each output variable and meter of a building over the bus and in EnergyPlus's own report.

`python -m support.every_variable [BUILDING ...]` with `tests` on the path simulates buildings, by default all, and
writes their rows of the table in docs/fidelity.md.
"""

from __future__ import annotations

import re
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from support.energyplus_reference import Alone, Case, run_both
from support.nodes import WEATHER
from zenostat.models.building.model import read_building
from zenostat.models.catalog import buildings, bundled_buildings, find_building, find_weather
from zenostat.models.points.discovery import PointCatalog, Variable, discover
from zenostat.topics.messages import Manifest

PAGE = Path(__file__).parents[2] / "docs" / "fidelity.md"
BEGIN, END = "<!-- made: fidelity -->", "<!-- end -->"
HEAD = (
    "| building | variables | of EMS | meters | points compared | equal to the bit | moved by other requests | "
    "largest move |\n|---|--:|--:|--:|--:|--:|--:|--:|"
)


@dataclass(frozen=True)
class Row:
    """The comparison of a building.

    Attributes:
        building: its name in the catalog.
        variables, programmed, meters: numbers of output variables, of those that EMS programs define, and of meters.
        points: number of points compared: the keys of each variable as mean or sum, and as state.
        equal: number of points that are equal to the bit in all timesteps.
        moved: number of points that are equal to the bit once EnergyPlus reports these points only.
        largest: largest relative difference of these before.
        differing: names of the points that differ all the same.
    """

    building: str
    variables: int
    programmed: int
    meters: int
    points: int
    equal: int
    moved: int
    largest: float
    differing: tuple[str, ...] = ()


def case_of(building: str) -> Case:
    """Return two days in July of a building, in timesteps of a quarter of an hour."""
    return Case(building, WEATHER, "07-06", "07-07", 4)


def names() -> list[str]:
    """Return the buildings of the wheel, then those of the data pack if it is installed."""
    entries = list(dict.fromkeys((*bundled_buildings(), *buildings())))
    return [entry.name for entry in entries if entry.pack in ("", "sinergym")]


def chosen(catalog: PointCatalog) -> dict[str, list[Variable]]:
    """Return the first, the middle and the last key of each variable."""
    keys: dict[str, list[Variable]] = defaultdict(list)
    for variable in catalog.by_variable.values():
        keys[variable.name.casefold()].append(variable)
    return {name: list(dict.fromkeys((group[0], group[len(group) // 2], group[-1]))) for name, group in keys.items()}


def compare(building: str, folder: Path) -> Row:
    """Run a building over the bus and by EnergyPlus alone, and compare each chosen point."""
    case = case_of(building)
    catalog = discover(read_building(find_building(building)), find_weather(WEATHER).path)
    variables = chosen(catalog)
    sensors: dict[str, list[str]] = {}
    for number, variable in enumerate(each for group in variables.values() for each in group):
        kind = "sum" if variable.summed else "mean"
        for aggregation in (kind, "instant"):
            sensors[f"v{number}_{aggregation}"] = [variable.name, variable.key, aggregation]
    meters = {f"m{number}": meter.name for number, meter in enumerate(catalog.meters)}
    manifest, got, expected = run_both(case, folder, sensors=sensors, meters=meters, actuators={})
    columns = [int(column) for column in np.flatnonzero((got != expected).any(axis=0))]
    differences = _relative(got[:, columns], expected[:, columns])
    moved, differing = _report_alone(case, manifest, got, columns, folder / "these")
    return Row(
        building,
        len(variables),
        sum(group[0].key.casefold() == "ems" for group in variables.values()),
        len(meters),
        len(manifest.names),
        len(manifest.names) - len(columns),
        len(moved),
        max((d for column, d in zip(columns, differences, strict=True) if column in moved), default=0.0),
        tuple(_describe(manifest, got, expected, column) for column in differing),
    )


def _report_alone(
    case: Case, manifest: Manifest, got: NDArray[np.float64], columns: Sequence[int], folder: Path
) -> tuple[list[int], list[int]]:
    """Let EnergyPlus report only some points; return those that are now equal to the bit, and the others.

    If not all are equal, each variable is reported in a run of its own.
    """
    if not len(columns):
        return [], []
    equal = _equal(case, manifest, got, columns, folder)
    rest = [column for column in columns if column not in equal]
    groups: dict[str, list[int]] = defaultdict(list)
    for column in rest:
        groups[_label(manifest, column).partition(" of ")[0]].append(column)
    for number, group in enumerate(groups.values()):
        equal += _equal(case, manifest, got, group, folder.with_name(f"{folder.name}-{number}"))
    return equal, [column for column in columns if column not in equal]


def _equal(case: Case, manifest: Manifest, got: NDArray[np.float64], columns: Iterable[int], folder: Path) -> list[int]:
    """Return those of some points that equal to the bit what EnergyPlus reports if it reports only these."""
    count = len(manifest.sensors)
    order = sorted(columns)
    sensors = [manifest.sensors[column] for column in order if column < count]
    meters = [manifest.meters[column - count] for column in order if column >= count]
    alone = Alone(case, sensors, meters, folder)
    try:
        expected = alone.values()
    finally:
        alone.close()
    return [c for i, c in enumerate(order) if np.array_equal(got[:, c], expected[:, i])]


def _label(manifest: Manifest, column: int) -> str:
    count = len(manifest.sensors)
    if column >= count:
        return manifest.meters[column - count].meter
    point = manifest.sensors[column]
    return f"{point.variable} of {point.key} ({point.aggregation})"


def _relative(got: NDArray[np.float64], expected: NDArray[np.float64]) -> NDArray[np.float64]:
    scale = np.maximum(np.abs(got).max(axis=0, initial=0.0), np.abs(expected).max(axis=0, initial=0.0))
    return np.abs(got - expected).max(axis=0, initial=0.0) / np.where(scale > 0, scale, 1.0)


def _describe(manifest: Manifest, got: NDArray[np.float64], expected: NDArray[np.float64], column: int) -> str:
    rows = np.flatnonzero(got[:, column] != expected[:, column])
    values = f"{got[rows[0], column]!r}, EnergyPlus writes {expected[rows[0], column]!r}"
    return f"{_label(manifest, column)}: {len(rows)} of {len(got)} differ; sample {rows[0] + 1} has {values}"


def page(text: str, rows: Sequence[Row]) -> str:
    """Return a page with these rows of its table made anew."""
    before, _, rest = text.partition(BEGIN)
    table, _, after = rest.partition(END)
    lines = {match[1]: match[0] for match in re.finditer(r"^\| `(.*?)` \|.*$", table, re.MULTILINE)}
    for row in rows:
        name, *numbers, largest, _ = astuple(row)
        cells = [f"`{name}`", *(f"{number:,}" for number in numbers), f"{largest:.0e}" if largest else ""]
        lines[row.building] = f"| {' | '.join(cells)} |"
    ordered = [lines[name] for name in names() if name in lines]
    return f"{before}{BEGIN}\n" + "\n".join([HEAD, *ordered]) + f"\n{END}{after}"


def main(wanted: Sequence[str]) -> None:
    """Compare buildings, print what differs, and write the rows of those that are equal."""
    for name in wanted or names():
        with tempfile.TemporaryDirectory(prefix="fidelity-") as folder:
            row = compare(name, Path(folder))
        sys.stdout.write(f"{row}\n")
        sys.stdout.flush()
        if not row.differing:
            PAGE.write_text(page(PAGE.read_text(encoding="utf-8"), [row]), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
