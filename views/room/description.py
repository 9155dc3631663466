"""A node's description for the page: its points with roles and units, its zones and storeys."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from zenostat.metrics.comfort import Comfort
from zenostat.metrics.labels import point_unit
from zenostat.metrics.reward_comfort import display_comfort
from zenostat.metrics.roles import PointRoles, PowerSource, roles
from zenostat.topics.messages import Actuator, Geometry, Manifest, Meter, Sensor, Systems
from zenostat.topics.points import PointIndex
from zenostat.topics.units import power_kw, quantity
from zenostat.views.display.colors import hex_color, zone_color
from zenostat.views.room.schematic import schematic
from zenostat.views.room.storeys import storeys

NO_SETPOINT = -999.0
"""EnergyPlus's setpoint of a node that has none (`SensedNodeFlagValue` in its source)."""

MAX_FUTURE_STEPS = 7 * 24 * 6 + 1
"""Largest number of timesteps that *What if* simulates: a week of ten minutes each, and one more."""


@dataclass(frozen=True, eq=False)
class NodeDescription:
    """Facts derived once from the manifest of an instance of a node.

    Attributes:
        manifest: the node's.
        roles: roles of its points.
        comfort: comfort bands of the zones; None without zone temperatures.
        content: for the page, as JSON values.
    """

    manifest: Manifest
    roles: PointRoles
    comfort: Comfort | None
    content: dict[str, Any]


def longest_future_h(step_s: float) -> float:
    """Return the longest time that *What if* simulates in timesteps of a length, in hours."""
    return MAX_FUTURE_STEPS * step_s / 3600.0


def describe(manifest: Manifest, geometry: Geometry | None, systems: Systems | None = None) -> NodeDescription:
    """Return the description of a node; without a geometry it has no storeys, without systems no schematic."""
    point_roles = roles(manifest)
    comfort = display_comfort(manifest)
    zones = [zone for zone in point_roles.zones if zone.temperature is not None]
    places = {zone.key.casefold(): number for number, zone in enumerate(zones)}
    content = {
        "node": manifest.node,
        "instance": manifest.instance,
        "branch_of": manifest.branch_of,
        "replay": manifest.replay,
        "building": manifest.building,
        "weather": manifest.weather,
        "location": manifest.location,
        "begin": manifest.begin,
        "end": manifest.end,
        "step_s": manifest.step_s,
        "what_if_hours": longest_future_h(manifest.step_s),
        "steps": manifest.steps,
        "slots": manifest.slots,
        "history_samples": manifest.history_samples,
        "scenario": manifest.task.scenario,
        "energyplus": manifest.versions.energyplus,
        "warnings": list(manifest.warnings),
        "band": comfort.source if comfort is not None else "",
        "points": _points(manifest, point_roles, places),
        "zones": [
            {
                "name": zone.label,
                "key": zone.key,
                "color": hex_color(zone_color(zone.place)),
                "temperature": zone.temperature,
                "humidity": zone.humidity,
                "occupants": zone.occupants,
                "heating_setpoint": zone.heating_setpoint,
                "cooling_setpoint": zone.cooling_setpoint,
                "heating_actuator": _actuator_place(manifest, zone.heating_actuator),
                "cooling_actuator": _actuator_place(manifest, zone.cooling_actuator),
            }
            for zone in zones
        ],
        "outdoor": point_roles.outdoor_temperature,
        "outdoor_label": _outdoor_label(manifest, point_roles.outdoor_temperature),
        "facility": _power(point_roles.facility_power),
        "hvac": _power(point_roles.hvac_power),
        "storeys": storeys(geometry, places) if geometry is not None else [],
        "systems": schematic(systems, manifest, places) if systems is not None else None,
    }
    return NodeDescription(manifest, point_roles, comfort, content)


def _actuator_place(manifest: Manifest, index: int | None) -> int | None:
    """Return the index of an actuator among all points of the page: sensors, meters, actuators."""
    return None if index is None else len(manifest.points) + index


def _outdoor_label(manifest: Manifest, index: int | None) -> str:
    """Return the label of the outdoor temperature, with the plant of a district whose point it is."""
    plant = "" if index is None else manifest.points[index].name.rpartition(".")[0]
    return f"Outdoors, {plant}" if plant else "Outdoors"


def _power(source: PowerSource | None) -> dict[str, Any] | None:
    return None if source is None else {"point": source.index, "to_kw": source.to_kw, "label": source.label}


def _is_setpoint_of_node(point: Sensor | Meter) -> bool:
    """Return whether a point is the setpoint of a node of a loop, which is `NO_SETPOINT` where there is none."""
    return isinstance(point, Sensor) and point.variable.casefold().startswith("system node setpoint")


def _points(manifest: Manifest, point_roles: PointRoles, places: dict[str, int]) -> list[dict[str, Any]]:
    """Return all points: sensors, meters, then actuators; the `id` of each is its name in a history."""
    texts = (*point_roles.labels, *point_roles.actuator_labels)
    zone_of = {
        index: number
        for number, zone in enumerate(zone for zone in point_roles.zones if zone.temperature is not None)
        for index in (zone.temperature, zone.humidity, zone.occupants, zone.heating_setpoint, zone.cooling_setpoint)
        if index is not None
    }
    points: tuple[Sensor | Meter | Actuator, ...] = (*manifest.points, *manifest.actuators)
    ids = PointIndex((point.name for point in points), "point")
    result = []
    for index, (identity, point, text) in enumerate(zip(ids, points, texts, strict=True)):
        key = point.key.casefold() if isinstance(point, Sensor | Actuator) else ""
        entry: dict[str, Any] = {
            "id": identity,
            "name": point.name,
            "label": text,
            "unit": point_unit(point),
            "kind": type(point).__name__.lower(),
            "low": point.low,
            "high": point.high,
            "zone": zone_of.get(index, places.get(key)),
        }
        if quantity(point.unit) == {Meter: "energy", Sensor: "power"}.get(type(point)):
            entry |= {"unit": "kW", "factor": power_kw(point.unit, manifest.step_s)}
        if isinstance(point, Actuator):
            entry["default"] = point.default
        elif _is_setpoint_of_node(point):
            entry["unset"] = NO_SETPOINT
        result.append(entry)
    return result
