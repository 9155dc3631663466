"""EnergyPlus alone: the prepared model run by the wheel's own API in a process, and what its ESO file says.

`eplusout.eso` holds a dictionary (`id,count,key,variable [unit] !frequency`) and then blocks: a line `2,…`
with the time at which an interval ended, and the lines `id,value` of what was reported for it. Variables
are asked for twice where both are wanted: `Timestep` is the mean or sum over the zone timestep, `Detailed`
(`!Each Call`) has an entry for each system timestep, of which the last in a zone timestep is the state at
its end. Numbers are written with all digits: `float(text)` is the value to the bit.
"""

import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import zenostat
from support.energyplus_alone import energyplus_command
from support.nodes import NodeProgram
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.models.building.edits import Edits
from zenostat.models.building.model import for_episode, read_building, with_edits, write
from zenostat.models.catalog import find_building, find_weather
from zenostat.models.weather import design_days
from zenostat.models.weather.header import read_header
from zenostat.topics.energyplus_names import HVAC_METERS
from zenostat.topics.messages import Aggregation, Manifest, Meter, Sensor

_PERIOD, _CLOCK = "1", "2"
_STEP, _EACH = "TimeStep", "Each Call"
_MINUTE_DIGITS = 0.02  # ends of system timesteps are written in minutes with two digits


@dataclass(frozen=True, slots=True)
class Case:
    """A building, its weather and its run period, as the settings of a node name them."""

    building: str
    weather: str
    begin: str
    end: str
    steps_per_hour: int
    edits: Edits = field(default_factory=dict, hash=False)

    def settings(self) -> dict[str, Any]:
        """Return the settings of a node."""
        return {name: getattr(self, name) for name in self.__slots__}


Runs = tuple[Manifest, NDArray[np.float64], NDArray[np.float64]]
"""A manifest; the values of each timestep over the bus, shape (steps, points); those of EnergyPlus alone."""


def run_both(case: Case, folder: Path, **points: Any) -> Runs:
    """Run a case over the bus without commands, and by EnergyPlus alone.

    Args:
        case: what is simulated.
        folder: for the files of both.
        points: settings of the node: `sensors`, `meters`, `actuators`.
    """
    with NodeProgram(folder, **case.settings(), **points) as node:
        with zenostat.connect(node.endpoint, affinity=Affinity.OFF) as bus:
            manifest = bus.manifest("office")
        alone = Alone(case, manifest.sensors, manifest.meters, folder / "alone")
        try:
            manifest, samples = _over_the_bus(node)
            expected = alone.values()
        finally:
            alone.close()
    assert samples.shape == (manifest.steps + 1, len(manifest.names))
    assert expected.shape == (manifest.steps, len(manifest.names))
    return manifest, samples[1:], expected


def _over_the_bus(node: NodeProgram) -> tuple[Manifest, NDArray[np.float64]]:
    """All samples of an episode that nobody commands; shape (steps + 1, points)."""
    with zenostat.connect(node.endpoint, affinity=Affinity.OFF) as bus, bus.controller("office") as link:
        samples: list[NDArray[np.float64]] = []
        for sample in link:
            assert sample.step == len(samples)
            assert set(sample.value_source.values()) <= {""}
            samples.append(sample.values)
            sample.send()
        assert sample.truncated
        return link.manifest, np.array(samples)


def check_equal(manifest: Manifest, got: NDArray[np.float64], expected: NDArray[np.float64]) -> None:
    """Equal to the bit, or a message with the first difference of each point."""
    differences = []
    for column, name in enumerate(manifest.names):
        rows = np.flatnonzero(got[:, column] != expected[:, column])
        if rows.size:
            first = rows[0]
            values = f"{got[first, column]!r}, EnergyPlus writes {expected[first, column]!r}"
            differences.append(f"{name}: {rows.size} of {len(got)} differ; sample {first + 1} has {values}")
    assert not differences, "\n".join(differences)


class Alone:
    """A run of EnergyPlus alone that reports `sensors` and `meters`; started at once, read with `values`."""

    def __init__(self, case: Case, sensors: Sequence[Sensor], meters: Sequence[Meter], folder: Path) -> None:
        self.sensors, self.folder = sensors, folder
        self.meters = [HVAC_METERS.get(meter.meter, (meter.meter,)) for meter in meters]
        model = with_edits(read_building(find_building(case.building)), case.edits)
        period = model.period(case.begin, case.end, case.steps_per_hour)
        self.steps, self.steps_per_hour = period.steps, period.steps_per_hour
        weather = find_weather(case.weather).path
        objects = design_days.apply(for_episode(model, period), design_days.site(weather, read_header(weather)))
        objects["Output:Variable"] = {
            f"{s.name} {frequency}": {
                "key_value": s.key or "*",
                "variable_name": s.variable,
                "reporting_frequency": frequency,
            }
            for s in sensors
            for frequency in ("Timestep", "Detailed")
            if frequency == ("Detailed" if s.aggregation is Aggregation.INSTANT else "Timestep")
        }
        names = dict.fromkeys(name for parts in self.meters for name in parts)
        objects["Output:Meter"] = {name: {"key_name": name, "reporting_frequency": "Timestep"} for name in names}
        (silent,) = objects["OutputControl:Files"].values()
        objects["OutputControl:Files"] = {"eso": silent | {"output_eso": "Yes"}}
        folder.mkdir(parents=True, exist_ok=True)
        weather = find_weather(case.weather).path
        command = energyplus_command(write(objects, folder), weather, folder)
        self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL)

    def close(self) -> None:
        """Ends the process if it still runs."""
        self._process.kill()
        self._process.wait()

    def values(self) -> NDArray[np.float64]:
        """Sensors, then meters, as EnergyPlus wrote them; shape (steps, points)."""
        code = self._process.wait()
        if code:
            raise AssertionError(f"EnergyPlus ended with {code}: {(self.folder / 'eplusout.err').read_text()[-2000:]}")
        with (self.folder / "eplusout.eso").open() as file:
            ids = _dictionary(file)
            columns = {identity: column for column, identity in enumerate(dict.fromkeys(ids.values()))}
            table = _table(file, columns, (self.steps, self.steps_per_hour), len(columns))
        points = np.stack(
            [
                reduce(np.add, [table[:, columns[i]] for i in wanted]) if wanted else np.zeros(len(table))
                for wanted in self._wanted(ids)
            ],
            axis=1,
        )
        assert not np.isnan(points).any(), "the ESO file has no value for some point at some timestep"
        return points

    def _wanted(self, ids: dict[tuple[str, str, str], str]) -> Iterator[list[str]]:
        """For each point, the ESO ids of what adds up to it; a sum leaves out meters that the model does not have."""
        for sensor in self.sensors:
            frequency = _EACH if sensor.aggregation is Aggregation.INSTANT else _STEP
            yield [ids[sensor.key.casefold(), sensor.variable.casefold(), frequency]]
        for parts in self.meters:
            keys = [("", name.casefold(), _STEP) for name in parts]
            yield [ids[key] for key in keys if key in ids]


def _dictionary(file: Iterator[str]) -> dict[tuple[str, str, str], str]:
    """(key, name, frequency) to id; reads `file` up to the end of its dictionary. A meter's key is empty."""
    identities: dict[tuple[str, str, str], str] = {}
    for line in file:
        if line.startswith("End of Data Dictionary"):
            return identities
        entry, _, frequency = line.rstrip("\n").partition(" !")
        if not frequency:
            continue
        identity, _, rest = entry.split(",", 2)
        key, _, name = rest.rpartition(",")
        identities[key.casefold(), name.rsplit(" [", 1)[0].casefold(), frequency.split(" [")[0].strip()] = identity
    raise AssertionError("the ESO file ends within its dictionary")


def _table(file: Iterator[str], columns: dict[str, int], period: tuple[int, int], width: int) -> NDArray[np.float64]:
    """The last period in the rest of an ESO file; later entries of a timestep replace earlier ones of it."""
    steps, steps_per_hour = period
    table = np.full((steps, width), np.nan)
    present: dict[int, str] = {}
    row, days, day = -1, -1, ("", "")
    for line in file:
        identity, _, text = line.partition(",")
        column = columns.get(identity)
        if column is not None:
            present[column] = text
        elif identity == _PERIOD:  # design days come before the run period
            table[:] = np.nan
            present.clear()
            row, days, day = -1, -1, ("", "")
        elif identity == _CLOCK:
            _, month, day_of_month, _, hour, _, minute, _ = text.split(",")
            if (month, day_of_month) != day:
                days, day = days + 1, (month, day_of_month)
            minutes = (int(hour) - 1) * 60 + float(minute)
            step_of_day = int(np.ceil((minutes - _MINUTE_DIGITS) * steps_per_hour / 60))
            now = days * 24 * steps_per_hour + step_of_day - 1
            if now != row:
                _put(table, row, present)
                row = now
    _put(table, row, present)
    return table


def _put(table: NDArray[np.float64], row: int, present: dict[int, str]) -> None:
    for column, text in present.items():
        table[row, column] = float(text)
    present.clear()
