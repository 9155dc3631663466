"""The part of the client of a bus that reads time series: history and weather of the present episode."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from zenostat.bridge.client.history import History, first_step, last_step
from zenostat.bridge.client.requests import Requests, build
from zenostat.topics import codec, keys
from zenostat.topics.errors import BadMessage, EpisodeChanged, InvalidConfig, RequestRejected
from zenostat.topics.messages import HistoryQuery, HistorySeries, Manifest, WeatherQuery, WeatherSeries


class SeriesRequests(Requests):
    """Base class of `Bus`: requests for time series."""

    def weather(self, node: str, columns: Sequence[str], slot: int = 0) -> WeatherSeries:
        """Return weather of a slot's current episode, noise included; `UnknownName` lists the columns."""
        return self._ask(keys.WEATHER, node, WeatherQuery(columns=list(columns), slot=slot), WeatherSeries)

    def history(
        self,
        node: str,
        points: Sequence[str] | None = None,
        *,
        slot: int = 0,
        start: datetime | str | None = None,
        end: datetime | str | None = None,
        max_samples: int | None = None,
        extremes: bool = False,
    ) -> History:
        """Return the values of points in a slot's present episode, as far as the node keeps them.

        The manifest has the number of samples that it keeps (`history_samples`).

        Args:
            node: The node's name.
            points: Names of sensors, meters and actuators; None is all of them.
            slot: Number of the slot.
            start: Simulated time, such as `07-03T06:00`, of the first sample; None is the earliest that is kept.
            end: Simulated time of the last sample; None is the latest.
            max_samples: At most this many (2 or more); of more, only every k-th is returned, the last one included,
                and `History.stride` is k. A reply of 4 MiB may limit them further.
            extremes: Also return the smallest and the largest value of the samples between those that are returned.

        Raises:
            NodeNotFound: No such node.
            UnknownName: No such point; the text lists similar names.
            InvalidConfig: A time has another form, or `max_samples` is out of range.
            RequestRejected: The node keeps no history, or has no sample in that range.
            EpisodeChanged: A new episode began while the history was read.
        """
        manifest = self.manifest(node)
        names = [*manifest.names, *(a.name for a in manifest.actuators)] if points is None else list(points)
        if isinstance(points, str):
            raise InvalidConfig(f"points: a list of names expected, such as [{points!r}]")
        query = build(
            HistoryQuery,
            points=names,
            slot=slot,
            from_step=first_step(manifest, start),
            to_step=last_step(manifest, end),
            max_samples=max_samples,
            extremes=extremes,
        )
        replies = [self._ask(keys.HISTORY, node, query, HistorySeries)]
        while replies[-1].remaining:
            last, following = replies[-1], replies[-1].first_step + _rows(replies[-1])
            query = query.model_copy(update={"from_step": following, "to_step": following + last.remaining - 1})
            reply = self._ask(keys.HISTORY, node, query, HistorySeries)
            if reply.episode != last.episode:
                raise EpisodeChanged(f"node {node!r} began a new episode while its history was read")
            if reply.first_step != following:
                raise RequestRejected(f"node {node!r} replaced samples while they were read; request fewer points")
            replies.append(reply)
        return _joined(manifest, slot, replies)


def _rows(reply: HistorySeries) -> int:
    return len(reply.values) // (codec.FLOAT.itemsize * len(reply.points))


def _joined(manifest: Manifest, slot: int, replies: Sequence[HistorySeries]) -> History:
    """Return the content of consecutive replies."""
    first = replies[0]

    def table(name: str) -> NDArray[np.float64]:
        rows = [codec.floats(getattr(r, name), (_rows(r), len(first.points)), name) for r in replies]
        return rows[0] if len(rows) == 1 else np.concatenate(rows)

    values = table("values")
    if not len(values):
        raise BadMessage("a history without samples")
    return History(
        manifest=manifest,
        episode=first.episode,
        slot=slot,
        points=tuple(first.points),
        units=tuple(first.units),
        stride=first.stride,
        oldest_step=first.oldest_step,
        step=first.first_step + first.stride * np.arange(len(values), dtype=np.int64),
        values=values,
        lows=table("lows") if first.lows else None,
        highs=table("highs") if first.highs else None,
    )
