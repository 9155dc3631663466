"""The history of the present episode: a request, and its reply."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from zenostat.topics.messages.base import Count, Message, Raw

MAX_HISTORY_POINTS = 1000
"""Largest number of points in a query of a history."""


class HistoryQuery(Message):
    """Request the values of some points in the present episode of a slot, as far as the node keeps them.

    `points`: names of sensors, meters and actuators (their effective values); an actuator that has the name of a sensor
    is `actuator/{name}`. `from_step`, `to_step`: first and last
    step; by default all that are kept. `max_samples`: with more samples than that, only every `stride`-th is sent.
    `extremes`: also send the smallest and the largest value of the samples between those that are sent.
    """

    points: Annotated[list[str], Field(min_length=1, max_length=MAX_HISTORY_POINTS)]
    slot: Count = 0
    from_step: Count | None = None
    to_step: Count | None = None
    max_samples: Annotated[int, Field(ge=2, le=1_000_000, strict=True)] | None = None
    extremes: bool = False


class HistorySeries(Message):
    """Values of the present episode of a slot, as published: with injected faults, and NaN where there is none.

    `values` is raw, of shape (samples, points); row k belongs to step `first_step + stride * k`. A `stride` above 1
    means that samples were left out: each row stands for itself and the `stride - 1` samples before it. If extremes
    were requested, `lows` and `highs` are the smallest and the largest of these values, NaN left aside, with the shape
    of `values`; otherwise they are empty. `remaining`: samples of the range that follow the last row, for a further
    request, because a reply has at most 4 MiB. `oldest_step`, `latest_step`: the samples that the node keeps.
    """

    episode: Count
    points: Annotated[list[str], Field(min_length=1)]
    units: list[str]
    first_step: Count
    stride: Annotated[int, Field(ge=1)]
    remaining: Count
    oldest_step: Count
    latest_step: Count
    values: Raw
    lows: Raw = b""
    highs: Raw = b""
