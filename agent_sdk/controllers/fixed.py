"""Controller with constant values."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from zenostat.agent_sdk.controllers.action_roles import ActionBinding, Role, bind_actions
from zenostat.agent_sdk.controllers.base import Controller, Values
from zenostat.agent_sdk.controllers.comfort_band import Band, comfort_bands, inside
from zenostat.agent_sdk.controllers.parameters import actuator_values
from zenostat.bridge.client.sample import SampleView
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Manifest


class FixedSetpoints(Controller):
    """Keep each action at one value.

    Args:
        manifest: manifest of the node.
        values: values by the name of an action or an actuator, in its unit. Actions that are not named get defaults:
            setpoints are 1 K (at most a third of the band) inside the day's comfort band, which is that of the task's
            reward or of `LinearReward`, and within the action's bounds; availabilities are on; water temperatures
            are in the middle of their bounds; storage is idle; other actions are not commanded.

    Raises:
        InvalidConfig: an unknown action or actuator, a value out of bounds, or a heating setpoint above the cooling
            setpoint of the same zone.
    """

    def __init__(self, manifest: Manifest, **values: float) -> None:
        super().__init__(manifest)
        self._band = comfort_bands(manifest)
        self._fixed = actuator_values(manifest, values)
        self._bindings = bind_actions(manifest)
        if self._fixed:
            for day in DAYS:
                check_deadband(self._bindings, self._values(self._band(day)))

    def act(self, sample: SampleView) -> Values:
        """Return the fixed values, and the defaults of the day for all other actions."""
        return self._values(self._band(sample.time))

    def _values(self, band: Band) -> Values:
        values: Values = {}
        for binding in self._bindings:
            values |= default_values(binding, inside(band))
        return values | self._fixed


DAYS = tuple(datetime(2017, month, day) for month in range(1, 13) for day in (1, 15))
"""Days to check, in all seasons."""


def check_deadband(bindings: Sequence[ActionBinding], values: Values) -> None:
    """Check that no zone gets a heating setpoint above its cooling setpoint.

    Raises:
        InvalidConfig: some zone does.
    """
    setpoints: dict[Role, list[tuple[ActionBinding, float]]] = {Role.HEATING: [], Role.COOLING: []}
    for binding in bindings:
        commanded = [value for a in binding.action.actuators if (value := values.get(a)) is not None]
        if binding.role in setpoints and commanded:
            extreme = max(commanded) if binding.role is Role.HEATING else min(commanded)
            setpoints[binding.role].append((binding, extreme))
    for heater, heating in setpoints[Role.HEATING]:
        for cooler, cooling in setpoints[Role.COOLING]:
            if heating > cooling and set(heater.temperatures) & set(cooler.temperatures):
                raise InvalidConfig(
                    f"{heater.action.name} = {heating:g} is above {cooler.action.name} = {cooling:g}; EnergyPlus "
                    f"stops in that case, so the heating setpoint has to be below the cooling setpoint"
                )


def default_values(binding: ActionBinding, band: Band) -> Values:
    """Return the default of an action for setpoints at the limits of `band`; empty if its role has none."""
    low, high = binding.action.low, binding.action.high
    if binding.role is Role.HEATING:
        return binding.at(band[0])
    if binding.role is Role.COOLING:
        return binding.at(band[1])
    if binding.role is Role.AVAILABILITY:
        return binding.at(1.0)
    if binding.role is Role.STORAGE:
        return binding.at(0.0)
    if binding.role in (Role.HOT_WATER, Role.COLD_WATER) and low is not None and high is not None:
        return binding.at((low + high) / 2)
    return {}
