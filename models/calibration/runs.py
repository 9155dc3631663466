"""Runs of a whole period by EnergyPlus alone, without a bus: hourly values of a model with edited parameters."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from zenostat.models import energyplus
from zenostat.models.building.model import Building, check_runnable, for_episode, read_building, with_edits, write
from zenostat.models.building.run_needs import lacks_design_days
from zenostat.models.building.source_lines import locator
from zenostat.models.calibration.model_edits import ModelParameter, edits_of
from zenostat.models.calibration.targets import Target
from zenostat.models.catalog import find_building
from zenostat.models.input_format.idf_writer import write_idf
from zenostat.models.input_format.layout import engine_layout
from zenostat.models.run_period import Period
from zenostat.models.weather import design_days
from zenostat.models.weather.header import check_complete, check_covers, read_header
from zenostat.models.weather.records import check_records
from zenostat.topics.arrays import Floats
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.errors import InvalidConfig, ModelError

_CLOCK = "2"
_HOURLY = "Hourly"
Days = tuple[date, date]
"""First and last day of a run, both included."""


@dataclass(frozen=True)
class ModelRuns:
    """A model, its weather and its parameters; small enough to be sent to other processes.

    Attributes:
        model: short name or path of the model.
        weather: path of the weather file.
        parameters: parameters of the model, applied in this order.
        targets: what is simulated.
        sizing: `model` for the model's own design days, or `weather` for those of the weather file.
        scratch: folder for the files of runs; empty: that of the system.
    """

    model: str
    weather: Path
    parameters: tuple[ModelParameter, ...]
    targets: tuple[Target, ...]
    sizing: str = "model"
    scratch: str = ""

    @property
    def building(self) -> Building:
        """The model as it is."""
        return _read(self.model)

    def with_values(self, values: Mapping[str, float]) -> Building:
        """Return the model with the parameters' values; a parameter without a value leaves it as it is.

        Raises:
            InvalidConfig: a number is outside EnergyPlus's limits; the text has object, field and limit.
        """
        building = self.building
        for parameter in self.parameters:
            if parameter.name in values:
                edits = edits_of(building.objects, parameter, float(values[parameter.name]))
                try:
                    building = with_edits(building, edits)
                except InvalidConfig as error:
                    raise InvalidConfig(f"parameters.{parameter.name} = {values[parameter.name]:g}: {error}") from None
        return building

    def check(self, periods: Sequence[Days], ends: Mapping[str, Sequence[float]]) -> None:
        """Check weather, periods, and the model at both ends of each parameter's range, before anything is simulated.

        Raises:
            InvalidConfig: the weather does not cover a period, or EnergyPlus rejects the model at an end of a range.
        """
        header = read_header(self.weather)
        check_complete(header, self.weather)
        check_records(header, self.weather)
        for days in periods:
            check_covers(header, Period(*days, self.building.steps_per_hour), self.weather.name)
        check_runnable(self.building)
        for name, values in ends.items():
            for value in values:
                try:
                    check_runnable(self.with_values({name: value}))
                except InvalidConfig as error:
                    text = str(error)
                    prefix = "" if text.startswith("parameters.") else f"parameters.{name} = {value:g}: "
                    raise InvalidConfig(f"{prefix}{text}") from None
        self._designed(self.building.objects)

    def simulate(self, values: Mapping[str, float], days: Days) -> Floats:
        """Return the hourly values of the targets, shape (hours, targets), from midnight of the first day on.

        Each is EnergyPlus's own hourly report: the sum of a meter, or the mean of a variable (the sum, if EnergyPlus
        sums it). Equal arguments give equal values to the bit, in any process.

        Raises:
            ModelError: EnergyPlus could not simulate the model.
        """
        building = self.with_values(values)
        period = Period(*days, building.steps_per_hour)
        objects = self._designed(for_episode(building, period))
        objects |= _reports(self.targets)
        (silent,) = objects["OutputControl:Files"].values()
        objects["OutputControl:Files"] = {"zenostat": silent | {"output_eso": "Yes", "output_mtr": "No"}}
        file = building.file or building.name
        with tempfile.TemporaryDirectory(prefix="zenostat-run-", dir=self.scratch or None) as folder:
            target = Path(folder) / "ended"
            energyplus.call(
                "simulate", write(objects, Path(folder)), self.weather, target, file=file, locate=locator(file)
            )
            return _read_hours(Path(folder) / "eplusout.eso", self.targets, period.steps // period.steps_per_hour)

    def _designed(self, objects: Mapping[str, Any]) -> dict[str, Any]:
        """Return the objects with the design days of the weather, if these are wanted or the model has none.

        Raises:
            InvalidConfig: neither has any.
        """
        if self.sizing == "model" and not lacks_design_days(objects):
            return dict(objects)
        site = design_days.site(self.weather, read_header(self.weather))
        if not site.design_days and lacks_design_days(objects):
            raise InvalidConfig(
                f"{self.model} requests sizing, but neither it nor {self.weather.name} has design days: add "
                "SizingPeriod:DesignDay objects, or a DDY file beside the weather file"
            )
        return design_days.apply(objects, site)

    def write_model(self, values: Mapping[str, float], path: Path, notes: Sequence[str] = ()) -> None:
        """Write the model with the parameters' values as an epJSON, or as an IDF with notes in its first lines.

        Raises:
            InvalidConfig: a text of the model cannot be written as an IDF.
        """
        building = self.with_values(values)
        if path.suffix.lower() == ".idf":
            lines = "".join(f"! {note}\n" for note in notes)
            text = lines + "\n" + write_idf(building.objects, engine_layout())
        else:
            text = json.dumps(building.objects, indent=1)
        with atomic_file(path) as temporary:
            temporary.write_text(text, encoding="utf-8")


@lru_cache(maxsize=4)
def _read(model: str) -> Building:
    return read_building(find_building(model))


def _reports(targets: Sequence[Target]) -> dict[str, Any]:
    """Return the output objects of the targets, each once."""
    variables = dict.fromkeys((target.variable, target.key) for target in targets if target.variable)
    meters = dict.fromkeys(name for target in targets for name in target.meters)
    objects: dict[str, Any] = {}
    if variables:
        objects["Output:Variable"] = {
            f"zenostat {number}": {"key_value": key or "*", "variable_name": name, "reporting_frequency": _HOURLY}
            for number, (name, key) in enumerate(variables, 1)
        }
    if meters:
        objects["Output:Meter"] = {
            f"zenostat {number}": {"key_name": name, "reporting_frequency": _HOURLY}
            for number, name in enumerate(meters, 1)
        }
    return objects


def _read_hours(path: Path, targets: Sequence[Target], hours: int) -> Floats:
    """Read the hourly reports of an ESO file: a dictionary of series, then blocks of a clock and `id,value` lines."""
    with path.open(encoding="utf-8", errors="replace") as file:
        ids = _series(file)
        wanted = [
            [ids[target.key.casefold(), target.variable.casefold()]]
            if target.variable
            else [ids["", name.casefold()] for name in target.meters]
            for target in targets
        ]
        columns = {identity: place for place, identity in enumerate(dict.fromkeys(i for each in wanted for i in each))}
        table = np.full((hours, len(columns)), np.nan)
        row = -1
        for line in file:
            identity, _, text = line.partition(",")
            if identity == _CLOCK:
                row += 1
            elif identity in columns:
                table[row, columns[identity]] = float(text.partition(",")[0])
    if row + 1 != hours or not np.isfinite(table).all():
        raise ModelError(f"EnergyPlus reported {row + 1} of {hours} hours, or values that are not finite")
    result = np.zeros((hours, len(targets)))
    for place, identities in enumerate(wanted):
        for identity in identities:
            result[:, place] += table[:, columns[identity]]
    return result


def _series(file: Iterator[str]) -> dict[tuple[str, str], str]:
    """Return the id of each hourly series by key and name, both case-folded; a meter's key is empty."""
    ids: dict[tuple[str, str], str] = {}
    for line in file:
        if line.startswith("End of Data Dictionary"):
            return ids
        entry, _, frequency = line.rstrip("\n").partition(" !")
        if frequency.startswith(_HOURLY):
            identity, _, rest = entry.split(",", 2)
            key, _, name = rest.rpartition(",")
            ids[key.casefold(), name.rsplit(" [", 1)[0].casefold()] = identity
    raise ModelError("EnergyPlus's report ends within its dictionary")
