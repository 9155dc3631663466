"""The bus as a live view in Rerun.

A stream subscribes to the nodes' batches through a ring buffer; nodes never wait for it. Each episode of a node has
entities of its own, `/{node}/episode_0000/...`, or `/{node}/run_2_episode_0000/...` of the second node of that name, on
two timelines: `simulated` (the building's local standard time) and `step`. The layout shows the latest episode of each
node.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from functools import partial
from typing import Any, TypeVar

import rerun as rr
import zenoh
from zenoh.handlers import RingChannel

from zenostat.bridge.transport.request import send_request
from zenostat.metrics.comfort import default_comfort
from zenostat.topics import codec, keys
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import BadMessage, ZenostatError
from zenostat.topics.messages import (
    SCHEMA_VERSION,
    AlarmList,
    AlarmQuery,
    Batch,
    Event,
    Geometry,
    HistorySeries,
    Manifest,
    Message,
    Query,
    Sample,
    Status,
)
from zenostat.views.live.history import read_history
from zenostat.views.live.layout import OVERVIEW, blueprint
from zenostat.views.live.node_stream import PRESENT, NodeStream
from zenostat.views.live.recording import entity_path, write_out
from zenostat.views.live.samples import ComfortFactory, RewardFactory
from zenostat.views.live.summary import NodeRow, NodeStatus, overview

RING = 65536
PERIOD_S = 0.1
ROWS = 1000
"""Samples that are gathered for a file: short vectors make it several times as large."""

MAX_WAIT_S = 10.0
"""Longest time for which samples are gathered for a file."""

DRAW_PERIOD_S = 2.0
"""Shortest interval between two layouts, and between two images of a carpet, for a viewer."""

FILE_DRAW_PERIOD_S = 60.0
"""The limit for a file, of which mostly the last ones are seen; a layout takes half a megabyte."""

_OVERVIEW_PERIOD_S = 0.5
_VERSION_CHUNK = 1
_QUERY_S = 2.0
_RECORDING = "the recording"

M = TypeVar("M", bound=Message)


def _ignore(text: str) -> None:
    """Discard a notice."""


class RerunStream:
    """Logs the samples and events of one node, or of all, to a Rerun recording.

    Args:
        session: an open Zenoh session.
        node: a node's name, or `*`.
        sinks: sinks of the recording: `rr.FileSink`, `rr.GrpcSink`.
        is_live: whether a viewer shows the recording now: samples are logged ten times a second; else they are
            gathered first, which makes a file much smaller.
        comfort: returns the comfort bands of a node's zones; by default `DEFAULT_BAND_DEGC` for all.
        reward: returns the reward terms of an episode of a node; by default there is no reward.
        notify: called with sentences for the user: a node of another version, an unreadable message.

    Raises:
        ViewerError: while messages are logged or at the end: a file cannot be written.

    Attributes:
        samples: number of logged samples.
        missed: number of samples that were lost in transit, or overwritten in the ring buffer.
        left: whether a node that is shown has disconnected.
    """

    def __init__(
        self,
        session: zenoh.Session,
        node: str,
        sinks: Iterable[Any],
        *,
        is_live: bool = True,
        comfort: ComfortFactory = default_comfort,
        reward: RewardFactory | None = None,
        notify: Callable[[str], None] = _ignore,
    ) -> None:
        self.samples = 0
        self.left = False
        self._missed_before = 0  # of nodes that were restarted
        self._session, self._is_live = session, is_live
        self._comfort, self._reward, self._notify = comfort, reward, notify
        self._nodes: dict[str, NodeStream] = {}
        self._runs: dict[str, int] = {}  # number of nodes that each name had
        self._all = node == "*"
        if not self._all:
            keys.check_name(node, "the node's name")
        self._pending_nodes: dict[str, float] = {}  # nodes without a sample yet, and when they connected
        self._ignored: set[str] = set()  # branches, of which there may be hundreds, unless one is named
        self._notified: set[str] = set()
        self._overview_text, self._overview_s = "", 0.0
        self._drawn_s = 0.0
        self._close = ExitStack()
        self.recording = rr.RecordingStream("zenostat")
        self.recording.set_sinks(*sinks)
        self._close.callback(self.recording.disconnect)
        self._close.callback(write_out, self.recording, _RECORDING)
        declare = self._close.enter_context
        self._inbox = declare(session.declare_subscriber(keys.BATCH.at(node), RingChannel(RING)))
        tokens = keys.NODE_TOKEN.at(node, name="*").replace(f"/v{SCHEMA_VERSION}/", "/*/")
        live = session.liveliness()
        self._tokens = declare(live.declare_subscriber(tokens, RingChannel(256), history=True))
        self._close.callback(self._finish)
        self.samples += self._catch_up(node)  # a new liveliness subscriber does not know the nodes yet

    def __enter__(self) -> RerunStream:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def missed(self) -> int:
        """Number of samples that were lost."""
        return self._missed_before + sum(node.missed for node in self._nodes.values())

    def close(self) -> None:
        """Log the remaining messages and end the recording; idempotent."""
        self._close.close()

    def run(self, until: Callable[[], bool]) -> None:
        """Log batches until `until` returns true."""
        while not until():
            time.sleep(PERIOD_S)
            self.pump()

    def is_shown(self, within_s: float) -> bool:
        """Wait until a viewer has taken all that was logged; return whether it has within that time."""
        try:
            self.recording.flush(timeout_sec=within_s)
        except RuntimeError:
            return False
        return True

    def _finish(self) -> None:
        time.sleep(2 * PERIOD_S)  # for the batches that nodes have not sent yet
        self.pump()
        self._flush(is_last=True)

    def pump(self) -> int:
        """Log the messages received since the last call; return the number of samples."""
        messages = []
        while (message := self._inbox.try_recv()) is not None:
            messages.append(message)
        self._poll_presence()
        count = sum(map(self._receive_batch, messages)) + self._query_pending()
        self._flush()
        self.samples += count
        return count

    def _flush(self, *, is_last: bool = False) -> None:
        """Log the gathered samples, the overview and the layout where they are due."""
        now_s = time.monotonic()
        due = [
            node
            for node in self._nodes.values()
            if self._is_live or is_last or len(node.samples) >= ROWS or now_s - node.logged_s > MAX_WAIT_S
        ]
        for node in due:
            node.flush()
        if due and not self._is_live:
            write_out(self.recording, _RECORDING)
        if len(self._nodes) > 1 and (is_last or now_s - self._overview_s > _OVERVIEW_PERIOD_S):
            self._log_overview(now_s)
        if is_last or now_s - self._drawn_s > (DRAW_PERIOD_S if self._is_live else FILE_DRAW_PERIOD_S):
            self._draw(now_s)

    def _draw(self, now_s: float) -> None:
        for node in self._nodes.values():
            node.draw()
        changes = [node.take_layout_change() for node in self._nodes.values()]
        shown = [node for _, node in sorted(self._nodes.items())]
        views = [(node.model, node.view) for node in shown if node.view is not None]
        if views and any(changes):
            self.recording.send_blueprint(blueprint(views))
        self._drawn_s = now_s

    def _log_overview(self, now_s: float) -> None:
        rows = [
            NodeRow(name, node.model.manifest.building, node.numbers(), node.is_connected)
            for name, node in self._nodes.items()
        ]
        text = overview(rows)
        if text != self._overview_text:
            self._overview_text = text
            self.recording.log(entity_path(OVERVIEW), rr.TextDocument(text, media_type="text/markdown"), static=True)
        self._overview_s = now_s

    # Presence

    def _poll_presence(self) -> None:
        """Process nodes' connections and disconnections."""
        while (token := self._tokens.try_recv()) is not None:
            self._on_node_token(str(token.key_expr), is_gone=token.kind == zenoh.SampleKind.DELETE)

    def _on_node_token(self, key: str, *, is_gone: bool) -> None:
        name, version = keys.node_of(key), key.split("/")[_VERSION_CHUNK]
        if version != f"v{SCHEMA_VERSION}":
            if not is_gone:
                self._notify_once(
                    f"node {name!r} speaks message schema {version}, this monitor v{SCHEMA_VERSION}; it is not shown: "
                    "use the monitor of the node's Zenostat version"
                )
            return
        known = self._nodes.get(name)
        is_same = known is not None and known.model.manifest.instance == keys.last_chunk(key)
        if is_gone:
            if known is not None and is_same:  # no branch that is not shown, and no previous instance
                self.left, known.is_connected = True, False
            return
        if known is not None and not is_same:
            known.flush()  # the node was restarted, and its steps start from 0
            known.draw()
            self._missed_before += known.missed
            del self._nodes[name]
        self._pending_nodes.setdefault(name, time.monotonic())

    def _notify_once(self, text: str) -> None:
        if text not in self._notified:
            self._notified.add(text)
            self._notify(text)

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
                try:
                    sample = codec.decode(Sample, reply.ok.payload.to_bytes(), str(reply.ok.encoding))
                    count += self._receive_sample(node, sample, queried=True)
                except BadMessage as error:
                    self._on_unreadable(node, error)
        return count

    # Messages

    def _receive_batch(self, message: zenoh.Sample) -> int:
        name, count = keys.node_of(str(message.key_expr)), 0
        try:
            batch = codec.decode(Batch, message.payload.to_bytes(), str(message.encoding))
        except BadMessage as error:
            self._on_unreadable(name, error)
            return 0
        for sent in batch.messages:
            try:
                count += self._receive_message(name, sent.topic, sent.payload)
            except BadMessage as error:
                self._on_unreadable(name, error)
        return count

    def _receive_message(self, name: str, topic: str, payload: bytes) -> int:
        if topic == keys.SAMPLE.key:
            return self._receive_sample(name, codec.decode(Sample, payload))
        if topic == keys.MANIFEST.key:
            self._register_node(codec.decode(Manifest, payload))
        elif topic == keys.EVENT.key:
            node = self._nodes.get(name)
            if node is not None:
                node.add_event(codec.decode(Event, payload))
        return 0

    def _receive_sample(self, name: str, sample: Sample, *, queried: bool = False) -> int:
        if name in self._ignored:
            return 0
        node = self._nodes.get(name) or self._query_manifest(name)
        if node is None:
            return 0  # a branch, or a node that disconnected before its manifest was queried
        return node.add_sample(sample, queried=queried)

    def _on_unreadable(self, name: str, error: BadMessage) -> None:
        self._notify_once(f"node {name!r} sent a message that cannot be read, probably of another version: {error}")
        self.recording.log(
            entity_path(name, "events"), rr.TextLog(f"unreadable message: {error}", level="WARN"), static=True
        )

    # Nodes

    def _query_manifest(self, name: str) -> NodeStream | None:
        for reply in self._session.get(keys.MANIFEST.at(name)):
            if reply.ok is not None:
                payload = reply.ok.payload.to_bytes()
                return self._register_node(codec.decode(Manifest, payload, str(reply.ok.encoding)))
        return None

    def _register_node(self, manifest: Manifest) -> NodeStream | None:
        if self._all and manifest.branch_of:
            self._ignored.add(manifest.node)
            return None
        known = self._nodes.get(manifest.node)
        if known is not None:
            known.set_manifest(manifest)
            return known
        name = manifest.node
        self._runs[name] = self._runs.get(name, 0) + 1
        geometry = self._ask(name, keys.GEOMETRY, Query(), Geometry)  # None for a plant without one, or an older node
        node = self._nodes[name] = NodeStream(
            self.recording, manifest, geometry, self._comfort, self._reward, self._read_history, self._read_status,
            self._runs[name],
        )  # fmt: skip
        return node

    def _read_status(self, manifest: Manifest) -> NodeStatus:
        status = self._ask(manifest.node, keys.STATUS, Query(), Status)
        alarms = self._ask(manifest.node, keys.ALARMS, AlarmQuery(), AlarmList)
        return NodeStatus(
            tuple(alarm.alarm for alarm in alarms.alarms if alarm.state in PRESENT) if alarms is not None else (),
            tuple(status.faults) if status is not None else (),
        )

    def _read_history(self, manifest: Manifest, episode: int, last_step: int) -> tuple[int, Floats] | None:
        if not manifest.history_samples:
            return None
        query = partial(self._ask, manifest.node, keys.HISTORY, reply_type=HistorySeries)
        return read_history(query, manifest, episode, last_step)

    def _ask(self, name: str, topic: keys.Topic, request: Message, reply_type: type[M]) -> M | None:
        """Return a node's reply to a query; None if it has none."""
        try:
            return send_request(self._session, topic, name, request, reply_type, timeout_s=_QUERY_S).wait()
        except BadMessage as error:
            self._on_unreadable(name, error)
        except ZenostatError:  # the node refuses, or does not answer in time
            pass
        return None
