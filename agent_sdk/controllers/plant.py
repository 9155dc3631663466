"""Rules for what is no setpoint of a room: water temperatures, availabilities, storage."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent_sdk.controllers.action_roles import ActionBinding, Role
from agent_sdk.controllers.base import Values
from agent_sdk.controllers.comfort_band import Band, inside

RESET_K = 1.0
"""Water is at its mildest while all rooms are this far within the band."""


class PlantRules:
    """Rules for water temperatures, availabilities and storage.

    Water: heating water is at its coolest while the coldest room is 1 K or more above the band's lower end, at its
    hottest at that end, linear between; chilled water the same for the warmest room and the upper end. Availability:
    on below the band's lower end and the margin, off above the band's middle, between them as it was. Storage stands
    idle, at the value nearest to 0.
    """

    def __init__(self, margin_k: float | None) -> None:
        self._margin_k = margin_k
        self._on: dict[str, bool] = {}

    def begin(self) -> None:
        """Forgets which switches are on."""
        self._on.clear()

    def act(self, part: ActionBinding, values: NDArray[np.float64], band: Band) -> Values:
        """The values of one part; none if it is nothing that these rules know, or its rooms are not measured."""
        if part.role is Role.STORAGE:
            return part.at(0.0)
        rooms = values[list(part.temperatures)]
        if not len(rooms):
            return {}
        low, high = part.action.low, part.action.high
        if part.role is Role.AVAILABILITY:
            return part.at(float(self._switched(part, float(rooms.min()), band)))
        if part.role is Role.HOT_WATER and low is not None and high is not None:
            return part.at(low + (high - low) * _short_of(float(rooms.min()) - band[0]))
        if part.role is Role.COLD_WATER and low is not None and high is not None:
            return part.at(high - (high - low) * _short_of(band[1] - float(rooms.max())))
        return {}

    def _switched(self, part: ActionBinding, coldest: float, band: Band) -> bool:
        middle = (band[0] + band[1]) / 2
        was = self._on.get(part.action.name, coldest < middle)
        on = coldest < inside(band, self._margin_k)[0] or (was and coldest <= middle)
        self._on[part.action.name] = on
        return on


def _short_of(inside_k: float) -> float:
    """0 where a room is `RESET_K` within the band, 1 at its end and outside."""
    return min(max(1.0 - inside_k / RESET_K, 0.0), 1.0)
