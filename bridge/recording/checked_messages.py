"""Messages of a recording, checked against its manifest: a reader of them needs no further checks of shapes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from zenostat.topics import codec
from zenostat.topics.errors import BadMessage, InvalidRecording
from zenostat.topics.messages import Manifest, Message, Sample
from zenostat.topics.recording import RecordedEpisode, RecordedOrder, RecordedSnapshot

if TYPE_CHECKING:
    from zenostat.bridge.recording.reader import RecordedItem, RecordingReader

M = TypeVar("M", bound=Message)


def decode(reader: RecordingReader, kind: type[M], item: RecordedItem) -> M:
    """Return a message of a recording.

    Args:
        reader: of the recording.
        kind: class of the message.
        item: as it was read.

    Raises:
        InvalidRecording: it is not valid, or its lists and arrays do not have the sizes of the recording's node.
    """
    try:
        message = codec.decode(kind, item.payload)
        if (check := _CHECKS.get(kind)) is not None:
            check(message, reader.manifest)
    except BadMessage as error:
        raise InvalidRecording(f"{reader.path} is damaged: {item.topic}: {error}") from None
    return message


def _check_sample(sample: Sample, manifest: Manifest) -> None:
    slots, points, actuators = manifest.slots, len(manifest.names), len(manifest.actuators)
    _check_lengths(sample, ("episode", "step", "time", "elapsed_s", "flags"), slots)
    values, effective = 8 * slots * points, 8 * slots * actuators
    _check_sizes(sample, ("values",), values)
    _check_sizes(sample, ("effective",), effective)
    _check_sizes(sample, ("source_index",), 2 * slots * actuators)
    _check_sizes(sample, ("fault_free_values", "baseline"), values, or_empty=True)
    _check_sizes(sample, ("commanded", "baseline_effective"), effective, or_empty=True)
    if sample.source_index and int(np.frombuffer(sample.source_index, codec.INDEX).max()) >= len(sample.sources):
        raise BadMessage(f"source_index refers to more than its {len(sample.sources)} sources")
    for text in sample.time:
        try:
            datetime.fromisoformat(text)
        except ValueError:
            raise BadMessage(f"time: {text[:40]!r} is no date and time") from None


def _check_order(order: RecordedOrder, manifest: Manifest) -> None:
    _check_slots(order.slots, manifest)
    _check_sizes(order, ("values",), 8 * manifest.slots * len(manifest.actuators))


def _check_episode(record: RecordedEpisode, manifest: Manifest) -> None:
    _check_slots(record.slots, manifest)
    _check_lengths(record, ("episode", "step", "seeds", "weather"), len(record.slots))
    if record.inputs:
        _check_lengths(record, ("inputs",), len(record.slots))


def _check_snapshot(record: RecordedSnapshot, manifest: Manifest) -> None:
    _check_lengths(record, ("episode", "step"), manifest.slots)


def _check_slots(slots: Sequence[int], manifest: Manifest) -> None:
    if not slots or len({*slots}) < len(slots) or max(slots) >= manifest.slots:
        raise BadMessage(f"slots: {[*slots][:10]} are no slots of a node that has {manifest.slots}")


def _check_lengths(message: Message, names: Sequence[str], length: int) -> None:
    for name in names:
        if len(getattr(message, name)) != length:
            raise BadMessage(f"{name} has {len(getattr(message, name))} entries; {length} expected")


def _check_sizes(message: Message, names: Sequence[str], size: int, *, or_empty: bool = False) -> None:
    for name in names:
        raw = getattr(message, name)
        if len(raw) != size and (raw or not or_empty):
            raise BadMessage(f"{name} has {len(raw)} bytes; {size} expected")


_CHECKS: dict[type[Message], Callable[[Any, Manifest], None]] = {
    Sample: _check_sample,
    RecordedOrder: _check_order,
    RecordedEpisode: _check_episode,
    RecordedSnapshot: _check_snapshot,
}
