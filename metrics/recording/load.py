"""Read a recording into arrays."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgpack
import numpy as np
from numpy.typing import NDArray

from zenostat.metrics.episode_weather import EpisodeWeather, read_weather
from zenostat.metrics.recording.data import Recording
from zenostat.metrics.recording.log import LogBuilder, LogEntry
from zenostat.metrics.trajectory import Trajectory
from zenostat.topics import codec
from zenostat.topics.errors import BadMessage, InvalidRecording
from zenostat.topics.extras import requires_extra
from zenostat.topics.messages import Event, Manifest
from zenostat.topics.printable import replace_controls
from zenostat.topics.recording import RecordedEpisode, RecordedWeather

if TYPE_CHECKING:
    from zenostat.bridge.recording.reader import RecordedItem, RecordingReader

_SCHEMAS = frozenset(("Sample", "RecordedOrder", "RecordedEpisode", "RecordedWeather"))


def load(path: str | Path) -> Recording:
    """Read a recording.

    A file that ends early, because its node was killed or is still running, is read up to its last chunk, with a
    warning; `Recording.note` has the reason.

    Args:
        path: Of a file that `record=`, `zenostat node --record` or `zenostat record` created.

    Raises:
        InvalidConfig: The extra `recording` is not installed.
        InvalidRecording: The file is not a recording, of a newer release, or damaged.
    """
    events: list[tuple[datetime, Event]] = []
    log = LogBuilder()

    def add(item: RecordedItem, simulated: str) -> None:
        if item.schema == "Event":
            event = codec.decode(Event, item.payload)
            events.append((datetime.fromtimestamp(item.time_ns / 1e9, UTC), event))
            log.add_event(event, item.time_ns)
        else:
            log.add(item, simulated)

    with _open(path) as reader:
        episodes = sorted(read_trajectories(reader, add), key=lambda episode: (episode.number, episode.slot))
        end = reader.end
        if end.text:
            warnings.warn(f"{path}: {end.text}", stacklevel=2)
        return Recording(
            path=Path(path),
            manifest=reader.manifest,
            scenario=reader.scenario,
            provenance=reader.provenance,
            episodes=_of_one_table(episodes),
            events=tuple(events),
            log=log.finish(),
            is_complete=end.is_complete,
            note=end.text,
        )


def load_log(path: str | Path) -> tuple[LogEntry, ...]:
    """Read only the log of a recording, without its values in memory; the same as `load(path).log`.

    Raises:
        InvalidConfig: As for `load`.
        InvalidRecording: As for `load`; samples are not checked.
    """
    log, sample = LogBuilder(), b""
    with _open(path) as reader, _damage_named(reader):
        for item in reader.messages():
            if item.schema == "Sample":
                sample = item.payload
            elif item.schema == "Event":
                log.add_event(codec.decode(Event, item.payload), item.time_ns)
            elif item.schema not in _SCHEMAS:
                log.add(item, _simulated(msgpack.unpackb(sample)) if sample else "")
        if reader.end.text:
            warnings.warn(f"{path}: {reader.end.text}", stacklevel=2)
    return log.finish()


def _open(path: str | Path) -> RecordingReader:
    with requires_extra("recording", "a recording", "mcap and zstandard"):
        from zenostat.bridge.recording.reader import RecordingReader
    return RecordingReader(path)


@contextmanager
def _damage_named(reader: RecordingReader) -> Iterator[None]:
    """Raise what a message that cannot be read causes as an `InvalidRecording`."""
    try:
        yield
    except (BadMessage, LookupError, TypeError, ValueError) as error:
        raise InvalidRecording(f"{reader.path} is damaged: a message cannot be read ({error})") from None


def _simulated(sample: Mapping[str, Any]) -> str:
    """Return the simulated time of slot 0 of a sample's fields."""
    return replace_controls(sample["time"][0])


def _of_one_table(episodes: list[Trajectory]) -> tuple[Trajectory, ...]:
    """Return the episodes with the same sources, and with fault-free values if any of them has some."""
    sources = max((episode.sources for episode in episodes), key=len, default=())
    has_faults = any(episode.fault_free_values is not episode.values for episode in episodes)
    return tuple(
        replace(
            episode, sources=sources,
            fault_free_values=episode.fault_free_values[:] if has_faults else episode.values,
        )
        for episode in episodes
    )  # fmt: skip


def read_trajectories(
    reader: RecordingReader, add: Callable[[RecordedItem, str], None] | None = None
) -> Iterator[Trajectory]:
    """Iterate over the episodes of each slot, as soon as their last sample has been read.

    `sources` of an episode are those of the recording up to its end.

    Args:
        reader: Of the recording.
        add: Called with each message that is not part of a trajectory, and the simulated time of the latest sample.

    Raises:
        InvalidRecording: The recording is damaged.
    """
    division = _Division(reader.manifest)
    with _damage_named(reader):
        for item in reader.messages(_SCHEMAS if add is None else None):
            if item.schema in _SCHEMAS:
                yield from division.add(item)
            elif add is not None:
                add(item, division.time)
        yield from division.finish()


class _Division:
    """Divides samples into the episodes of each slot.

    Attributes:
        time: Simulated time of the latest sample, slot 0.
    """

    def __init__(self, manifest: Manifest) -> None:
        self._manifest, self.time = manifest, ""
        points, actuators = len(manifest.names), len(manifest.actuators)
        self._widths = {"values": points, "effective": actuators}
        if manifest.baseline:
            self._widths |= {"baseline": points, "baseline_effective": actuators}
        self._relinquished = np.full((manifest.slots, actuators), np.nan).tobytes()
        self._order: bytes | None = None
        self._sources: dict[str, int] = {"": 0}
        self._mapping: tuple[list[str], NDArray[np.uint16]] = ([], np.empty(0, np.uint16))
        self._starts: dict[tuple[int, int], dict[str, Any]] = {}
        self._weathers: dict[tuple[int, int], EpisodeWeather] = {}
        self._running: dict[int, _Episode] = {}

    def add(self, item: RecordedItem) -> Iterator[Trajectory]:
        """Add a message; return the episodes that ended before it."""
        if item.schema == "Sample":
            yield from self._add_sample(item.time_ns, msgpack.unpackb(item.payload))
        elif item.schema == "RecordedOrder":
            self._order = msgpack.unpackb(item.payload)["values"]
        elif item.schema == "RecordedEpisode":
            record = codec.decode(RecordedEpisode, item.payload)
            for slot, number, seed, weather in zip(
                record.slots, record.episode, record.seeds, record.weather, strict=True
            ):
                self._starts[number, slot] = {"seed": seed, "weather": weather, "snapshot": record.snapshot}
        else:
            recorded = codec.decode(RecordedWeather, item.payload)
            span = self._manifest.steps * self._manifest.timestep
            self._weathers[recorded.episode, recorded.slot] = read_weather(recorded, span)

    def _add_sample(self, time_ns: int, sample: dict[str, Any]) -> Iterator[Trajectory]:
        slots = self._manifest.slots
        tables = [(name, sample[name], width) for name, width in self._widths.items()]
        tables.append(("orders", self._order or self._relinquished, self._widths["effective"]))
        tables.append(("fault_free_values", sample["fault_free_values"] or sample["values"], self._widths["values"]))
        has_faults, self._order = bool(sample["fault_free_values"]), None
        self.time = _simulated(sample)
        if sample["sources"] != self._mapping[0]:
            names = map(replace_controls, sample["sources"])
            indices = [self._sources.setdefault(name, len(self._sources)) for name in names]
            self._mapping = sample["sources"], np.array(indices, np.uint16)
        source_index = self._mapping[1][np.frombuffer(sample["source_index"], "<u2")].reshape(slots, -1)
        for slot in range(slots):
            number, step = sample["episode"][slot], sample["step"][slot]
            running = self._running.get(slot)
            if running is None or running.number != number:
                yield from self._end(running)
                running = self._running[slot] = _Episode(number, slot)
            elif step == running.numbers[-1][0]:  # repeated while other slots begin an episode or step
                continue
            running.has_faults |= has_faults
            running.numbers.append((step, time_ns, sample["flags"][slot], sample["late"], sample["rejected"]))
            running.source_index.append(source_index[slot])
            for name, raw, width in tables:
                if len(raw) != 8 * width * slots:
                    raise BadMessage(f"{name} has {len(raw)} bytes; {8 * width * slots} expected")
                running.tables.setdefault(name, []).append(raw[8 * width * slot : 8 * width * (slot + 1)])

    def finish(self) -> Iterator[Trajectory]:
        """Return the episodes that were running at the end."""
        for episode in self._running.values():
            yield from self._end(episode)

    def _end(self, episode: _Episode | None) -> Iterator[Trajectory]:
        if episode is None:
            return
        key, numbers = (episode.number, episode.slot), np.array(episode.numbers, np.int64)
        arrays: dict[str, Any] = {
            name: np.frombuffer(bytearray().join(rows)).reshape(len(rows), -1) if rows[0] else np.empty((len(rows), 0))
            for name, rows in episode.tables.items()
        }
        if not episode.has_faults:
            del arrays["fault_free_values"]
        yield Trajectory(
            self._manifest,
            numbers[:, 0],
            source_index=np.stack(episode.source_index),
            sources=tuple(self._sources),
            wall_time=numbers[:, 1].astype("datetime64[ns]"),
            flags=numbers[:, 2],
            not_accepted=numbers[:, 3:],
            outdoor=self._weathers.pop(key, None),
            number=episode.number,
            slot=episode.slot,
            **arrays,
            **self._starts.pop(key, {}),
        )


class _Episode:
    """Fields of the samples of an episode in one slot.

    Attributes:
        numbers: Step, wall time in nanoseconds, flags, late and rejected commands of each sample.
    """

    def __init__(self, number: int, slot: int) -> None:
        self.number, self.slot, self.has_faults = number, slot, False
        self.numbers: list[tuple[int, ...]] = []
        self.source_index: list[NDArray[np.uint16]] = []
        self.tables: dict[str, list[bytes]] = {}
