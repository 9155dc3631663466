"""Rules for plant actions: water temperatures, availabilities, storage."""

from __future__ import annotations

from zenostat.agent_sdk.controllers.action_roles import ActionBinding, Role
from zenostat.agent_sdk.controllers.base import Values
from zenostat.agent_sdk.controllers.comfort_band import Band, inside
from zenostat.topics.arrays import Floats

RESET_K = 1.0
"""Distance of all zones from the limit of the band at which water is at its mildest."""


class PlantRules:
    """Rules for water temperatures, availabilities and storage.

    Heating water is at its coolest while the coldest zone is at least 1 K above the lower limit of the band, at its
    hottest at that limit, and linear in between; chilled water correspondingly for the warmest zone and the upper
    limit. An availability is switched on if the coldest zone falls below the lower limit plus the margin, and off if
    it rises above the middle of the band. Storage is idle: at the value nearest to 0.
    """

    def __init__(self, margin_k: float | None) -> None:
        self._margin_k = margin_k
        self._is_on: dict[str, bool] = {}

    def begin(self) -> None:
        """Reset the state of the availabilities."""
        self._is_on.clear()

    def act(self, binding: ActionBinding, values: Floats, band: Band) -> Values:
        """Return the values of one action; empty if it is not a plant action, or its zones are not measured."""
        if binding.role is Role.STORAGE:
            return binding.at(0.0)
        zones = values[list(binding.temperatures)]
        if not len(zones):
            return {}
        low, high = binding.action.low, binding.action.high
        if binding.role is Role.AVAILABILITY:
            return binding.at(float(self._switch(binding, float(zones.min()), band)))
        if binding.role is Role.HOT_WATER and low is not None and high is not None:
            return binding.at(low + (high - low) * _demand(float(zones.min()) - band[0]))
        if binding.role is Role.COLD_WATER and low is not None and high is not None:
            return binding.at(high - (high - low) * _demand(band[1] - float(zones.max())))
        return {}

    def _switch(self, binding: ActionBinding, coldest: float, band: Band) -> bool:
        middle = (band[0] + band[1]) / 2
        was_on = self._is_on.get(binding.action.name, coldest < middle)
        is_on = coldest < inside(band, self._margin_k)[0] or (was_on and coldest <= middle)
        self._is_on[binding.action.name] = is_on
        return is_on


def _demand(inside_k: float) -> float:
    """Return the demand of a zone: 0 if it is `RESET_K` or more inside the band, 1 at its limit and outside."""
    return min(max(1.0 - inside_k / RESET_K, 0.0), 1.0)
