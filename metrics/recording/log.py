"""The audit log of a recording: who requested what, when, and with which result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import msgpack

from zenostat.bridge.exchange.state import MAX_SOURCE_NAME
from zenostat.topics import codec, keys
from zenostat.topics.errors import BadMessage
from zenostat.topics.messages import REJECTIONS, AlarmTransition, ErrorReply, Event, EventKind
from zenostat.topics.printable import replace_controls
from zenostat.topics.recording import RecordedMessage, RecordedRequest, RecordedSender

if TYPE_CHECKING:
    from zenostat.bridge.recording.reader import RecordedItem

_COMMAND, _ACTUATOR = (topic.key.partition("{")[0] for topic in (keys.COMMAND, keys.ACTUATOR))
_ACCEPTED, _ALARM = "accepted", "alarm"
_OUTCOMES = (*REJECTIONS, EventKind.WRITTEN, EventKind.ACCEPTED_LATE)
_REQUESTED = (
    AlarmTransition.ACKNOWLEDGE,
    AlarmTransition.SHELVE,
    AlarmTransition.UNSHELVE,
    AlarmTransition.REMOVE_FROM_SERVICE,
    AlarmTransition.RETURN_TO_SERVICE,
)
_HIDDEN = ("controller", "source", "values", "operations", "episode")
_ERROR = codec.encoding(ErrorReply)

_MAX_SUBJECT = 500
"""Largest number of characters of a subject: a message that was rejected can have megabytes."""


@dataclass(slots=True)
class LogEntry:
    """A command, a write or a request, and its result; or a transition of an alarm.

    Attributes:
        time: UTC at which the node received it.
        simulated: Simulated time of the node's latest sample; empty before the first one.
        source: Name of the sender, as in the key of its message; empty for an alarm.
        kind: `command`, `write`, or the request: `claim`, `reset`, `pause`; or `alarm`.
        subject: The point that was written, what was requested, or what the alarm reports.
        result: `accepted`, or the reason why not; of an alarm, its new state.
        count: Number of consecutive accepted commands that the entry stands for.
        proven: Name in the certificate that proves the sender's name, which is that or below it (of a gateway's client,
            the gateway's); empty if nothing proves it.
        via: Way in to the bus: `zenoh`, or the protocol of a gateway; empty for an alarm, and if it was not recorded.
    """

    time: datetime
    simulated: str
    source: str
    kind: str
    subject: str
    result: str = _ACCEPTED
    count: int = 1
    proven: str = ""
    via: str = ""

    @property
    def is_accepted(self) -> bool:
        """Whether the node accepted it; an alarm is nothing that it could reject."""
        return self.kind == _ALARM or self.result.startswith(_ACCEPTED)


class LogBuilder:
    """Builds the log from messages in the order of the recording.

    Consecutive accepted commands of a controller are one entry. The result of a message without a reply is that of the
    event which follows it at once.
    """

    def __init__(self) -> None:
        self._entries: list[LogEntry] = []
        self._awaiting: LogEntry | None = None
        self._commands: dict[str, LogEntry] = {}
        self._latest: dict[str, LogEntry] = {}
        self._place = 0
        self._senders: dict[str, tuple[str, str]] = {}

    def add_event(self, event: Event, time_ns: int) -> None:
        """Take the result of the latest message from an event, or add the transition of an alarm."""
        if event.alarm is not None:
            alarm = event.alarm
            if alarm.transition in _REQUESTED:  # the request has an entry of its own
                return
            self._entries.append(LogEntry(_utc(time_ns), alarm.time, "", _ALARM, event.text, str(alarm.state)))
            return
        entry, self._awaiting = self._awaiting, None
        if (
            entry is None
            or event.kind not in _OUTCOMES
            or (event.source and event.source != entry.source[:MAX_SOURCE_NAME])
        ):
            return
        if entry.kind == "command":
            entry = self._separate(entry)
        if event.kind is EventKind.WRITTEN:
            entry.subject = event.text
        elif event.kind is EventKind.ACCEPTED_LATE:
            entry.result = f"accepted: {event.text}"
        else:
            entry.result = f"{event.kind}: {event.text}"

    def add(self, item: RecordedItem, simulated: str) -> None:
        """Add a received message; `simulated` is the time of the latest sample."""
        self._awaiting = None
        if item.schema == RecordedSender.__name__:
            sender = codec.decode(RecordedSender, item.payload)
            self._senders[sender.sender] = (sender.proven, sender.via)
            return
        topic, payload, encoding = item.topic, item.payload, ""
        if item.schema == RecordedMessage.__name__:
            message = codec.decode(RecordedMessage, payload)
            topic, payload, encoding = message.topic, message.payload, message.encoding
        is_request = RecordedRequest.__name__ in (item.schema, encoding.rpartition(".")[2])
        if is_request:
            self._add_request(topic, codec.decode(RecordedRequest, payload), item.time_ns, simulated)
        elif topic.startswith((_COMMAND, _ACTUATOR)):
            self._add_message(topic, payload, item.time_ns, simulated)

    def _add_message(self, topic: str, payload: bytes, time_ns: int, simulated: str) -> None:
        sender, _, name = topic.partition("/")[2].partition("/")
        if topic.startswith(_COMMAND):
            self._add_command(sender, payload, time_ns, simulated)
            self._awaiting = self._commands[sender]
            return
        entry = self._entry(time_ns, simulated, sender, "write", _write_text(name, _fields(payload)))
        self._entries.append(entry)
        self._awaiting = entry

    def _add_command(self, name: str, payload: bytes, time_ns: int, simulated: str) -> None:
        fields = _fields(payload)
        self._place = len(self._entries)
        latest = self._latest[name] = self._entry(time_ns, simulated, name, "command", _answer_text(fields))
        entry = self._commands.get(name)
        if entry is None or (entry.proven, entry.via) != (latest.proven, latest.via):
            self._commands[name] = replace(latest)
            self._entries.append(self._commands[name])
        else:
            entry.count += 1

    def _separate(self, entry: LogEntry) -> LogEntry:
        """Return an entry of its own for the latest command of a controller, which was not plainly accepted."""
        del self._commands[entry.source]
        if entry.count == 1:
            return entry
        entry.count -= 1
        latest = self._latest[entry.source]
        self._entries.insert(self._place, latest)  # an alarm may have come between the command and its result
        return latest

    def _add_request(self, topic: str, request: RecordedRequest, time_ns: int, simulated: str) -> None:
        _, kind, *names = topic.split("/")
        source = names[0] if names else ""
        fields = _fields(request.payload)
        if kind == "write":
            subject = _write_text("".join(names[1:]), fields)
        elif kind == "command":
            subject = _answer_text(fields)
        else:
            subject = replace_controls(
                ", ".join(f"{key} {value}" for key, value in fields.items() if _is_shown(key, value))
            )
        entry = self._entry(time_ns, simulated, source, kind, subject)
        entry.result = _reply_text(request)
        self._entries.append(entry)

    def _entry(self, time_ns: int, simulated: str, source: str, kind: str, subject: str) -> LogEntry:
        proven, via = self._senders.get(source, ("", ""))
        if (length := len(subject)) > _MAX_SUBJECT:
            subject = f"{subject[:_MAX_SUBJECT]}… ({length:,} characters)"
        return LogEntry(_utc(time_ns), simulated, source, kind, subject, proven=proven, via=via)

    def finish(self) -> tuple[LogEntry, ...]:
        """Return all entries in the order of the recording, which a clock that is set back does not change."""
        return tuple(self._entries)


def _utc(time_ns: int) -> datetime:
    return datetime.fromtimestamp(time_ns / 1e9, UTC)


def _fields(payload: bytes) -> Mapping[str, Any]:
    """Return the fields of a message that need not be valid; empty if it cannot be read."""
    try:
        fields = msgpack.unpackb(payload)
    except Exception:  # msgpack raises a dozen unrelated classes on malformed input
        return {}
    return fields if isinstance(fields, dict) else {}


def _is_shown(key: str, value: Any) -> bool:
    return key not in _HIDDEN and value not in (None, "", [], {}, False)


def _answer_text(fields: Mapping[str, Any]) -> str:
    return replace_controls(f"answers step {fields.get('step', '?')} of episode {fields.get('episode', '?')}")


def _write_text(name: str, fields: Mapping[str, Any]) -> str:
    value, priority = fields.get("value"), fields.get("priority", 8)
    text = f"{name} relinquished" if value is None else f"{name} = {value}"
    duration = f" for {fields['duration_s']:g} s" if isinstance(fields.get("duration_s"), int | float) else ""
    return replace_controls(f"{text} at priority {priority}{duration}")


def _reply_text(request: RecordedRequest) -> str:
    if request.reply_encoding != _ERROR:
        return _ACCEPTED
    try:
        reply = codec.decode(ErrorReply, request.reply, request.reply_encoding)
    except BadMessage:
        return "rejected"
    return f"{reply.error}: {reply.message}"
