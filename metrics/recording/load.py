"""Read a recording into arrays."""

from __future__ import annotations

import warnings
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
from numpy.typing import NDArray

from zenostat.metrics.recording.data import Episode, Recording
from zenostat.metrics.recording.log import LogBuilder
from zenostat.topics import codec
from zenostat.topics.errors import BadMessage, InvalidRecording
from zenostat.topics.extras import requires_extra
from zenostat.topics.messages import Event, Manifest
from zenostat.topics.printable import replace_controls
from zenostat.topics.recording import RecordedEpisode


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
    with requires_extra("recording", "a recording", "mcap and zstandard"):
        from zenostat.bridge.recording.reader import RecordingReader
    with RecordingReader(path) as reader:
        samples, log = _Samples(reader.manifest), LogBuilder()
        events: list[tuple[datetime, Event]] = []
        starts: dict[tuple[int, int], tuple[RecordedEpisode, int]] = {}
        try:
            for item in reader.messages():
                if item.schema == "Sample":
                    samples.add(item.time_ns, msgpack.unpackb(item.payload))
                elif item.schema == "RecordedOrder":
                    samples.order = msgpack.unpackb(item.payload)["values"]
                elif item.schema == "RecordedEpisode":
                    record = codec.decode(RecordedEpisode, item.payload)
                    for index, slot in enumerate(record.slots):
                        starts[record.episode[index], slot] = record, index
                elif item.schema == "Event":
                    event = codec.decode(Event, item.payload)
                    events.append((datetime.fromtimestamp(item.time_ns / 1e9, UTC), event))
                    log.add_event(event, item.time_ns)
                else:
                    log.add(item, samples.time)
            episodes = samples.episodes(starts)
        except (BadMessage, KeyError, ValueError) as error:
            raise InvalidRecording(f"{path} is damaged: a message cannot be read ({error})") from None
        end = reader.end
        if end.text:
            warnings.warn(f"{path}: {end.text}", stacklevel=2)
        return Recording(
            path=Path(path),
            manifest=reader.manifest,
            scenario=reader.scenario,
            provenance=reader.provenance,
            episodes=episodes,
            events=tuple(events),
            log=log.finish(),
            is_complete=end.is_complete,
            note=end.text,
        )


class _Samples:
    """Collects the fields of samples, and divides them into episodes.

    Attributes:
        order: the values that the plant received since the latest sample; None if it received none.
        time: simulated time of the latest sample, slot 0.
    """

    def __init__(self, manifest: Manifest) -> None:
        self._manifest = manifest
        self.order: bytes | None = None
        self.time = ""
        self._relinquished = np.full((manifest.slots, len(manifest.actuators)), np.nan).tobytes()
        self._wall_ns: list[int] = []
        self._lists: dict[str, list[list[int]]] = {"episode": [], "step": [], "flags": []}
        self._raw: dict[str, list[bytes]] = {
            name: []
            for name in ("values", "fault_free_values", "effective", "orders", "baseline", "baseline_effective")
        }
        self._has_faults = False
        self._sources: dict[str, int] = {}
        self._source_rows: list[NDArray[np.intp]] = []
        self._mapping: tuple[list[str], NDArray[np.intp]] = ([], np.empty(0, np.intp))

    def add(self, time_ns: int, sample: dict[str, Any]) -> None:
        self._wall_ns.append(time_ns)
        for name, rows in self._lists.items():
            rows.append(sample[name])
        raw, values = self._raw, sample["values"]
        fault_free = sample["fault_free_values"]
        self._has_faults |= bool(fault_free)
        raw["values"].append(values)
        raw["fault_free_values"].append(fault_free or values)
        raw["effective"].append(sample["effective"])
        raw["orders"].append(self.order or self._relinquished)
        raw["baseline"].append(sample["baseline"])
        raw["baseline_effective"].append(sample["baseline_effective"])
        self.order = None
        self.time = replace_controls(sample["time"][0])
        if sample["sources"] != self._mapping[0]:
            names = map(replace_controls, sample["sources"])
            indices = [self._sources.setdefault(name, len(self._sources)) for name in names]
            self._mapping = sample["sources"], np.array(indices, np.intp)
        self._source_rows.append(self._mapping[1][np.frombuffer(sample["source_index"], "<u2")])

    def _array(self, name: str, width: int) -> NDArray[np.float64]:
        raw = b"".join(self._raw[name])
        return np.frombuffer(raw).reshape(len(self._wall_ns), self._manifest.slots, width)

    def episodes(self, starts: dict[tuple[int, int], tuple[RecordedEpisode, int]]) -> tuple[Episode, ...]:
        """Return the episodes by number, then by slot."""
        if not self._wall_ns:
            return ()
        manifest = self._manifest
        points, actuators = len(manifest.names), len(manifest.actuators)
        lists = {name: np.array(rows, np.int64) for name, rows in self._lists.items()}
        arrays = {
            "values": self._array("values", points),
            "effective": self._array("effective", actuators),
            "orders": self._array("orders", actuators),
        }
        if self._has_faults:
            arrays["fault_free_values"] = self._array("fault_free_values", points)
        if manifest.baseline:
            arrays["baseline"] = self._array("baseline", points)
            arrays["baseline_effective"] = self._array("baseline_effective", actuators)
        wall = np.array(self._wall_ns, "datetime64[ns]")
        source_index = np.stack(self._source_rows).reshape(len(wall), manifest.slots, actuators)
        begin, step_us = np.datetime64(manifest.begin, "us"), round(manifest.step_s * 1e6)
        episodes = []
        for slot in range(manifest.slots):
            episode, step = lists["episode"][:, slot], lists["step"][:, slot]
            # While other slots begin an episode or step, a slot's sample is published again.
            is_new = np.ones(len(step), bool)
            is_new[1:] = (np.diff(episode) != 0) | (np.diff(step) != 0)
            for number in np.unique(episode):
                rows = np.flatnonzero(is_new & (episode == number))
                record, index = starts.get((int(number), slot), (None, 0))
                of_slot = {name: array[rows, slot] for name, array in arrays.items()}
                episodes.append(
                    Episode(
                        manifest=manifest,
                        number=int(number),
                        slot=slot,
                        seed=None if record is None else record.seeds[index],
                        weather="" if record is None else record.weather[index],
                        snapshot="" if record is None else record.snapshot,
                        step=step[rows],
                        time=begin + step[rows] * np.timedelta64(step_us, "us"),
                        wall_time=wall[rows],
                        values=of_slot["values"],
                        fault_free_values=of_slot.get("fault_free_values", of_slot["values"]),
                        effective=of_slot["effective"],
                        orders=of_slot["orders"],
                        source_index=source_index[rows, slot],
                        sources=tuple(self._sources),
                        flags=lists["flags"][rows, slot],
                        baseline=of_slot.get("baseline"),
                        baseline_effective=of_slot.get("baseline_effective"),
                    )
                )
        return tuple(sorted(episodes, key=lambda episode: (episode.number, episode.slot)))
