"""Apply the items of a recording to a node's server again, and compare orders and samples with the recorded ones."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Iterator
from collections.abc import Set as AbstractSet
from contextlib import suppress
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

import msgpack
import numpy as np

from zenostat.bridge.exchange.claims import ControllerStats
from zenostat.bridge.exchange.fallback import DISCONNECTED, RECONNECTED
from zenostat.bridge.exchange.revocation import revoke
from zenostat.bridge.exchange.state import MAX_SOURCE_NAME, MessageCounts
from zenostat.bridge.exchange.step_exchange import IllegalTransition, Trigger
from zenostat.bridge.node.branches import Snapshot
from zenostat.bridge.node.plant import RepeatablePlant
from zenostat.bridge.recording.reader import RecordedItem
from zenostat.bridge.recording.verification import equal_bits
from zenostat.topics import codec, keys
from zenostat.topics.errors import BadMessage, EpisodeAborted, InvalidConfig, InvalidRecording, RequestRejected
from zenostat.topics.fault_plan import FaultPlan
from zenostat.topics.messages import (
    Acknowledge,
    Claim,
    Command,
    ErrorReply,
    Event,
    EventKind,
    Message,
    Pause,
    RemoveFromService,
    Resume,
    ReturnToService,
    SetPace,
    Shelve,
    StepRequest,
    Unshelve,
    Write,
)
from zenostat.topics.recording import (
    RecordedEpisode,
    RecordedMessage,
    RecordedOrder,
    RecordedRequest,
    RecordedSnapshot,
    RecordedState,
)

if TYPE_CHECKING:
    from zenostat.bridge.node.server import NodeServer

_COMMAND, _ACTUATOR = "command", "actuator"
_ERROR, _RECORDED_REQUEST = codec.encoding(ErrorReply), codec.encoding(RecordedRequest)
_LOOK_AHEAD = 2
_DAMAGE = (BadMessage, IllegalTransition, InvalidConfig, RequestRejected, LookupError, TypeError, ValueError)
"""Errors of the rules for messages that no node would have recorded."""

_SHOW_S = 0.1
"""Time between two calls of the server's observer."""


class Repetition:
    """The items of a recording from a start of episodes on, applied to a server.

    Args:
        server: not on the bus yet; its plant is at the first sample of the episodes.
        folder: for the files of snapshots; the caller removes it.
        state: what the ended node had at the start besides its plant.
        uses: names of the snapshots to which the recording returns.
        error: creates an error about the recording from its text.
    """

    def __init__(
        self,
        server: NodeServer,
        folder: Path,
        state: RecordedState,
        uses: AbstractSet[str],
        error: Callable[[str], InvalidRecording],
    ) -> None:
        self._server, self._exchange, self._manifest = server, server.exchange, server.manifest
        self._folder, self._numbers = folder, itertools.count()
        self._state, self._uses, self._error = state, uses, error
        self._order: RecordedOrder | None = None
        self._snapshots: dict[str, Snapshot] = {}
        self._has_begun, self._shown_s = False, 0.0

    def run(self, items: Iterator[RecordedItem]) -> None:
        """Apply items in their order; nothing is published.

        Raises:
            InvalidRecording: an order or a sample differs, or an item is none that a node would have recorded.
            SimulatorError: the plant failed.
        """
        try:
            for item, following in _with_following(items, _LOOK_AHEAD):
                self._process(item, following)
            self._begin_counts()
        except _DAMAGE as error:
            raise self._error(f"it is damaged: {type(error).__name__}: {error}") from None
        finally:
            for snapshot in self._snapshots.values():
                snapshot.drop()

    def _begin_counts(self) -> None:
        """Begin counts and latencies anew, except for the counts that samples contain."""
        exchange, counts = self._exchange, self._exchange.counts
        exchange.counts = MessageCounts(late=counts.late, rejected=counts.rejected)
        for claimant in exchange.claims.by_name.values():
            claimant.stats = ControllerStats()

    def _process(self, item: RecordedItem, following: list[RecordedItem]) -> None:
        if item.schema == "Sample":
            self._on_sample(item.payload)
        elif item.schema == "RecordedOrder":
            self._order = codec.decode(RecordedOrder, item.payload)  # simulated once it has a sample
        elif item.schema == "RecordedEpisode":
            self._on_episode(codec.decode(RecordedEpisode, item.payload))
        elif item.schema == "RecordedSnapshot":
            self._on_snapshot(codec.decode(RecordedSnapshot, item.payload))
        elif item.schema == "Event":
            self._on_event(codec.decode(Event, item.payload))
        elif item.schema == "RecordedMessage":
            message = codec.decode(RecordedMessage, item.payload)
            self._on_message(message.topic, message.payload, message.encoding, following)
        elif item.schema in ("Command", "Write"):
            kind = Command if item.schema == "Command" else Write
            self._on_message(item.topic, item.payload, codec.encoding(kind), following)
        elif item.schema == "RecordedRequest":
            self._on_message(item.topic, item.payload, _RECORDED_REQUEST, following)

    # Episodes

    def _on_episode(self, record: RecordedEpisode) -> None:
        server, exchange, plant, now_s = self._server, self._exchange, self._server.plant, monotonic()
        self._order = None
        if not self._has_begun:
            self._has_begun = True
            self._begin(record, now_s)
            return
        exchange.reset(record.slots)
        if record.snapshot:
            self._return_to(record, now_s)
            return
        assert isinstance(plant, RepeatablePlant)
        plant.repeat_episode(record.slots, record.inputs, exchange.episode)
        plant.start(record.slots)
        plant.clean_up()
        exchange.ready(now_s, dict.fromkeys(record.slots, 0))
        server.begin_episodes(record.slots, record.seeds)

    def _begin(self, record: RecordedEpisode, now_s: float) -> None:
        """Begin the first episodes, which the plant has started, with what the ended node had at their start."""
        server, exchange, state = self._server, self._exchange, self._state
        exchange.episode = [*record.episode]
        for claim in state.claims:
            exchange.claim(claim, now_s)
        server.set_mode(state.mode, state.speed)
        server.pacing.pace.speed, server.pacing.paused = state.speed, state.paused
        if state.faults is not None:
            server.inject(state.faults)
        exchange.ready(now_s)
        server.begin_episodes(record.slots, record.seeds)
        if server.injection is not None and state.fault_episodes:
            server.injection.set_episodes(state.fault_episodes)

    def _return_to(self, record: RecordedEpisode, now_s: float) -> None:
        server, exchange = self._server, self._exchange
        snapshot = self._snapshots.get(record.snapshot)
        if snapshot is None:
            raise self._error(f"it returns to the snapshot {record.snapshot!r}, which it does not contain")
        plant = server.plant
        assert isinstance(plant, RepeatablePlant)
        plant.restore(snapshot.plant, exchange.episode)
        plant.clean_up()
        exchange.ready(now_s, dict(enumerate(snapshot.step)), snapshot.commands)
        server.begin_episodes([*range(exchange.slots)], [None] * exchange.slots)
        server.restore(snapshot.faults, snapshot.received, snapshot.alarms)

    def _on_snapshot(self, record: RecordedSnapshot) -> None:
        if record.snapshot not in self._uses:
            return
        if (previous := self._snapshots.pop(record.snapshot, None)) is not None:
            previous.drop()
        folder = self._folder / f"resumed-{next(self._numbers)}"  # a name from a file could be a path
        self._snapshots[record.snapshot] = Snapshot.of(self._server, record.snapshot, "", folder)

    # Timesteps

    def _on_sample(self, recorded: bytes) -> None:
        server, order = self._server, self._order
        self._order = None
        if order is not None:
            self._step(order)
        sample = msgpack.unpackb(recorded)
        counts = self._exchange.counts
        counts.late, counts.rejected = sample["late"], sample["rejected"]  # since the start of the first node
        payload = server.repeat_sample()
        if payload != recorded:
            raise self._error(self._difference(sample, msgpack.unpackb(payload)))
        if (now_s := monotonic()) - self._shown_s >= _SHOW_S:
            self._shown_s = now_s
            server.observe()

    def _step(self, order: RecordedOrder) -> None:
        server, exchange, now_s = self._server, self._exchange, monotonic()
        if not exchange.ready_to_step():
            with suppress(EpisodeAborted):
                exchange.fallback.on_deadline(now_s)
        if not exchange.ready_to_step():
            raise self._error(
                f"step {exchange.step[0]} has an order, but {', '.join(exchange.awaiting()) or 'a controller'} had not "
                "answered"
            )
        server.pacing.step_started()
        step, commands = exchange.step, exchange.begin_step(now_s)
        if server.injection is not None:
            commands = server.injection.apply_to_commands(commands, exchange.step)
        if not _is_same_order(commands, order.values) or [*exchange.active_slots] != [*order.slots]:
            raise self._error(
                f"its messages up to step {step[0]} do not lead to the order that it recorded, for instance because a "
                "fault of the link delayed a command"
            )
        last = server.plant.step(commands, exchange.active_slots)
        exchange.finish_step(last, now_s)
        server.received = commands

    def _difference(self, recorded: dict[str, Any], present: dict[str, Any]) -> str:
        at = f"step {recorded['step'][0]} ({recorded['time'][0]})"
        names = {"values": self._manifest.names, "fault_free_values": self._manifest.names}
        actuators = [actuator.name for actuator in self._manifest.actuators]
        for name, value in recorded.items():
            if value == present.get(name):
                continue
            if name in ("late", "rejected") or not isinstance(value, bytes):
                return f"{at}: {name} is {present.get(name)!r}, recorded {value!r}"
            ours, theirs = np.frombuffer(present[name]), np.frombuffer(value)
            if ours.shape != theirs.shape:
                return f"{at}: {name} has another size"
            index = int(np.flatnonzero(ours.view(np.uint64) != theirs.view(np.uint64))[0])
            points = names.get(name, actuators)
            point = points[index % len(points)] if points and name != "source_index" else name
            return f"{at}: {point} is {float(ours[index])!r}, recorded {float(theirs[index])!r}"
        return f"{at}: the sample has other fields"

    # Messages of others

    def _on_message(self, topic: str, payload: bytes, encoding: str, following: list[RecordedItem]) -> None:
        kind, _, rest = topic.partition("/")
        if encoding == _RECORDED_REQUEST:
            self._on_request(rest, codec.decode(RecordedRequest, payload))
        elif kind == _COMMAND and not _is_rejected(rest, following):
            self._command(rest, payload, encoding)
        elif kind == _ACTUATOR:
            sender, _, name = rest.partition("/")
            if not _is_rejected(sender, following):
                self._write(sender, name, payload, encoding)

    def _command(self, sender: str, payload: bytes, encoding: str) -> None:
        intake, now_s = self._exchange.intake, monotonic()
        if self._server.injection is not None and self._server.injection.link.disturbs_commands:
            raise self._error("faults of its link delay or drop commands, which it does not contain")
        if not intake.accept_fast(sender, payload, now_s, encoding):
            intake.receive_command(sender, payload, now_s, encoding)

    def _write(self, sender: str, name: str, payload: bytes, encoding: str) -> None:
        with suppress(BadMessage):
            write = codec.decode(Write, payload, encoding).model_copy(update={"source": sender})
            self._exchange.intake.write(name, write, self._server.elapsed_s)

    def _on_request(self, topic: str, request: RecordedRequest) -> None:
        if request.reply_encoding == _ERROR:
            return  # it changed nothing
        name, _, rest = topic.partition("/")
        sender, _, point = rest.partition("/")
        if name == _name(keys.COMMAND_REQUEST):
            self._command(sender, request.payload, request.encoding)
        elif name == _name(keys.WRITE_REQUEST):
            self._write(sender, point, request.payload, request.encoding)
        elif (kind := _APPLIED.get(name)) is not None:
            message, sender_field = codec.decode_request(kind, request.payload), keys.sender_field(kind)
            self._apply(message.model_copy(update={sender_field: sender}) if sender_field else message)

    def _apply(self, message: Message) -> None:
        """Apply a request that was accepted."""
        server = self._server
        match message:
            case Claim():
                self._exchange.claim(message, monotonic())
            case SetPace() | Pause() | Resume() | StepRequest():
                server.pacing.apply(message)
            case FaultPlan():
                server.inject(message, server.injection)
            case Acknowledge() | Shelve() | Unshelve() | RemoveFromService() | ReturnToService():
                if server.alarms is not None:
                    server.alarms.request(message)

    def _on_event(self, event: Event) -> None:
        exchange, now_s, name = self._exchange, monotonic(), event.source
        if event.kind is EventKind.DISCONNECTED:
            exchange.fallback.on_disconnect(name, now_s)
        elif event.kind is EventKind.CONNECTED and event.text == f"{name} {RECONNECTED}":
            exchange.fallback.on_reconnect(name, now_s)
        elif event.kind is EventKind.FALLBACK and event.text.startswith(f"{name} {DISCONNECTED};"):
            exchange.fallback.bypass(name, now_s)
        elif event.kind is EventKind.FALLBACK:
            exchange.fallback.on_deadline(now_s)
        elif event.kind is EventKind.REVOKED:
            revoke(exchange, name)
        elif event.kind is EventKind.FAILED:
            exchange.transition(Trigger.FAIL)


def _name(topic: keys.Topic) -> str:
    return topic.key.split("/")[1]


_APPLIED: dict[str, type[Message]] = {
    _name(topic): topic.message
    for topic in (
        keys.CLAIM,
        keys.PACE,
        keys.PAUSE,
        keys.RESUME,
        keys.STEP,
        keys.FAULTS,
        keys.ACKNOWLEDGE,
        keys.SHELVE,
        keys.UNSHELVE,
        keys.REMOVE_FROM_SERVICE,
        keys.RETURN_TO_SERVICE,
    )
    if topic.message is not None
}
"""Classes of the requests that change what a node has besides its plant."""


def _with_following(items: Iterator[RecordedItem], count: int) -> Iterator[tuple[RecordedItem, list[RecordedItem]]]:
    """Yield each item with up to `count` items after it."""
    window: deque[RecordedItem] = deque()
    for item in items:
        window.append(item)
        if len(window) > count:
            yield window.popleft(), [*window]
    while window:
        yield window.popleft(), [*window]


def _is_rejected(sender: str, following: list[RecordedItem]) -> bool:
    """Return whether the message before these is one that the node rejected, also for a reason that is not recorded.

    The event of a message follows it at once; the event of a request precedes it.
    """
    if not following or following[0].schema != "Event":
        return False
    event = codec.decode(Event, following[0].payload)
    if event.kind is not EventKind.REJECTED or event.source != sender[:MAX_SOURCE_NAME]:
        return False
    request = following[1] if len(following) > 1 else None
    if request is None or request.schema != "RecordedRequest" or sender not in request.topic.split("/"):
        return True
    record = codec.decode(RecordedRequest, request.payload)
    if record.reply_encoding != _ERROR:
        return True
    return not event.text.endswith(codec.decode(ErrorReply, record.reply).message)


def _is_same_order(left: bytes, right: bytes) -> bool:
    """Return whether two orders are equal to the bit; any NaN is equal to any other, since both relinquish."""
    return left == right or (
        len(left) == len(right) and bool(equal_bits(np.frombuffer(left), np.frombuffer(right)).all())
    )
