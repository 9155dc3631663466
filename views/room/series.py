"""The history of points for trends and for other programs, requested from a node once for all pages."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any

import numpy as np

from zenostat.bridge.client.bus import Bus
from zenostat.bridge.client.history import History
from zenostat.topics.errors import InvalidConfig
from zenostat.views.room.description import NodeDescription
from zenostat.views.room.node_watch import NodeWatch
from zenostat.views.room.numbers import numbers

MAX_POINTS = 64
MAX_SAMPLES = 20_000
_KEPT = 32
_MAX_FOLLOWED = 40
"""Largest number of setpoints that are requested for the common band of all zones, besides the points of a page."""


class HistoryCache:
    """The latest replies about histories; a node is asked again only after its next sample."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._replies: OrderedDict[tuple[Any, ...], History] = OrderedDict()
        self._lock = threading.Lock()

    def history(
        self, watch: NodeWatch, points: Sequence[str], start: str | None, end: str | None, max_samples: int
    ) -> History:
        """Return the history of some points; arguments and errors as of `Bus.history`.

        Raises:
            InvalidConfig: no points, or too many points or samples.
        """
        if not 0 < len(points) <= MAX_POINTS:
            raise InvalidConfig(f"points: 1 to {MAX_POINTS} names expected, not {len(points)}")
        if not 2 <= max_samples <= MAX_SAMPLES:
            raise InvalidConfig(f"max: 2 to {MAX_SAMPLES} samples expected, not {max_samples}")
        state = watch.state or {}
        present = (watch.node, state.get("instance"), state.get("episode"), state.get("step"))
        key = (*present, tuple(points), start, end, max_samples)
        with self._lock:
            if key in self._replies:
                self._replies.move_to_end(key)
                return self._replies[key]
        history = self._bus.history(watch.node, points, start=start, end=end, max_samples=max_samples, extremes=True)
        with self._lock:
            self._replies[key] = history
            while len(self._replies) > _KEPT:
                self._replies.popitem(last=False)
        return history


def history_content(history: History, points: int | None = None) -> dict[str, Any]:
    """Return a history for the page: times in ms, and for each point its values and the extremes between them.

    `points`: number of the first ones that are wanted; None: all.
    """
    extremes = history.stride > 1 and history.lows is not None and history.highs is not None
    return {
        "episode": history.episode,
        "stride": history.stride,
        "oldest_step": history.oldest_step,
        "last_step": int(history.step[-1]),
        "time_ms": times_ms(history),
        "points": [
            {
                "name": name,
                "values": numbers(history.values[:, column]),
                "lows": numbers(history.lows[:, column]) if extremes and history.lows is not None else None,
                "highs": numbers(history.highs[:, column]) if extremes and history.highs is not None else None,
            }
            for column, name in enumerate(history.points[:points])
        ],
    }


def band_zones(description: NodeDescription, text: str | None) -> range:
    """Return the zones whose common comfort band is wanted.

    Args:
        description: of the node.
        text: `all`, the number of a zone, or None for no band.

    Raises:
        InvalidConfig: it is neither.
    """
    zones = range(0 if description.comfort is None else len(description.comfort.zones))
    if text is None:
        return range(0)
    if text == "all":
        return zones if len(band_points(description, zones)) <= _MAX_FOLLOWED else range(0)
    if not text.isdecimal() or len(text) >= 9 or int(text) not in zones:
        raise InvalidConfig(f"band: 'all' or the number of a zone, 0 to {len(zones) - 1}, expected, not {text[:40]!r}")
    return range(int(text), int(text) + 1)


def band_points(description: NodeDescription, zones: range) -> dict[str, int]:
    """Return the points that the bands of some zones follow: the index of each by its name in a history."""
    comfort, points = description.comfort, description.content["points"]
    if comfort is None:
        return {}
    return {points[index]["id"]: index for zone in zones for index in comfort.setpoints[zone]}


def band_content(description: NodeDescription, history: History, zones: range) -> dict[str, list[float | None]]:
    """Return the limits in degC of the common band of some zones at each sample of a history; None where they differ.

    Args:
        description: of the node.
        history: with the `band_points` of the zones.
        zones: numbers of zones; of none, all limits are None.
    """
    comfort, manifest, indices = description.comfort, description.manifest, band_points(description, zones)
    columns = [history.points.index(name) for name in indices]
    values = np.full(len(manifest.points), np.nan)
    limits = np.full((2, len(history)), np.nan)
    if comfort is not None and zones:
        for row, end in enumerate(history.time.tolist()):
            values[list(indices.values())] = history.values[row, columns]
            low, high = (each[zones] for each in comfort.limits(values, end - manifest.timestep))
            if (low == low[0]).all() and (high == high[0]).all():
                limits[:, row] = low[0], high[0]
    return {"low": numbers(limits[0]), "high": numbers(limits[1])}


def times_ms(history: History) -> list[int]:
    """Return simulated times as ms since 1970, as if the building's standard time were UTC."""
    milliseconds: list[int] = history.time.astype("datetime64[ms]").astype(int).tolist()
    return milliseconds


def simulated_time(text: str) -> str:
    """Return a simulated time as a node expects it, from an ISO 8601 time with or without a zone.

    Dashboards send UTC, which stands for the building's standard time.
    """
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        return text
    if moment.tzinfo is None:
        return text
    with suppress(OverflowError):  # at the ends of the calendar, where hours do not matter
        moment = moment.astimezone(UTC)
    return moment.replace(tzinfo=None).isoformat(timespec="seconds")
