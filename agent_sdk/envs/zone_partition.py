"""Divide a building's actions and observations among one agent for each zone."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from zenostat.agent_sdk.envs.agent_parts import AgentPart, indices_of
from zenostat.topics.energyplus_names import THERMOSTAT
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.keys import safe_name
from zenostat.topics.messages import Action, Manifest, Sensor

BUILDING = "building"
"""The agent of all actions that belong to no single zone."""

_THERMOSTAT = THERMOSTAT.casefold()
_OUTDOORS = "environment"


@dataclass(frozen=True, kw_only=True)
class ZoneAgent(AgentPart):
    """The parts of a building that belong to one agent.

    Attributes:
        zone: Key of its zone; empty for the agent of the building.
    """

    zone: str


def partition(manifest: Manifest, shared: Sequence[str], observation_names: Sequence[str]) -> dict[str, ZoneAgent]:
    """Return the agents by name, in the order of their first actions; the agent of the building is last.

    Args:
        manifest: The node's manifest.
        shared: Names of observations that all agents get.
        observation_names: Names of the building's observation.

    Raises:
        InvalidConfig: No action belongs to a single zone, or `shared` has an unknown name.
    """
    shared_indices = indices_of(shared, observation_names)
    task = manifest.task
    actions_by_name = {action.name: action for action in task.actions}
    dimensions = [[actions_by_name[name] for name in discrete.actions] for discrete in task.discrete_actions] or [
        [action] for action in task.actions
    ]
    keys = {a.name: a.key for a in manifest.actuators if a.component_type.casefold() == _THERMOSTAT}
    zones = [_zone_of(actions, keys) for actions in dimensions]
    order = [*dict.fromkeys(zone for zone in zones if zone), *([""] if "" in zones else [])]
    if order in ([], [""]):
        raise InvalidConfig(
            f"no action of node {manifest.node!r} belongs to a single zone; control='zone' gives each zone its own, "
            "unless the scenario defines its actions; a plant of your own has no zones"
        )
    names, agents = _agent_names(order), {}
    for zone in order:
        action_indices = [index for index, other_zone in enumerate(zones) if other_zone == zone]
        actions = [action for index in action_indices for action in dimensions[index]]
        actuators = {name for action in actions for name in action.actuators}
        agents[names[zone]] = ZoneAgent(
            zone=zone,
            actions=tuple(action.name for action in actions),
            action_indices=action_indices,
            actuator_indices=[index for index, actuator in enumerate(manifest.actuators) if actuator.name in actuators],
            observation_indices=_observed_by(zone, manifest, shared_indices),
        )
    return agents


def _zone_of(actions: Sequence[Action], keys: Mapping[str, str]) -> str:
    """Return the key of the single zone whose thermostat these actions set; empty if there is none."""
    folded = {keys.get(name, "").casefold() for action in actions for name in action.actuators}
    return keys.get(actions[0].actuators[0], "") if len(folded) == 1 else ""


def _agent_names(zones: Iterable[str]) -> dict[str, str]:
    """Return a unique safe name for each zone."""
    names = {"": BUILDING}
    for zone in zones:
        name = base = safe_name(zone)
        number = 2
        while zone and name in names.values():
            name, number = f"{base}_{number}", number + 1
        names.setdefault(zone, name)
    return names


def _observed_by(zone: str, manifest: Manifest, shared: set[int]) -> list[int]:
    first = len(manifest.task.time)
    points = manifest.observed_points
    count = first + len(points)
    if not zone:
        return list(range(count))
    keys = (_OUTDOORS, zone.casefold())
    related = {
        first + index
        for index, point in enumerate(points)
        if isinstance(point, Sensor) and point.key.casefold() in keys
    }
    return [index for index in range(count) if index < first or index in related or index in shared]
