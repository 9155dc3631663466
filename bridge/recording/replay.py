"""Publish a recording under its node's keys, so that monitors, gateways and subscribers see the building again."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from datetime import datetime
from time import monotonic

import zenoh
from zenoh.handlers import Callback

from zenostat.bridge.node.names import check_name_is_free
from zenostat.bridge.node.publications import Publications
from zenostat.bridge.recording.checked_messages import decode
from zenostat.bridge.recording.reader import RecordedItem, RecordingReader
from zenostat.bridge.runtime.timer import Timer
from zenostat.topics import codec, errors, keys
from zenostat.topics.errors import BadMessage, InvalidConfig, PeerError, RequestRejected
from zenostat.topics.messages import (
    ErrorReply,
    Event,
    Geometry,
    Manifest,
    Message,
    Mode,
    Policy,
    Sample,
    ScenarioText,
    SemanticModel,
    State,
    Status,
    Systems,
)
from zenostat.topics.printable import replace_controls

_SCHEMAS = frozenset(("Sample", "Event", "Manifest"))

_LONGEST_WAIT_S = 60.0
"""Longest time between two messages that is repeated, in s, unless the timesteps of a paced node take longer."""


@dataclass(frozen=True, slots=True)
class ReplayRange:
    """The part of a recording to replay, in simulated time of slot 0; None: from its begin, to its end."""

    begin: datetime | None = None
    end: datetime | None = None

    def contains(self, time: datetime) -> bool:
        """Return whether a sample at that time is replayed."""
        return (self.begin is None or time >= self.begin) and (self.end is None or time <= self.end)


class Replay:
    """A recording on the bus as a node that takes no requests; `with Replay(reader, session) as replay`.

    Args:
        reader: of the recording; the caller closes it.
        session: the Zenoh session; the caller closes it.
        name: of the node on the bus; None is that of the recorded node.
        speed: simulated seconds per second; None: as in the recording, with long pauses cut to a minute.
        selected: the part to replay.
        semantic: returns the semantic model of the recorded building as Turtle for the name of a node, or raises a
            `ZenostatError` that says why there is none; called once, in a thread of its own, when it is asked for.

    Raises (on entering):
        NameInUse: a node of that name is on the bus.
    """

    def __init__(
        self,
        reader: RecordingReader,
        session: zenoh.Session,
        *,
        name: str | None = None,
        speed: float | None = None,
        selected: ReplayRange | None = None,
        semantic: Callable[[str], str] | None = None,
    ) -> None:
        self._reader, self._session, self._speed = reader, session, speed
        self._selected = selected or ReplayRange()
        self._name = keys.check_name(name or reader.manifest.node, "the node's name")
        self._instance = str(session.zid())
        self.manifest = self._renamed(reader.manifest)
        self._payload = b""
        self._sample: Sample | None = None
        self._semantic, self._semantic_model = semantic, b""
        self._close = ExitStack()

    def _renamed(self, manifest: Manifest) -> Manifest:
        paced = {"mode": Mode.PACED, "speed": self._speed or manifest.speed}
        no_history = {"history_samples": 0, "history_bytes": 0}
        own = {"node": self._name, "instance": self._instance, "replay": True}
        return manifest.model_copy(update={**own, **paced, **no_history})

    def __enter__(self) -> Replay:
        check_name_is_free(self._session, self._name)
        with ExitStack() as undo:
            undo.callback(self._close.close)
            timer = Timer()
            self._close.callback(timer.close)
            self._publications = self._close.enter_context(Publications(self._session, self.manifest, timer))
            worker = ThreadPoolExecutor(1, "semantic")
            self._close.callback(worker.shutdown, cancel_futures=True)
            for topic in (keys.MANIFEST, keys.SAMPLE, *(t for t in keys.TOPICS if t.delivery is keys.Delivery.QUERY)):
                self._declare(topic, worker if topic is keys.SEMANTIC else None)
            token = keys.NODE_TOKEN.at(self._name, name=self._instance)
            self._close.enter_context(self._session.liveliness().declare_token(token))
            undo.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._close.close()

    # Requests

    def _declare(self, topic: keys.Topic, worker: ThreadPoolExecutor | None) -> None:
        """Answer the queries on a topic; `worker` computes the semantic model, which takes a while."""

        def reply(query: zenoh.Query) -> None:
            with query:
                try:
                    kind, payload = self._reply(topic, query)
                except PeerError as error:
                    kind, payload = ErrorReply, codec.encode(ErrorReply(**errors.to_wire(error)))
                sender, name = topic.chunks_in(str(query.key_expr))
                key = topic.at(self._name, name=name, sender=sender)
                with suppress(zenoh.ZError):  # nothing that a stranger asks shall end the replay
                    query.reply(key, payload, encoding=zenoh.Encoding(codec.encoding(kind)))

        def on_query(query: zenoh.Query) -> None:
            if worker is not None:
                worker.submit(reply, query)
            else:
                reply(query)

        key = topic.everywhere(self._name)
        queryable = self._session.declare_queryable(key, Callback(on_query, indirect=False), complete=True)
        self._close.callback(queryable.undeclare)

    def _reply(self, topic: keys.Topic, query: zenoh.Query) -> tuple[type[Message], bytes]:
        """Return class and payload of the reply.

        Raises:
            PeerError: the query is not valid, or a replay has no answer.
        """
        payload = query.payload.to_bytes() if query.payload is not None else b""
        if topic in (keys.MANIFEST, keys.SAMPLE):
            if payload:
                raise BadMessage(f"{len(payload)} bytes; a query on {topic.key} has no payload")
            return self._latest(topic)
        if topic.message is not None:
            codec.decode_request(topic.message, payload, str(query.encoding or ""))
        return self._answer(topic)

    def _latest(self, topic: keys.Topic) -> tuple[type[Message], bytes]:
        if topic is keys.MANIFEST:
            return Manifest, codec.encode(self.manifest)
        if not self._payload:
            raise RequestRejected(f"{self._name} has not replayed a sample yet")
        return Sample, self._payload

    def _answer(self, topic: keys.Topic) -> tuple[type[Message], bytes]:
        if topic is keys.STATUS:
            return Status, codec.encode(self._status())
        if topic is keys.SCENARIO:
            return ScenarioText, codec.encode(ScenarioText(text=self._reader.scenario))
        if topic is keys.GEOMETRY and self._reader.geometry is not None:
            return Geometry, codec.encode(self._reader.geometry)
        if topic is keys.SYSTEMS and self._reader.systems is not None:
            return Systems, codec.encode(self._reader.systems)
        if topic is keys.SEMANTIC and self._semantic is not None:
            return SemanticModel, self._encoded_semantic(self._semantic)
        raise RequestRejected(f"{self._name} is the replay of a recording and takes no requests")

    def _encoded_semantic(self, semantic: Callable[[str], str]) -> bytes:
        if not self._semantic_model:
            try:
                text = semantic(self._name)
            except errors.ZenostatError as error:
                raise RequestRejected(str(error)) from None
            self._semantic_model = codec.encode(SemanticModel(text=text))
        return self._semantic_model

    def _status(self) -> Status:
        manifest, sample = self.manifest, self._sample
        slots = manifest.slots
        return Status(
            node=self._name,
            state=State.RUNNING,
            building=manifest.building,
            weather=manifest.weather,
            mode=Mode.PACED,
            speed=manifest.speed,
            policy=Policy.WAIT,
            episode=[0] * slots if sample is None else sample.episode,
            step=[0] * slots if sample is None else sample.step,
            steps=manifest.steps,
            time=[manifest.begin] * slots if sample is None else sample.time,
            controllers=[],
            accepted=0,
            rejected=0,
            late=0,
            duplicate=0,
        )

    # Messages

    def run(self, stop: threading.Event, progress: Callable[[str, int], None] = lambda _time, _step: None) -> int:
        """Publish the selected part; return the number of samples.

        Args:
            stop: ends the replay early when it is set.
            progress: called with the simulated time and the step after each sample.

        Raises:
            InvalidConfig: the selected part has no sample.
        """
        count, due_s = 0, monotonic()
        for wait_s, item, sample in self._schedule():
            due_s += wait_s
            if stop.wait(max(due_s - monotonic(), 0.0)):
                return count
            self._publish(item, sample)
            if sample is not None:
                count += 1
                progress(replace_controls(sample.time[0]), sample.step[0])
        if not count:
            selection = "" if self._selected == ReplayRange() else " in the selected time"
            raise InvalidConfig(f"{self._reader.path} has no samples{selection}")
        return count

    def _schedule(self) -> Iterator[tuple[float, RecordedItem, Sample | None]]:
        """Yield the time in seconds to wait before each message of the selected part, the message, and its sample."""
        previous_ns, previous = 0, (-1, 0.0)
        is_selected, longest_s = self._selected.begin is None, _longest_wait_s(self._reader.manifest)
        for item in self._reader.messages(_SCHEMAS):
            wait_s, sample = 0.0, None
            if item.schema == "Sample":
                sample = decode(self._reader, Sample, item)
                is_selected = self._selected.contains(datetime.fromisoformat(sample.time[0]))
                present = sample.episode[0], sample.elapsed_s[0]
                if self._speed is not None and present[0] == previous[0] and is_selected:
                    wait_s = max(present[1] - previous[1], 0.0) / self._speed
                previous = present
            elif item.schema == "Manifest":
                longest_s = _longest_wait_s(decode(self._reader, Manifest, item))
            if not is_selected:
                continue
            if self._speed is None and previous_ns:
                wait_s = min(max(item.time_ns - previous_ns, 0) / 1e9, longest_s)
            previous_ns = item.time_ns
            yield wait_s, item, sample

    def _publish(self, item: RecordedItem, sample: Sample | None) -> None:
        if sample is not None:
            self._payload, self._sample = item.payload, sample
            self._publications.sample(item.payload)
            time = datetime.fromisoformat(sample.time[0])
            self._publications.points.publish(sample.values, sample.episode[0], sample.step[0], time)
        elif item.schema == "Event":
            with suppress(errors.BadMessage):
                self._publications.event(codec.decode(Event, item.payload))
        else:
            self.manifest = self._renamed(decode(self._reader, Manifest, item))
            self._publications.manifest(self.manifest)


def _longest_wait_s(manifest: Manifest) -> float:
    """Return the longest time between two messages that is repeated, in s.

    Messages may be further apart because nobody stepped the node, because another node went on with the recording, or
    because the clock of the machine was set.
    """
    timestep_s = manifest.step_s / manifest.speed if manifest.mode is Mode.PACED and manifest.speed else 0.0
    return max(_LONGEST_WAIT_S, 2.0 * timestep_s)
