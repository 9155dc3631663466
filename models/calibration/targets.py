"""Points of a model to which measured columns are mapped: by their names on the bus or in EnergyPlus."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from zenostat.models.building.model import Building
from zenostat.models.points.discovery import MeterPoint, PointCatalog, discover
from zenostat.models.points.monitoring import with_monitoring
from zenostat.models.points.selection import Points, find_variable, select_points
from zenostat.topics.errors import InvalidConfig, UnknownName, did_you_mean

_FIELDS = ("point", "meter", "variable", "key")


@dataclass(frozen=True)
class Target:
    """A simulated series: an output variable, or the sum of meters.

    Attributes:
        name: name of the point.
        unit: unit of its values.
        summed: whether a value is the sum over an interval, as of a meter in J, rather than the mean.
        variable, key: of an output variable; empty for meters.
        meters: names of the meters that are added; empty for a variable.
    """

    name: str
    unit: str
    summed: bool
    variable: str = ""
    key: str = ""
    meters: tuple[str, ...] = ()


class TargetFinder:
    """Finds the points of a model by name.

    Args:
        building: the model.
        weather: any weather file, to start EnergyPlus for the list of points; the list is cached.

    Raises:
        InvalidConfig, ModelError: EnergyPlus cannot start the model.
    """

    def __init__(self, building: Building, weather: Path) -> None:
        self._catalog: PointCatalog = discover(building, weather)
        default = select_points(building, self._catalog, None, None, {})
        self._points: Points = with_monitoring(building, self._catalog, default)

    def find(self, place: str, spec: str | Mapping[str, Any]) -> Target:
        """Return the target of a column.

        Args:
            place: the column's place in the user's files, for errors.
            spec: a point's name on the bus, a meter (`Electricity:Facility`) or a variable as in the header of
                EnergyPlus's CSV (`CORE_ZN:Zone Mean Air Temperature`); or the fields `point`, `meter`, or `variable`
                and `key`.

        Raises:
            UnknownName: the model has no such point; the text lists similar ones.
            InvalidConfig: the fields do not name a point.
        """
        if isinstance(spec, str):
            return self._by_name(place, spec)
        named = {name: str(value) for name, value in spec.items() if name in _FIELDS and value is not None}
        if set(named) == {"point"}:
            return self._by_name(place, named["point"])
        if set(named) == {"meter"}:
            return _of_meter(named["meter"], self._meter(place, named["meter"]))
        if set(named) == {"variable", "key"}:
            return self._variable(place, named["variable"], named["key"])
        raise InvalidConfig(f"{place}: expected point, or meter, or variable and key; got {', '.join(named) or 'none'}")

    def _by_name(self, place: str, name: str) -> Target:
        for sensor in self._points.sensors:
            if sensor.name == name:
                return self._variable(place, sensor.variable, sensor.key, name)
        for meter, parts in zip(self._points.meters, self._points.meter_parts, strict=True):
            if meter.name == name:
                return Target(name, meter.unit, summed=True, meters=tuple(part.name for part in parts))
        folded = {meter.name.casefold(): meter for meter in self._catalog.meters}
        if name.casefold() in folded:
            return _of_meter(name, folded[name.casefold()])
        keys = {v.key.casefold() for v in self._catalog.variables}
        chunks = name.split(":")
        for number in range(len(chunks) - 1, 0, -1):  # a key may have colons as well
            key, variable = ":".join(chunks[:number]), ":".join(chunks[number:])
            if key.casefold() in keys:
                return self._variable(place, variable, key)
        names = [sensor.name for sensor in self._points.sensors] + [meter.name for meter in self._points.meters]
        hint = did_you_mean(name, [*names, *(meter.name for meter in self._catalog.meters)])
        raise UnknownName(
            f"{place}: the model has no point {name!r} (name it in `columns`, or set the column to false there); {hint}"
        )

    def _variable(self, place: str, variable: str, key: str, name: str = "") -> Target:
        try:
            match = find_variable(self._catalog, name or variable, variable, key)
        except UnknownName as error:
            raise UnknownName(f"{place}: {error}") from None
        return Target(name or f"{key}:{variable}", match.unit, match.summed, match.name, match.key)

    def _meter(self, place: str, name: str) -> MeterPoint:
        for meter in self._catalog.meters:
            if meter.name.casefold() == name.casefold():
                return meter
        hint = did_you_mean(name, (meter.name for meter in self._catalog.meters))
        raise UnknownName(f"{place}: the model has no meter {name!r}; {hint}")


def _of_meter(name: str, meter: MeterPoint) -> Target:
    return Target(name, meter.unit, summed=True, meters=tuple(part.name for part in meter.measured))
