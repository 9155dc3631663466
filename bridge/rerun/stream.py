"""Samples of the bus as live plots in Rerun.

A stream subscribes to the nodes' batches through a ring buffer; nodes never wait for it. Each episode has entities of
its own, `/{node}/episode_0000/{quantity}`, with one vector of scalars per step on two timelines: `simulated` (the
building's local standard time) and `step`.
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
from topics.messages import Batch, Event, EventKind, Manifest, Sample

RING = 65536
PERIOD_S = 0.1
LEGEND = 6
"""Largest number of series in a plot with a visible legend."""

_TITLES = {
    "degC": "temperature (degC)",
    "percent": "humidity (%)",
    "W": "power (W)",
    "J": "energy of the timestep (J)",
}
_SETPOINTS = "setpoints"
_WARNINGS = (EventKind.FAILED, EventKind.REJECTED, EventKind.LATE, EventKind.ACCEPTED_LATE, EventKind.WARNING)


@dataclass(slots=True)
class _Quantity:
    """A plot: the points with one unit, or the actuators."""

    path: str
    title: str
    names: list[str]
    columns: list[int]
    is_actuators: bool = False


@dataclass(slots=True)
class _Node:
    """State of one node in the stream."""

    manifest: Manifest
    quantities: list[_Quantity]
    episode: int = -1
    step: int = -1
    queried: tuple[int, int] | None = None  # episode and step of a queried sample; later batches may have older ones
    samples: list[Sample] = field(default_factory=list)


def _quantities(manifest: Manifest) -> list[_Quantity]:
    """One plot per unit, with its sensors and meters in manifest order, and one plot of all actuators."""
    by_unit: dict[str, _Quantity] = {}
    for column, point in enumerate(manifest.points):
        quantity = by_unit.setdefault(
            point.unit, _Quantity(keys.safe_name(point.unit), _TITLES.get(point.unit, point.unit), [], [])
        )
        quantity.names.append(point.name)
        quantity.columns.append(column)
    if "1" in by_unit:
        by_unit["1"].title, by_unit["1"].path = "counts and ratios (1)", "count"
    plots = list(by_unit.values())
    if manifest.actuators:
        names, columns = [a.name for a in manifest.actuators], list(range(len(manifest.actuators)))
        plots.append(_Quantity(_SETPOINTS, "actuators, as applied", names, columns, is_actuators=True))
    return plots


class RerunStream:
    """Logs the samples and events of one node, or of all, to a Rerun recording.

    Args:
        session: an open Zenoh session.
        node: a node's name, or `*`.
        sinks: sinks of the recording: `rr.FileSink`, `rr.GrpcSink`.

    Attributes:
        samples: number of logged samples.
        missed: number of samples that were lost in transit, or overwritten in the ring buffer.
        left: whether a node has disconnected.
    """

    def __init__(self, session: zenoh.Session, node: str, sinks: Iterable[Any]) -> None:
        self.samples = 0
        self.missed = 0
        self.left = False
        self._session = session
        self._nodes: dict[str, _Node] = {}
        self._all = node == "*"
        self._pending_nodes: dict[str, float] = {}  # nodes without a sample yet, and when they connected
        self._ignored: set[str] = set()  # branches, of which there may be hundreds, unless one is named
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
        self.samples += self._catch_up(node)  # a new liveliness subscriber does not know the nodes yet

    def __enter__(self) -> RerunStream:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Log the remaining messages and end the recording; idempotent."""
        self._close.close()

    def run(self, until: Callable[[], bool]) -> None:
        """Log batches until `until` returns true."""
        while not until():
            time.sleep(PERIOD_S)
            self.pump()

    def _finish(self) -> None:
        time.sleep(2 * PERIOD_S)  # for the batches that nodes have not sent yet
        self.pump()

    def pump(self) -> int:
        """Log the messages received since the last call; return the number of samples."""
        messages = []
        while (message := self._inbox.try_recv()) is not None:
            messages.append(message)
        self._poll_presence()
        count = sum(map(self._receive_batch, messages)) + self._query_pending()
        for node in self._nodes.values():
            self._log(node)
        self.samples += count
        return count

    def _poll_presence(self) -> None:
        """Process nodes' connections and disconnections."""
        while (token := self._tokens.try_recv()) is not None:
            if token.kind == zenoh.SampleKind.DELETE:
                self.left = True
                continue
            key = str(token.key_expr)
            name = keys.node_of(key)
            known = self._nodes.get(name)
            if known is not None and known.manifest.instance != keys.last_chunk(key):
                self._log(known)  # the node was restarted, and its steps start from 0
                del self._nodes[name]
            self._pending_nodes.setdefault(name, time.monotonic())

    def _query_pending(self) -> int:
        """Query the samples of nodes that have connected and sent no batch."""
        count, now_s = 0, time.monotonic()
        for name, since_s in [*self._pending_nodes.items()]:
            if name in self._nodes or name in self._ignored:
                del self._pending_nodes[name]
            elif now_s - since_s > 3 * PERIOD_S:
                del self._pending_nodes[name]
                count += self._catch_up(name)
        return count

    def _catch_up(self, name: str) -> int:
        """Query the current sample of a node, or of all (`*`)."""
        count = 0
        for reply in self._session.get(keys.SAMPLE.at(name), target=zenoh.QueryTarget.ALL):
            if reply.ok is not None:
                node = keys.node_of(str(reply.ok.key_expr))
                count += self._receive_sample(node, codec.decode(Sample, reply.ok.payload.to_bytes()), queried=True)
        return count

    def _receive_batch(self, message: zenoh.Sample) -> int:
        name, count = keys.node_of(str(message.key_expr)), 0
        try:
            batch = codec.decode(Batch, message.payload.to_bytes(), str(message.encoding))
        except BadMessage as error:
            self._log_unreadable(name, error)
            return 0
        for sent in batch.messages:
            try:
                count += self._receive_message(name, sent.topic, sent.payload)
            except BadMessage as error:
                self._log_unreadable(name, error)
        return count

    def _receive_message(self, name: str, topic: str, payload: bytes) -> int:
        if topic == keys.SAMPLE.key:
            return self._receive_sample(name, codec.decode(Sample, payload))
        if topic == keys.MANIFEST.key:
            self._register_node(codec.decode(Manifest, payload))
        elif topic == keys.EVENT.key:
            self._log_event(name, codec.decode(Event, payload))
        return 0

    def _receive_sample(self, name: str, sample: Sample, *, queried: bool = False) -> int:
        if name in self._ignored:
            return 0
        node = self._nodes.get(name) or self._query_manifest(name)
        if node is None:
            return 0  # a branch, or a node that disconnected before its manifest was queried
        position = (sample.episode[0], sample.step[0])
        if queried:
            node.queried = position
        elif node.queried is not None:
            if position <= node.queried:
                return 0  # not newer than the queried sample
            node.queried = None
        if sample.episode[0] != node.episode:
            self._log(node)
            node.episode, node.step = sample.episode[0], -1
            self._begin_episode(node)
        elif sample.step[0] <= node.step:
            return 0  # both received and queried
        else:
            self.missed += sample.step[0] - node.step - 1
        node.step = sample.step[0]
        node.samples.append(sample)
        return 1

    def _query_manifest(self, name: str) -> _Node | None:
        for reply in self._session.get(keys.MANIFEST.at(name)):
            if reply.ok is not None:
                manifest = codec.decode(Manifest, reply.ok.payload.to_bytes(), str(reply.ok.encoding))
                return self._register_node(manifest)
        return None

    def _register_node(self, manifest: Manifest) -> _Node | None:
        if self._all and manifest.branch_of:
            self._ignored.add(manifest.node)
            return None
        known = self._nodes.get(manifest.node)
        if known is None:
            known = self._nodes[manifest.node] = _Node(manifest, _quantities(manifest))
        else:
            self._log(known)
            known.manifest, known.quantities, known.queried = manifest, _quantities(manifest), None
        return known

    def _entity(self, node: _Node, quantity: _Quantity) -> str:
        return f"{node.manifest.node}/episode_{node.episode:04}/{quantity.path}"

    def _begin_episode(self, node: _Node) -> None:
        for quantity in node.quantities:
            self.recording.log(self._entity(node, quantity), rr.SeriesLines(names=quantity.names), static=True)
        self.recording.send_blueprint(self._blueprint())

    def _blueprint(self) -> rrb.Blueprint:
        """Return a layout with the latest episode of each node: one plot per quantity, over the whole run period."""
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
        """Log the collected samples of a node: a column of vectors per plot."""
        samples, node.samples = node.samples, []
        if not samples:
            return
        simulated = rr.TimeColumn("simulated", timestamp=[np.datetime64(s.time[0], "ns") for s in samples])
        step = rr.TimeColumn("step", sequence=[s.step[0] for s in samples])
        values = _rows(b"".join(s.values for s in samples), len(samples))
        effective = _rows(b"".join(s.effective for s in samples), len(samples))
        for quantity in node.quantities:
            table = (effective if quantity.is_actuators else values)[:, quantity.columns]
            columns = rr.Scalars.columns(scalars=table.ravel()).partition([table.shape[1]] * len(samples))
            rr.send_columns(self._entity(node, quantity), [simulated, step], columns, recording=self.recording)

    def _log_unreadable(self, name: str, error: BadMessage) -> None:
        self.recording.log(f"{name}/events", rr.TextLog(f"unreadable message: {error}", level="WARN"))

    def _log_event(self, name: str, event: Event) -> None:
        level = "WARN" if event.kind in _WARNINGS else "INFO"
        text = f"{event.kind}: {event.text}" + (f" ({event.source})" if event.source else "")
        self.recording.set_time("step", sequence=event.step)
        self.recording.log(f"{name}/events", rr.TextLog(text, level=level))


def _rows(raw: bytes, count: int) -> NDArray[np.float64]:
    return np.frombuffer(raw, "<f8").reshape(count, -1)


def _boundary(time_text: str) -> TimeRangeBoundary:
    since = datetime.fromisoformat(time_text) - datetime(1970, 1, 1)
    return TimeRangeBoundary.absolute(seconds=since.total_seconds())
