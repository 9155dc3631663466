"""Roles of a node's points in pictures and reports: which sensor is the temperature of which zone, and so on.

Points of EnergyPlus are recognized by output variable and key, meter, and actuator type. Points of other plants, and
setpoint schedules, are recognized by the words of their names.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

from zenostat.metrics.energy_meters import EnergySource, facility_sources, hvac_sources, meter_name
from zenostat.metrics.labels import label, words, zone_labels
from zenostat.topics.energyplus_names import (
    COOLING_SETPOINT,
    COOLING_SETPOINT_VARIABLE,
    END_USES,
    FACILITY_POWER,
    FUELS,
    HEATING_SETPOINT,
    HEATING_SETPOINT_VARIABLE,
    HVAC_POWER,
    OCCUPANTS,
    OUTDOOR_TEMPERATURE,
    THERMOSTAT,
    UNMET_COOLING,
    UNMET_HEATING,
    ZONE_HUMIDITY,
    ZONE_TEMPERATURES,
)
from zenostat.topics.messages import Actuator, Manifest
from zenostat.topics.units import power_kw, quantity

_IN_TOTALS = {name.casefold() for name in (HVAC_POWER, FACILITY_POWER, UNMET_HEATING, UNMET_COOLING)}
"""Output variables that pictures show in no plot of their own."""

_ROOM_WORDS = {
    "apartment", "bedroom", "building", "classroom", "core", "flat", "hall", "house", "indoor", "inside", "kitchen",
    "living", "office", "perimeter", "room", "space", "zone",
}  # fmt: skip
_FLUID_WORDS = {
    "boiler", "brine", "collector", "exchange", "flow", "loop", "pipe", "plate", "return", "storage", "supply", "tank",
    "water",
}  # fmt: skip
"""Words of temperatures that are not those of a room's air."""
_OUTDOOR_WORDS = {"ambient", "external", "outdoor", "outside"}
_SETPOINT_WORDS = {"setpoint", "setpoints", "setpt", "sp"}
_NO_PLACE = {
    "air", "all", "building", "heating", "cooling", "return", "rl", "sch", "schedule", "temperature", "thermostat",
    "zone", "zones",
} | _SETPOINT_WORDS  # fmt: skip
"""Words of a setpoint's name that do not tell its zone."""
_UNCONDITIONED = {"attic", "crawlspace", "plenum"}
"""Words of zones that a setpoint without a place does not serve."""

_END_USE_LABELS = {"humidifier": "humidification"}


@dataclass(frozen=True, slots=True)
class ZoneRoles:
    """Points of one zone, as indices into `Manifest.points` and, for actuators, `Manifest.actuators`.

    Attributes:
        key: EnergyPlus's name of the zone; of another plant, the part of the names that its points share.
        label: the name for readers, such as `Core bottom`.
        place: its place among the zones of the building, from 0.
        temperature, humidity, occupants: sensors; None where there is none.
        heating_setpoint, cooling_setpoint: sensors of the setpoints that the thermostat uses.
        heating_actuator, cooling_actuator: actuators of the setpoints; zones may share one, such as a schedule.
    """

    key: str
    label: str
    place: int
    temperature: int | None = None
    humidity: int | None = None
    occupants: int | None = None
    heating_setpoint: int | None = None
    cooling_setpoint: int | None = None
    heating_actuator: int | None = None
    cooling_actuator: int | None = None


@dataclass(frozen=True, slots=True)
class PowerSource:
    """A point that gives a power: `values[index] * to_kw`, the mean of the timestep in kW.

    Attributes:
        label: what it is the power of.
    """

    index: int
    to_kw: float
    label: str


@dataclass(frozen=True, slots=True)
class EndUse:
    """A meter of an end use or, with the label `facility` or `HVAC`, of all uses or those of the HVAC of a fuel.

    Attributes:
        label: `cooling`, `interior lights`.
        fuel: `electricity`, `natural gas`.
        index: index into `Manifest.points`.
        to_kw: factor from the meter's value to the mean power of the timestep in kW.
    """

    label: str
    fuel: str
    index: int
    to_kw: float


@dataclass(frozen=True, slots=True)
class PointRoles:
    """Roles of all points of a node.

    Attributes:
        zones: in the building's order.
        outdoor_temperature: index into `Manifest.points`; None where the node lacks it.
        facility_power, hvac_power: electric power of the whole building and of its HVAC; if the HVAC is not measured,
            of the groups of meters nearest to it, as the label tells.
        end_uses: meters of end uses, those of HVAC first.
        fuels: meters of the whole building, by fuel.
        hvac_fuels: meters of the HVAC by fuel, without electricity.
        others: the points without a role, as indices by unit, in manifest order.
        labels: names of `Manifest.points` for readers.
        actuator_labels: names of `Manifest.actuators` for readers.
    """

    zones: tuple[ZoneRoles, ...] = ()
    outdoor_temperature: int | None = None
    facility_power: PowerSource | None = None
    hvac_power: PowerSource | None = None
    end_uses: tuple[EndUse, ...] = ()
    fuels: tuple[EndUse, ...] = ()
    hvac_fuels: tuple[EndUse, ...] = ()
    others: dict[str, tuple[int, ...]] = field(default_factory=dict)
    labels: tuple[str, ...] = ()
    actuator_labels: tuple[str, ...] = ()

    @property
    def other_fuels(self) -> tuple[EndUse, ...]:
        """Meters of the whole building of fuels besides electricity, such as natural gas."""
        return tuple(meter for meter in self.fuels if meter.fuel != "electricity")


def roles(manifest: Manifest) -> PointRoles:
    """Return the roles of a node's points; points that are not recognized are in `others`."""
    zones = _zones(manifest)
    outdoor = _outdoor(manifest)
    facility, hvac = (
        _power(manifest, sources(manifest).get("electricity")) for sources in (facility_sources, hvac_sources)
    )
    end_uses, fuels, hvac_fuels = _meters(manifest)
    assigned = {index for zone in zones for index in _sensors(zone)}
    assigned |= {source.index for source in (facility, hvac) if source is not None}
    assigned |= set() if outdoor is None else {outdoor}
    assigned |= {meter.index for meter in (*end_uses, *fuels, *hvac_fuels)}
    assigned |= {i for i, sensor in enumerate(manifest.sensors) if sensor.variable.casefold() in _IN_TOTALS}
    others: dict[str, list[int]] = {}
    for index, point in enumerate(manifest.points):
        if index not in assigned:
            others.setdefault(point.unit, []).append(index)
    return PointRoles(
        zones=tuple(zones),
        outdoor_temperature=outdoor,
        facility_power=facility,
        hvac_power=hvac,
        end_uses=tuple(end_uses),
        fuels=tuple(fuels),
        hvac_fuels=tuple(hvac_fuels),
        others={unit: tuple(indices) for unit, indices in others.items()},
        labels=tuple(label(name) for name in manifest.names),
        actuator_labels=tuple(label(actuator.name) for actuator in manifest.actuators),
    )


def _sensors(zone: ZoneRoles) -> Iterator[int]:
    points = (zone.temperature, zone.humidity, zone.occupants, zone.heating_setpoint, zone.cooling_setpoint)
    return (index for index in points if index is not None)


# Zones


def _zones(manifest: Manifest) -> list[ZoneRoles]:
    """Return the zones with a temperature, in the building's order."""
    by_key = _energyplus_zones(manifest) or _named_zones(manifest)
    places = {name.casefold(): place for place, name in enumerate(manifest.zones or by_key)}
    names = {name.casefold(): name for name in manifest.zones}
    by_key = {names.get(key.casefold(), key): points for key, points in by_key.items()}
    by_key = dict(sorted(by_key.items(), key=lambda entry: places.get(entry[0].casefold(), len(places))))
    labels = dict(zip(by_key, zone_labels(by_key), strict=True))
    heating, cooling = (_SetpointActuators(manifest, kind) for kind in ("heating", "cooling"))
    return [
        ZoneRoles(
            key=key,
            label=labels[key],
            place=places.get(key.casefold(), len(places)),
            **points,
            heating_actuator=heating.of_zone(key),
            cooling_actuator=cooling.of_zone(key),
        )
        for key, points in by_key.items()
    ]


_VARIABLES = {
    "humidity": ZONE_HUMIDITY,
    "occupants": OCCUPANTS,
    "heating_setpoint": HEATING_SETPOINT_VARIABLE,
    "cooling_setpoint": COOLING_SETPOINT_VARIABLE,
}


def _energyplus_zones(manifest: Manifest) -> dict[str, dict[str, int]]:
    """Return the points of each zone by its name in EnergyPlus."""
    by_variable: dict[tuple[str, str], int] = {}
    names: dict[str, str] = {}
    for index, sensor in enumerate(manifest.sensors):
        variable, key = sensor.variable.casefold(), sensor.key.casefold()
        by_variable.setdefault((variable, key), index)
        if variable in ZONE_TEMPERATURES:
            names.setdefault(key, sensor.key)
    zones = {}
    for key, name in names.items():
        air = next(by_variable[v, key] for v in ZONE_TEMPERATURES if (v, key) in by_variable)
        others = {role: by_variable.get((variable.casefold(), key)) for role, variable in _VARIABLES.items()}
        zones[name] = {"temperature": air} | {role: index for role, index in others.items() if index is not None}
    return zones


_ENDINGS = {
    "temperature": (("air", "temperature"), ("temperature",)),
    "humidity": (("air", "humidity"), ("relative", "humidity"), ("humidity",)),
    "occupants": (("occupants",), ("people",), ("occupancy",)),
    "heating_setpoint": (("heating", "setpoint"),),
    "cooling_setpoint": (("cooling", "setpoint"),),
}
"""Last words of the names of a zone's points, of plants without EnergyPlus's variables."""


def _named_zones(manifest: Manifest) -> dict[str, dict[str, int]]:
    """Return the points of each zone by the first words of their names, which they share."""
    stems: dict[tuple[str, ...], dict[str, int]] = {}
    for index, sensor in enumerate(manifest.sensors):
        if sensor.variable:
            continue
        name = tuple(words(sensor.name))
        for role, ending in ((role, ending) for role, endings in _ENDINGS.items() for ending in endings):
            if name[-len(ending) :] == ending and (role != "temperature" or sensor.unit == "degC"):
                stems.setdefault(name[: -len(ending)], {}).setdefault(role, index)
                break
    by_actuator = {tuple(words(actuator.name))[:-2] for actuator in manifest.actuators if _is_setpoint(actuator)}
    has_setpoint = any(_SETPOINT_WORDS.intersection(words(actuator.name)) for actuator in manifest.actuators)
    return {
        "_".join(stem) or "zone": points
        for stem, points in stems.items()
        if "temperature" in points
        and not (_OUTDOOR_WORDS | _FLUID_WORDS).intersection(stem)
        and (len(points) > 1 or _ROOM_WORDS.intersection(stem) or stem in by_actuator or (not stem and has_setpoint))
    }


def _is_setpoint(actuator: Actuator) -> bool:
    name = words(actuator.name)
    return len(name) > 1 and name[-1] in _SETPOINT_WORDS


class _SetpointActuators:
    """The actuators of the heating or cooling setpoints of a node's zones.

    Args:
        manifest: manifest of the node.
        kind: `heating` or `cooling`.
    """

    def __init__(self, manifest: Manifest, kind: str) -> None:
        control = (HEATING_SETPOINT if kind == "heating" else COOLING_SETPOINT).casefold()
        self._thermostats: dict[str, int] = {}
        self._everywhere: int | None = None
        places: list[tuple[int, set[str]]] = []
        for index, actuator in enumerate(manifest.actuators):
            types = actuator.component_type.casefold(), actuator.control_type.casefold()
            if types == (THERMOSTAT.casefold(), control):
                self._thermostats.setdefault(actuator.key.casefold(), index)
            place = _place_of_setpoint(actuator, kind)
            if place:
                places.append((index, place))
            elif place is not None and self._everywhere is None:
                self._everywhere = index
        counts = Counter(word for _, place in places for word in place)
        self._by_rarest: dict[str, list[tuple[int, set[str]]]] = {}
        for index, place in places:
            self._by_rarest.setdefault(min(place, key=lambda word: (counts[word], word)), []).append((index, place))

    def of_zone(self, zone: str) -> int | None:
        """Return the actuator of a zone's setpoint: its thermostat's, else one that the words of a name assign to it.

        Of several, it is the first one with the most words of the zone's name, then one that names no place.
        """
        if (thermostat := self._thermostats.get(zone.casefold())) is not None:
            return thermostat
        zone_words = set(words(zone))
        named = [each for word in zone_words for each in self._by_rarest.get(word, ()) if each[1] <= zone_words]
        if named:
            return min(named, key=lambda each: (-len(each[1]), each[0]))[0]
        return None if zone_words & _UNCONDITIONED else self._everywhere


def _place_of_setpoint(actuator: Actuator, kind: str) -> set[str] | None:
    """Return the words that name the place of a schedule's or plant's setpoint (none: everywhere); else None."""
    if actuator.component_type and not actuator.component_type.casefold().startswith("schedule"):
        return None
    if actuator.unit not in ("degC", "1", ""):
        return None
    name = set(words(actuator.name))
    if kind not in name or not _SETPOINT_WORDS & name:
        return None
    return name - _NO_PLACE


# Weather and power


def _outdoor(manifest: Manifest) -> int | None:
    for index, sensor in enumerate(manifest.sensors):
        if sensor.variable.casefold() == OUTDOOR_TEMPERATURE.casefold():
            return index
    for index, sensor in enumerate(manifest.sensors):
        name = set(words(sensor.name))
        if not sensor.variable and sensor.unit == "degC" and "temperature" in name and name & _OUTDOOR_WORDS:
            return index
    return None


def _power(manifest: Manifest, source: EnergySource | None) -> PowerSource | None:
    if source is None:
        return None
    return PowerSource(source.index, power_kw(manifest.points[source.index].unit, manifest.step_s), source.label)


def _meters(manifest: Manifest) -> tuple[list[EndUse], list[EndUse], list[EndUse]]:
    """Return the meters of end uses, HVAC first, those of whole fuels, and those of the HVAC's fuels."""
    first = len(manifest.sensors)
    end_uses: list[tuple[tuple[int, int], EndUse]] = []
    fuels: list[EndUse] = []
    hvac_fuels: list[EndUse] = []
    seen: set[str] = set()
    for index, meter in enumerate(manifest.meters):
        name = meter_name(meter)
        if quantity(meter.unit) != "energy" or name in seen:
            continue
        seen.add(name)
        left, _, right = name.partition(":")
        to_kw = power_kw(meter.unit, manifest.step_s)
        if left in _USE_RANK and right in _FUEL_RANK:
            text, fuel = _USE_LABELS[left], _FUEL_LABELS[right]
            use = EndUse(text, fuel, first + index, to_kw)
            end_uses.append(((_USE_RANK[left], _FUEL_RANK[right]), use))
        elif left in _FUEL_RANK and right in ("facility", ""):
            fuel = _FUEL_LABELS[left]
            fuels.append(EndUse("facility", fuel, first + index, to_kw))
        elif left == "hvac" and right in _FUEL_RANK and right != "electricity":
            fuel = _FUEL_LABELS[right]
            hvac_fuels.append(EndUse("HVAC", fuel, first + index, to_kw))
    return [use for _, use in sorted(end_uses, key=lambda entry: entry[0])], fuels, hvac_fuels


_USE_RANK = {use.casefold(): rank for rank, use in enumerate(END_USES)}
_FUEL_RANK = {fuel.casefold(): rank for rank, fuel in enumerate(FUELS)}


def _plain(name: str) -> str:
    """Return `interior lights` for `InteriorLights`."""
    text = "".join(f" {letter.lower()}" if letter.isupper() else letter for letter in name).strip()
    return _END_USE_LABELS.get(text, text)


_USE_LABELS = {use.casefold(): _plain(use) for use in END_USES}
_FUEL_LABELS = {fuel.casefold(): _plain(fuel) for fuel in FUELS}
