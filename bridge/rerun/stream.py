"""Samples of the bus as live plots in Rerun.

A stream hears what nodes say in batches, through a ring, so it can be as slow as it likes: a node never waits for it.
Each episode has an entity of its own, `/{node}/episode_0000/{quantity}`, one vector of scalars a step, over two
timelines: `simulated` (the building's local standard time) and `step`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import zenoh
from numpy.typing import NDArray
from rerun.encodings import TimeRange, TimeRangeBoundary
from zenoh.handlers import RingChannel

from topics import codec, keys
from topics.errors import BadMessage
from topics.messages import Batch, Event, EventKind, Manifest, Meter, Sample, Sensor

RING = 65536
PERIOD_S = 0.1
LEGEND = 6
"""Plots of more series than this begin with their legend hidden."""

_TITLES = {
    "degC": "temperature (degC)",
    "percent": "humidity (%)",
    "W": "power (W)",
    "J": "energy of the timestep (J)",
}
_SETPOINTS = "setpoints"
_GRAVE = (EventKind.FAILED, EventKind.REJECTED, EventKind.LATE, EventKind.ACCEPTED_LATE, EventKind.WARNING)


@dataclass(slots=True)
class _Quantity:
    """The points of one unit: one plot."""

    path: str
    title: str
    names: list[str]
    places: list[int]
    of_actuators: bool = False


@dataclass(slots=True)
class _Node:
    """What the stream knows of one node."""

    manifest: Manifest
    quantities: list[_Quantity]
    episode: int = -1
    step: int = -1
    asked: tuple[int, int] | None = None  # the place of a sample that was asked for; batches may still have older ones
    samples: list[Sample] = field(default_factory=list)


def _quantities(manifest: Manifest) -> list[_Quantity]:
    """One plot a unit, the sensors and meters of it in manifest order; the actuators in one of their own."""
    found: dict[str, _Quantity] = {}
    points: tuple[Sensor | Meter, ...] = (*manifest.sensors, *manifest.meters)
    for place, point in enumerate(points):
        quantity = found.setdefault(
            point.unit, _Quantity(keys.safe_name(point.unit), _TITLES.get(point.unit, point.unit), [], [])
        )
        quantity.names.append(point.name)
        quantity.places.append(place)
    if "1" in found:
        found["1"].title, found["1"].path = "occupants and other counts", "count"
    plots = list(found.values())
    if manifest.actuators:
        names, places = [a.name for a in manifest.actuators], list(range(len(manifest.actuators)))
        plots.append(_Quantity(_SETPOINTS, "actuators, as applied", names, places, of_actuators=True))
    return plots


class RerunStream:
    """Listens to a node, or to all, and logs to a Rerun recording.

    Args:
        session: an open Zenoh session.
        node: a node's name, or `*`.
        sinks: where the recording goes: `rr.FileSink`, `rr.GrpcSink`.

    Attributes:
        samples: how many were logged.
        missed: steps that were lost on their way here, or overwritten in the ring before they could be logged.
        left: whether a node that was listened to has gone.
    """

    def __init__(self, session: zenoh.Session, node: str, sinks: Iterable[Any]) -> None:
        self.samples = 0
        self.missed = 0
        self.left = False
        self._session = session
        self._nodes: dict[str, _Node] = {}
        self._all = node == "*"
        self._came: dict[str, float] = {}  # nodes that have sent no sample yet, and since when they are there
        self._passed_over: set[str] = set()  # branches, which come and go by the hundred, unless one is asked for
        self._close = ExitStack()
        self.recording = rr.RecordingStream("zenostat")
        self.recording.set_sinks(*sinks)
        self._close.callback(self.recording.disconnect)
        self._close.callback(self.recording.flush)
        declare = self._close.enter_context
        self._inbox = declare(session.declare_subscriber(keys.BATCH.at(node), RingChannel(RING)))
        self._tokens = declare(
            session.liveliness().declare_subscriber(keys.NODE_TOKEN.at(node, name="*"), RingChannel(256), history=True)
        )
        self._close.callback(self._finish)
        self.samples += self._catch_up(node)  # asked for, since a new liveliness subscriber knows nothing yet

    def __enter__(self) -> RerunStream:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Logs what is still in the ring and ends the recording; twice is fine."""
        self._close.close()

    def run(self, until: Callable[[], bool]) -> None:
        """Logs batches until told to stop."""
        while not until():
            time.sleep(PERIOD_S)
            self.pump()

    def _finish(self) -> None:
        time.sleep(2 * PERIOD_S)  # for the batches that nodes are gathering
        self.pump()

    def pump(self) -> int:
        """Logs what has come in since the last time; returns the number of samples."""
        messages = []
        while (message := self._inbox.try_recv()) is not None:
            messages.append(message)
        self._look_around()
        took = sum(map(self._take, messages)) + self._ask_silent()
        for node in self._nodes.values():
            self._log(node)
        self.samples += took
        return took

    def _look_around(self) -> None:
        """Notes nodes that have come and those that have gone."""
        while (token := self._tokens.try_recv()) is not None:
            if token.kind == zenoh.SampleKind.DELETE:
                self.left = True
                continue
            key = str(token.key_expr)
            name = keys.node_of(key)
            known = self._nodes.get(name)
            if known is not None and known.manifest.instance != keys.last_chunk(key):
                self._log(known)  # it has started again, and counts from nought
                del self._nodes[name]
            self._came.setdefault(name, time.monotonic())

    def _ask_silent(self) -> int:
        """Takes the sample that nodes stand at which have come and have sent none."""
        took, now_s = 0, time.monotonic()
        for name, since_s in [*self._came.items()]:
            if name in self._nodes or name in self._passed_over:
                del self._came[name]
            elif now_s - since_s > 3 * PERIOD_S:  # no batch comes
                del self._came[name]
                took += self._catch_up(name)
        return took

    def _catch_up(self, name: str) -> int:
        """Takes the sample that a node, or each (`*`), stands at."""
        took = 0
        for reply in self._session.get(keys.SAMPLE.at(name), target=zenoh.QueryTarget.ALL):
            if reply.ok is not None:
                who = keys.node_of(str(reply.ok.key_expr))
                took += self._take_sample(who, codec.decode(Sample, reply.ok.payload.to_bytes()), asked=True)
        return took

    def _take(self, message: zenoh.Sample) -> int:
        name, took = keys.node_of(str(message.key_expr)), 0
        try:
            batch = codec.decode(Batch, message.payload.to_bytes(), str(message.encoding))
        except BadMessage as error:
            self._log_unreadable(name, error)
            return 0
        for sent in batch.messages:
            try:
                took += self._take_one(name, sent.topic, sent.payload)
            except BadMessage as error:
                self._log_unreadable(name, error)
        return took

    def _take_one(self, name: str, topic: str, payload: bytes) -> int:
        if topic == keys.SAMPLE.key:
            return self._take_sample(name, codec.decode(Sample, payload))
        if topic == keys.MANIFEST.key:
            self._meet(codec.decode(Manifest, payload))
        elif topic == keys.EVENT.key:
            self._log_event(name, codec.decode(Event, payload))
        return 0

    def _take_sample(self, name: str, sample: Sample, *, asked: bool = False) -> int:
        if name in self._passed_over:
            return 0
        node = self._nodes.get(name) or self._ask(name)
        if node is None:
            return 0  # a branch, or it has gone before it could be asked what its values mean
        place = (sample.episode[0], sample.step[0])
        if asked:
            node.asked = place
        elif node.asked is not None:
            if place <= node.asked:
                return 0  # of before it was asked for, or that one again
            node.asked = None
        if sample.episode[0] != node.episode:
            self._log(node)
            node.episode, node.step = sample.episode[0], -1
            self._begin_episode(node)
        elif sample.step[0] <= node.step:
            return 0  # heard, and asked for as well
        else:
            self.missed += sample.step[0] - node.step - 1
        node.step = sample.step[0]
        node.samples.append(sample)
        return 1

    def _ask(self, name: str) -> _Node | None:
        for reply in self._session.get(keys.MANIFEST.at(name)):
            if reply.ok is not None:
                return self._meet(codec.decode(Manifest, reply.ok.payload.to_bytes(), str(reply.ok.encoding)))
        return None

    def _meet(self, manifest: Manifest) -> _Node | None:
        if self._all and manifest.branch_of:
            self._passed_over.add(manifest.node)
            return None
        known = self._nodes.get(manifest.node)
        if known is None:
            known = self._nodes[manifest.node] = _Node(manifest, _quantities(manifest))
        else:
            self._log(known)
            known.manifest, known.quantities, known.asked = manifest, _quantities(manifest), None
        return known

    def _entity(self, node: _Node, quantity: _Quantity) -> str:
        return f"{node.manifest.node}/episode_{node.episode:04}/{quantity.path}"

    def _begin_episode(self, node: _Node) -> None:
        for quantity in node.quantities:
            self.recording.log(self._entity(node, quantity), rr.SeriesLines(names=quantity.names), static=True)
        self.recording.send_blueprint(self._blueprint())

    def _blueprint(self) -> rrb.Blueprint:
        """The latest episode of each node, a plot a quantity, over the whole run period."""
        tabs = []
        for node in self._nodes.values():
            axis = rrb.TimeAxis(
                view_range=TimeRange(_boundary(node.manifest.begin), _boundary(node.manifest.end)), zoom_lock=False
            )
            plots = [
                rrb.TimeSeriesView(
                    origin=self._entity(node, q),
                    name=q.title,
                    axis_x=axis,
                    plot_legend=rrb.PlotLegend(visible=len(q.names) <= LEGEND),
                )
                for q in node.quantities
            ]
            tabs.append(rrb.Grid(*plots, name=f"{node.manifest.node}: {node.manifest.building}", grid_columns=2))
        layout = tabs[0] if len(tabs) == 1 else rrb.Tabs(*tabs)
        return rrb.Blueprint(layout, rrb.TimePanel(state="collapsed", timeline="simulated"), collapse_panels=True)

    def _log(self, node: _Node) -> None:
        """One batch: a column of vectors a plot."""
        samples, node.samples = node.samples, []
        if not samples:
            return
        simulated = rr.TimeColumn("simulated", timestamp=[np.datetime64(s.time[0], "ns") for s in samples])
        step = rr.TimeColumn("step", sequence=[s.step[0] for s in samples])
        values = _rows(b"".join(s.values for s in samples), len(samples))
        effective = _rows(b"".join(s.effective for s in samples), len(samples))
        for quantity in node.quantities:
            table = (effective if quantity.of_actuators else values)[:, quantity.places]
            columns = rr.Scalars.columns(scalars=table.ravel()).partition([table.shape[1]] * len(samples))
            rr.send_columns(self._entity(node, quantity), [simulated, step], columns, recording=self.recording)

    def _log_unreadable(self, name: str, error: BadMessage) -> None:
        self.recording.log(f"{name}/events", rr.TextLog(f"unreadable message: {error}", level="WARN"))

    def _log_event(self, name: str, event: Event) -> None:
        grave = event.kind in _GRAVE
        text = f"{event.kind}: {event.text}" + (f" ({event.source})" if event.source else "")
        self.recording.set_time("step", sequence=event.step)
        self.recording.log(f"{name}/events", rr.TextLog(text, level="WARN" if grave else "INFO"))


def _rows(raw: bytes, count: int) -> NDArray[np.float64]:
    return np.frombuffer(raw, "<f8").reshape(count, -1)


def _boundary(time_text: str) -> TimeRangeBoundary:
    since = datetime.fromisoformat(time_text) - datetime(1970, 1, 1)
    return TimeRangeBoundary.absolute(seconds=since.total_seconds())
