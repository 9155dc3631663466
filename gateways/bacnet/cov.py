"""Notifications of changes of value (COV): what has changed enough, at most a few times per second."""

from __future__ import annotations

import math
from typing import Any

from bacpypes3.local.cov import COVDetection

COV_INTERVAL_S = 0.25
"""Shortest time between two notifications of an object to a subscriber, however fast the simulation runs."""


class CovCriteria(COVDetection):
    """State of an object that its subscribers know; see ASHRAE 135, clause 13.1.

    bacpypes3 compares at each assignment to a property. The gateway's objects have no assignments: they read the node's
    state. So `is_due` is asked after the node has changed, as often as `COV_INTERVAL_S` allows.
    """

    properties_tracked = ()
    properties_reported = ("presentValue", "statusFlags")
    monitored_property_reference = "presentValue"

    def __init__(self, obj: Any) -> None:
        super().__init__(obj)
        self._reported: tuple[Any, list[int]] | None = None

    def is_due(self) -> bool:
        """Whether the value has changed by the COV increment since the last notification, or a status flag has."""
        if self._reported is None:
            return True
        (before, flags_before), (value, flags) = self._reported, self._current()
        if flags != flags_before:
            return True
        if not isinstance(value, float):
            return bool(value != before)
        if math.isnan(value) or math.isnan(before):
            return math.isnan(value) != math.isnan(before)
        increment = self.obj.covIncrement or 0.0
        return bool(abs(value - before) >= increment if increment else value != before)

    def send_cov_notifications(self, subscription: Any = None) -> None:
        """Notify one subscriber, or all."""
        if subscription is not None and subscription.obj_ref is None:
            return  # cancelled meanwhile
        self.presentValue, self.statusFlags = self.obj.presentValue, self.obj.statusFlags
        if subscription is None or self._reported is None:
            self._reported = self._current()
        super().send_cov_notifications(subscription)

    def _current(self) -> tuple[Any, list[int]]:
        value = self.obj.presentValue
        return _comparable(value), [int(flag) for flag in self.obj.statusFlags]


def _comparable(value: Any) -> Any:
    """Return a copy that compares by value: of a date with time, both as tuples."""
    if hasattr(value, "date"):
        return (tuple(value.date), tuple(value.time))
    return value
