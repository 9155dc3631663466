"""The same values all the time."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from agent_sdk.bus.sample import SampleView
from agent_sdk.controllers.action_roles import ActionBinding, Role, bind_actions
from agent_sdk.controllers.base import Controller, Values
from agent_sdk.controllers.comfort_band import Band, comfort_bands, inside
from agent_sdk.controllers.parameters import named
from topics.errors import InvalidConfig
from topics.messages import Manifest


class FixedSetpoints(Controller):
    """One value for each action.

    Args:
        manifest: of the node.
        values: by the name of an action or an actuator, in its unit. What is not named: setpoints lie 1 K inside the
            day's comfort band (that of the task's reward, or of `LinearReward`; a third of it where it is narrower
            than 3 K) within the action's bounds, availabilities are on, water temperatures stand in the middle of
            their bounds, storage is idle, and other actions stay as they are.

    Raises:
        InvalidConfig: no such action or actuator, a value out of bounds, or a heating setpoint above the cooling
            setpoint of the same zones.
    """

    def __init__(self, manifest: Manifest, **values: float) -> None:
        super().__init__(manifest)
        self._band = comfort_bands(manifest)
        self._named = named(manifest, values)
        self._parts = bind_actions(manifest)
        self._check_pairs()

    def _check_pairs(self) -> None:
        if self._named:
            for day in DAYS:
                check_deadband(self._parts, self._on(self._band(day)))

    def act(self, sample: SampleView) -> Values:
        """The values, and those of the day's band for the rest."""
        return self._on(self._band(sample.time))

    def _on(self, band: Band) -> Values:
        values: Values = {}
        for part in self._parts:
            values |= default(part, inside(band))
        return values | self._named


DAYS = tuple(datetime(2017, month, day) for month in range(1, 13) for day in (1, 15))
"""Days of all seasons."""


def check_deadband(parts: Sequence[ActionBinding], values: Values) -> None:
    """Refuses values by which a zone is heated above its cooling setpoint: `InvalidConfig`."""
    said: dict[Role, list[tuple[ActionBinding, float]]] = {Role.HEATING: [], Role.COOLING: []}
    for part in parts:
        found = [value for a in part.action.actuators if (value := values.get(a)) is not None]
        if part.role in said and found:
            said[part.role].append((part, max(found) if part.role is Role.HEATING else min(found)))
    for heated, heating in said[Role.HEATING]:
        for cooled, cooling in said[Role.COOLING]:
            if heating > cooling and set(heated.temperatures) & set(cooled.temperatures):
                raise InvalidConfig(
                    f"{heated.action.name} = {heating:g} lies above {cooled.action.name} = {cooling:g}; "
                    f"EnergyPlus ends a run on that, so set the heating below the cooling"
                )


def default(part: ActionBinding, band: Band) -> Values:
    """What an action is set to while nobody says otherwise; nothing if that is not known."""
    low, high = part.action.low, part.action.high
    if part.role is Role.HEATING:
        return part.at(band[0])
    if part.role is Role.COOLING:
        return part.at(band[1])
    if part.role is Role.AVAILABILITY:
        return part.at(1.0)
    if part.role is Role.STORAGE:
        return part.at(0.0)
    if part.role in (Role.HOT_WATER, Role.COLD_WATER) and low is not None and high is not None:
        return part.at((low + high) / 2)
    return {}
