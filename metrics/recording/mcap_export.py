"""Write a recording as an MCAP file of protobuf messages, which Foxglove and PlotJuggler plot.

A message per sample has all values as named fields, so `/office/episode_0001/points.core_zn_air_temperature` is a curve
in a plot panel; a channel per point would need a message, with its 31 bytes and its time, for every value.

Each episode has topics of its own: they cover the same simulated time, and would be one tangled curve. Both times of a
message are the simulated time, as PlotJuggler plots over the publish time and Foxglove over the log time; the wall
time is a field.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zenostat.metrics.labels import unused_name
from zenostat.metrics.recording.data import Recording
from zenostat.metrics.trajectory import Trajectory
from zenostat.topics import VERSION
from zenostat.topics.arrays import Floats
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.errors import InvalidRecording
from zenostat.topics.extras import import_extra
from zenostat.topics.messages import Event, EventKind
from zenostat.topics.printable import replace_controls
from zenostat.topics.recording import MANIFEST, SCENARIO

_FEATURE = "an MCAP file with protobuf messages"
_HEAD = (("timestamp", ".google.protobuf.Timestamp"), ("wall_time", ".google.protobuf.Timestamp"), ("step", "int64"))
_LOG = "foxglove.Log"
_LEVELS = ("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")
_ERRORS = (EventKind.FAILED,)
_WARNINGS = (
    EventKind.REJECTED, EventKind.LATE, EventKind.ACCEPTED_LATE, EventKind.WARNING, EventKind.FAULT, EventKind.FALLBACK,
)  # fmt: skip
_NS_PER_S = 1_000_000_000

Row = Callable[[int], bytes]
"""Returns the message of a row."""


@dataclass(frozen=True, slots=True)
class _Topic:
    """The messages of a topic, with the simulated time of each in nanoseconds, as if it were UTC."""

    channel: int
    times_ns: NDArray[np.int64]
    row: Row


def write_mcap(recording: Recording, path: str | Path) -> None:
    """Write all samples and events to an MCAP file with protobuf messages, in the order of their simulated times.

    The schema of each message is in the file. A channel's metadata has the unit of each field (`unit.FIELD`), and the
    name of the point where that is no protobuf identifier (`name.FIELD`).

    Raises:
        InvalidConfig: the extra `recording` is not installed.
        InvalidRecording: the recording has no samples.
    """
    if not recording.episodes:
        raise InvalidRecording(f"{recording.path} has no samples")
    mcap_writer = import_extra("mcap.writer", "recording", _FEATURE)
    messages = _Messages()
    with atomic_file(Path(path)) as temporary, temporary.open("wb") as file:
        writer = mcap_writer.Writer(file)
        writer.start(profile="", library=f"zenostat {VERSION}")
        manifest, name = recording.manifest, replace_controls(recording.path.name)  # which need not be UTF-8
        about = {"node": manifest.node, "building": manifest.building, "recording": name}
        writer.add_metadata("zenostat", about)
        writer.add_attachment(0, 0, MANIFEST, "application/json", manifest.model_dump_json(indent=1).encode())
        writer.add_attachment(0, 0, SCENARIO, "application/yaml", recording.scenario.encode())
        topics = [*_topics(recording, writer, messages)]
        times = np.concatenate([topic.times_ns for topic in topics])
        owners = np.repeat(np.arange(len(topics)), [len(topic.times_ns) for topic in topics])
        rows = np.concatenate([np.arange(len(topic.times_ns)) for topic in topics])
        for index in np.argsort(times, kind="stable").tolist():
            topic, time_ns = topics[owners[index]], int(times[index])
            writer.add_message(topic.channel, time_ns, topic.row(int(rows[index])), time_ns)
        writer.finish()


def _topics(recording: Recording, writer: Any, messages: _Messages) -> Iterator[_Topic]:
    manifest = recording.manifest
    points = [(point.name, point.unit) for point in manifest.points]
    actuators = [(actuator.name, actuator.unit) for actuator in manifest.actuators]
    schemas = {
        name: _Schema(messages.numbers(name, fields, kind), fields, writer)
        for name, fields, kind in (
            ("zenostat.Points", points, "double"),
            ("zenostat.Actuators", actuators, "double"),
            ("zenostat.Sources", [(name, "") for name, _ in actuators], "string"),
        )
    }
    log = _Schema(messages.log(), [], writer)
    for episode in recording.episodes:
        root = f"/{manifest.node}/episode_{episode.number:04}" + (f"/slot_{episode.slot}" if manifest.slots > 1 else "")
        times_ns = episode.time.astype("datetime64[ns]").astype(np.int64)
        assert episode.wall_time is not None
        wall_ns = episode.wall_time.astype("datetime64[ns]").astype(np.int64)

        def topic(
            name: str, schema: str, table: Sequence[Any] | NDArray[Any],
            root: str = root, times_ns: Any = times_ns, wall_ns: Any = wall_ns, steps: Any = episode.step,
        ) -> _Topic:  # fmt: skip
            chosen = schemas[schema]
            return _Topic(chosen.channel(f"{root}/{name}"), times_ns, chosen.rows(times_ns, wall_ns, steps, table))

        for name, table in _point_tables(episode):
            yield topic(name, "zenostat.Points", table)
        if actuators:
            for name, table in _actuator_tables(episode):
                yield topic(name, "zenostat.Actuators", table)
            yield topic("sources", "zenostat.Sources", np.array(episode.sources, object)[episode.source_index])
        if episode.slot == 0:
            events = [(moment, event) for moment, event in recording.events if event.episode == episode.number]
            if events:
                step_ns = round(manifest.step_s * _NS_PER_S)
                begin_ns = np.datetime64(manifest.begin, "ns").astype(np.int64)
                at_ns = np.array([begin_ns + event.step * step_ns for _, event in events], np.int64)
                yield _Topic(log.channel(f"{root}/events"), at_ns, _log_rows(log.message, at_ns, events))


def _point_tables(episode: Trajectory) -> Iterator[tuple[str, Floats]]:
    yield "points", episode.values
    if episode.fault_free_values is not episode.values:
        yield "fault_free", episode.fault_free_values
    if episode.baseline is not None:
        yield "baseline", episode.baseline


def _actuator_tables(episode: Trajectory) -> Iterator[tuple[str, Floats]]:
    yield "effective", episode.effective
    if episode.orders is not None:
        yield "orders", episode.orders
    if episode.baseline_effective is not None:
        yield "baseline_effective", episode.baseline_effective


def field_names(names: Sequence[str]) -> list[str]:
    """Return protobuf identifiers for names of points, unique and other than those of the fields before them."""
    used, fields = {name for name, _ in _HEAD}, []
    for name in names:
        plain = re.sub(r"\W", "_", name, flags=re.ASCII)
        plain = f"_{plain}" if plain[0].isdigit() else plain
        field = unused_name(plain, used)
        used.add(field)
        fields.append(field)
    return fields


class _Messages:
    """Creates classes of messages that no .proto file describes."""

    def __init__(self) -> None:
        self.descriptors = import_extra("google.protobuf.descriptor_pb2", "recording", _FEATURE)
        pools = import_extra("google.protobuf.descriptor_pool", "recording", _FEATURE)
        self._factory = import_extra("google.protobuf.message_factory", "recording", _FEATURE)
        timestamp = import_extra("google.protobuf.timestamp_pb2", "recording", _FEATURE)
        self._timestamp = self.descriptors.FileDescriptorProto()
        timestamp.DESCRIPTOR.CopyToProto(self._timestamp)
        self._pool = pools.DescriptorPool()
        self._pool.Add(self._timestamp)

    def numbers(self, name: str, fields: Sequence[tuple[str, str]], kind: str) -> _MessageClass:
        """Return a message with a time, a step and a field for each name.

        Fields have presence (proto2), so that a zero is written: a decoder may leave out what is not there.
        """
        file, message = self._file(name, "proto2")
        for number, (field, field_kind) in enumerate(
            (*_HEAD, *((field, kind) for field in field_names([name for name, _ in fields]))), 1
        ):
            self._add_field(message, field, number, field_kind)
        return self._create(file, name)

    def log(self) -> _MessageClass:
        """Return the message that Foxglove's panel of logs shows."""
        file, message = self._file(_LOG, "proto3")
        level = file.enum_type.add(name="LogLevel")
        for number, text in enumerate(_LEVELS):
            level.value.add(name=text, number=number)
        fields = (
            ("timestamp", _HEAD[0][1]), ("level", ".foxglove.LogLevel"), ("message", "string"), ("name", "string"),
            ("file", "string"), ("line", "uint32"),
        )  # fmt: skip
        for number, (field, kind) in enumerate(fields, 1):
            self._add_field(message, field, number, kind)
        return self._create(file, _LOG)

    def _file(self, name: str, syntax: str) -> tuple[Any, Any]:
        package, _, message = name.partition(".")
        file = self.descriptors.FileDescriptorProto(
            name=f"{package}/{message}.proto", package=package, dependency=[self._timestamp.name]
        )
        if syntax != "proto2":  # the default, which must not be set
            file.syntax = syntax
        return file, file.message_type.add(name=message)

    def _add_field(self, message: Any, name: str, number: int, kind: str) -> None:
        field = self.descriptors.FieldDescriptorProto
        added = message.field.add(name=name, number=number, label=field.LABEL_OPTIONAL)
        if kind.startswith("."):
            added.type_name = kind
            added.type = field.TYPE_ENUM if kind.endswith("Level") else field.TYPE_MESSAGE
        else:
            added.type = getattr(field, f"TYPE_{kind.upper()}")

    def _create(self, file: Any, name: str) -> _MessageClass:
        self._pool.Add(file)
        files = self.descriptors.FileDescriptorSet(file=[self._timestamp, file])
        message = self._factory.GetMessageClass(self._pool.FindMessageTypeByName(name))
        return _MessageClass(name, message, files.SerializeToString())


@dataclass(frozen=True, slots=True)
class _MessageClass:
    name: str
    message: Any
    schema: bytes


class _Schema:
    """A schema of the file, and its channels; `fields` are the names and units of the points."""

    def __init__(self, message_class: _MessageClass, fields: Sequence[tuple[str, str]], writer: Any) -> None:
        self.message, self._writer = message_class.message, writer
        self._id = writer.register_schema(message_class.name, "protobuf", message_class.schema)
        self._fields = field_names([name for name, _ in fields])
        self._metadata = {
            f"unit.{field}": unit for field, (_, unit) in zip(self._fields, fields, strict=True) if unit
        } | {f"name.{field}": name for field, (name, _) in zip(self._fields, fields, strict=True) if field != name}

    def channel(self, topic: str) -> int:
        number: int = self._writer.register_channel(topic, "protobuf", self._id, self._metadata)
        return number

    def rows(self, times_ns: Any, wall_ns: Any, steps: Any, table: Any) -> Row:
        fields, message = self._fields, self.message

        def row(index: int) -> bytes:
            values = dict(zip(fields, table[index].tolist(), strict=True))
            built = message(step=int(steps[index]), **values)
            _set_time(built.timestamp, int(times_ns[index]))
            _set_time(built.wall_time, int(wall_ns[index]))
            raw: bytes = built.SerializeToString()
            return raw

        return row


def _log_rows(message: Any, at_ns: Any, events: Sequence[tuple[datetime, Event]]) -> Row:
    def row(index: int) -> bytes:
        _, event = events[index]
        level = "ERROR" if event.kind in _ERRORS else "WARNING" if event.kind in _WARNINGS else "INFO"
        built = message(
            level=_LEVELS.index(level), message=f"{event.kind.replace('_', ' ')}: {event.text}", name=event.source
        )
        _set_time(built.timestamp, int(at_ns[index]))
        raw: bytes = built.SerializeToString()
        return raw

    return row


def _set_time(field: Any, time_ns: int) -> None:
    field.seconds, field.nanos = divmod(time_ns, _NS_PER_S)
