"""The samples that a node published before the monitor received any: from the node's history."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from zenostat.topics import codec
from zenostat.topics.arrays import Floats
from zenostat.topics.messages import HistoryQuery, HistorySeries, Manifest

_MAX_POINTS = 1000
"""Largest number of points in a query."""


def read_history(
    query: Callable[[HistoryQuery], HistorySeries | None], manifest: Manifest, episode: int, last_step: int
) -> tuple[int, Floats] | None:
    """Return the samples of an episode up to a step: its first step, and the values.

    Args:
        query: returns the node's reply; None if it has none.
        manifest: manifest of the node.
        episode: number of the episode.
        last_step: step of the last sample.

    Returns:
        The step of the first sample that the node still has, and the values of all points, then the effective values
        of all actuators, shape (n, points + actuators); None if the node has none, or is in another episode by now.
    """
    names = [*manifest.names, *(actuator.name for actuator in manifest.actuators)]
    columns, firsts = [], []
    for begin in range(0, len(names), _MAX_POINTS):
        known = _read(query, names[begin : begin + _MAX_POINTS], episode, last_step)
        if known is None:
            return None
        firsts.append(known[0])
        columns.append(known[1])
    first = max(firsts, default=0)  # a node that runs on may have replaced its oldest samples between two queries
    rows = last_step + 1 - first
    return (first, np.concatenate([table[-rows:] for table in columns], axis=1)) if columns and rows > 0 else None


def _read(
    query: Callable[[HistoryQuery], HistorySeries | None], names: list[str], episode: int, last_step: int
) -> tuple[int, Floats] | None:
    """Return the first step and the values of some points, up to `last_step`; a reply may have a part only."""
    tables: list[Floats] = []
    first = following = 0
    while following <= last_step:
        reply = query(HistoryQuery(points=names, from_step=following, to_step=last_step))
        if reply is None or reply.episode != episode:
            return None
        if reply.first_step != following:
            tables, first = [], reply.first_step
        shape = (len(reply.values) // (codec.FLOAT.itemsize * len(names)), len(names))
        tables.append(codec.floats(reply.values, shape, "values"))
        following = reply.first_step + shape[0]
    return (first, np.concatenate(tables)) if tables else None
