"""Sensors of the HVAC systems, for schematics: temperatures and flows behind the components, and their powers."""

from __future__ import annotations

import re
from collections import defaultdict

from zenostat.models.building.model import Building
from zenostat.models.building.nodes import managed_nodes
from zenostat.models.building.schematic import systems
from zenostat.models.points.discovery import PointCatalog
from zenostat.topics.keys import safe_name
from zenostat.topics.messages import SystemComponent, Systems

_NODE_SENSORS = {
    "temperature": "System Node Temperature",
    "flow": "System Node Mass Flow Rate",
    "setpoint": "System Node Setpoint Temperature",
}
_RATE = re.compile(
    r".*\b(electricity|naturalgas|propane|gasoline|diesel|coal|fueloilno[12]|otherfuel[12]) rate"
    r"|.*\b(coil|evaporator|boiler|exchanger|tower|water heater|baseboard|heat pump|terminal unit)\b.*"
    r"\b(total cooling|cooling|heating|heat transfer) rate",
    re.IGNORECASE,
)
"""Output variables of a component's power, and of the heat that it moves."""

_OUTDOOR_AIR = "AirLoopHVAC:OutdoorAirSystem"
_SKIPPED = re.compile(r"crankcase|defrost|standby|ancillary|parasitic|source side|backup|sensible", re.IGNORECASE)


def system_sensors(building: Building, available: PointCatalog) -> dict[str, tuple[str, str]]:
    """Return by name the output variables and keys that a schematic of the building's systems shows.

    Temperature and mass flow are those at the outlets of the components on the loops and of the zones' equipment; a
    setpoint only where a setpoint manager or an EMS program sets one.
    """
    described = systems(building.objects)
    managed = managed_nodes(building.objects)
    rates = _rates(available)
    sensors: dict[str, tuple[str, str]] = {}
    seen: set[tuple[str, str]] = set()

    def add(name: str, variable: str, key: str) -> None:
        spec = (variable.casefold(), key.casefold())
        if spec in available.by_variable and spec not in seen:
            seen.add(spec)
            sensors[safe_name(name)] = (variable, key)

    for component in _on_loops(described):
        for node in component.outlets:
            for suffix, variable in _NODE_SENSORS.items():
                if suffix != "setpoint" or node.name.casefold() in managed:
                    add(f"{component.name}_{node.port}_{suffix}", variable, node.name)
    for component in described.components:
        for variable in rates.get(component.name.casefold(), ()):
            add(f"{component.name}_{variable}", variable, component.name)
    return sensors


def _rates(available: PointCatalog) -> dict[str, list[str]]:
    """Return the output variables of power and heat by the component's name, case-folded."""
    rates: dict[str, list[str]] = defaultdict(list)
    for variable in available.variables:
        if _RATE.fullmatch(variable.name) and not _SKIPPED.search(variable.name):
            rates[variable.key.casefold()].append(variable.name)
    return rates


def _on_loops(described: Systems) -> list[SystemComponent]:
    """Return the components that are on a branch or serve a zone, and the parts of outdoor air systems."""
    numbers = [
        number
        for loop in described.loops
        for side in loop.sides
        for stage in side.stages
        for branch in stage
        for number in branch
    ]
    zones = [*(zone for loop in described.loops for zone in loop.zones), *described.zones]
    numbers += [number for zone in zones for number in zone.equipment]
    on_loops = [described.components[number] for number in dict.fromkeys(numbers)]
    mixers = [number for each in on_loops if each.kind == _OUTDOOR_AIR for number in each.parts]
    return [*on_loops, *(described.components[number] for number in dict.fromkeys(mixers))]
