"""Drive a node with the commands of a recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from zenostat.bridge.client.bus import Bus
from zenostat.bridge.recording.checked_messages import decode
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig, InvalidRecording
from zenostat.topics.extras import requires_extra
from zenostat.topics.messages import CommandOp, Manifest, Mode
from zenostat.topics.points import bounds
from zenostat.topics.recording import RecordedEpisode, RecordedOrder, RecordedSnapshot

if TYPE_CHECKING:
    from zenostat.bridge.client.controller_link import ControllerLink
    from zenostat.bridge.recording.reader import RecordingReader

_SCHEMAS = frozenset(("RecordedEpisode", "RecordedOrder", "RecordedSnapshot"))
_SET, _RELINQUISH = int(CommandOp.SET), int(CommandOp.RELINQUISH)

Progress = Callable[[str, int], None]
"""Called with the simulated time and the step after each timestep."""


@dataclass(frozen=True, slots=True)
class DriveResult:
    """Result of a drive: numbers of timesteps and of episodes, and what was left out, and why."""

    steps: int
    episodes: int
    skipped: tuple[str, ...] = ()


def drive(
    path: str | Path,
    bus: Bus,
    node: str,
    *,
    name: str = "replay",
    priority: int = 10,
    speed: float | None = None,
    progress: Progress = lambda _time, _step: None,
) -> DriveResult:
    """Command a node as the recorded one was commanded, from the start of each recorded episode.

    A controller claims all actuators, resets the node with the recorded seeds, and answers each sample with the values
    that the recorded plant received: after priorities, expiries, fallback policies and injected faults. It takes and
    returns to the recorded snapshots. A node of the same scenario then repeats the recorded trajectory to the bit where
    a seed determines the episode, unless another controller commands it at a higher priority.

    Args:
        path: of the recording.
        bus: that the node is on.
        node: its name. It runs in lockstep, and has the actuators, slots and timestep of the recorded one.
        name: of the controller.
        priority: of its commands, 1 (highest) to 16.
        speed: simulated seconds per second at most; None: as fast as the node simulates.
        progress: callback for each timestep.

    Raises:
        InvalidConfig: the node differs from the recorded one in mode, actuators, slots or timestep, or a recorded value
            is outside its bounds; nothing has been changed on the node.
        InvalidRecording: the recording has no commands from the start of an episode on, or is damaged.
        BusError, SimulatorError: the node failed, rejected a command, or was reset by another controller.
    """
    with requires_extra("recording", "a recording", "mcap and zstandard"):
        from zenostat.bridge.recording.reader import RecordingReader
    with RecordingReader(path) as reader:
        manifest = bus.manifest(node)
        columns = _check(reader, manifest)
        with bus.controller(node, name=name, priority=priority) as link:
            return _Drive(reader, link, columns, speed, progress).run()


def _check(reader: RecordingReader, manifest: Manifest) -> NDArray[np.intp]:
    """Return the index of each recorded actuator on the node; raise if the node cannot be driven."""
    recorded = reader.manifest
    prefix = f"{manifest.node} cannot be driven with {reader.path}"
    if manifest.mode is not Mode.LOCKSTEP:
        raise InvalidConfig(f"{prefix}: it runs in mode {manifest.mode}; each command needs its step (lockstep)")
    for what, ours, theirs in (
        ("a timestep of {:g} s", recorded.step_s, manifest.step_s),
        ("{} slots", recorded.slots, manifest.slots),
        ("episodes of {} steps", recorded.steps, manifest.steps),
    ):
        if ours != theirs:
            raise InvalidConfig(f"{prefix}: it has {what.format(theirs)}, the recorded node {what.format(ours)}")
    names, present = ([actuator.name for actuator in m.actuators] for m in (recorded, manifest))
    if sorted(names) != sorted(present):
        missing, other = ", ".join(sorted({*names} - {*present})), ", ".join(sorted({*present} - {*names}))
        texts = ([f"it lacks {missing}"] if missing else []) + ([f"the recorded node lacks {other}"] if other else [])
        raise InvalidConfig(f"{prefix}: their actuators differ: {'; '.join(texts)}")
    columns = np.array([names.index(name) for name in present], np.intp)
    _check_values(reader, manifest, columns, prefix)
    return columns


def _check_values(reader: RecordingReader, manifest: Manifest, columns: NDArray[np.intp], prefix: str) -> None:
    limits = np.array([bounds(actuator) for actuator in manifest.actuators]).reshape(-1, 2)
    count = 0
    for item in reader.messages({"RecordedOrder"}):
        values = _table(reader, decode(reader, RecordedOrder, item).values)[:, columns]
        outside = np.argwhere((values < limits[:, 0]) | (values > limits[:, 1]))
        if len(outside):
            slot, index = outside[0].tolist()
            actuator = manifest.actuators[index]
            raise InvalidConfig(
                f"{prefix}: timestep {count} commands {actuator.name} = {values[slot, index]:g}, outside its bounds "
                f"{limits[index, 0]:g} to {limits[index, 1]:g}"
            )
        count += 1
    if not count:
        raise InvalidRecording(f"{reader.path} has no commands")


def _table(reader: RecordingReader, raw: bytes) -> Floats:
    return np.frombuffer(raw).reshape(reader.manifest.slots, len(reader.manifest.actuators))


class _Drive:
    """Sends the recorded orders step by step."""

    def __init__(
        self,
        reader: RecordingReader,
        link: ControllerLink,
        columns: NDArray[np.intp],
        speed: float | None,
        progress: Progress,
    ) -> None:
        self._reader, self._link, self._columns, self._speed, self._progress = reader, link, columns, speed, progress
        self._is_single = reader.manifest.slots == 1
        self._start: RecordedEpisode | None = None
        self._is_known = False
        self._snapshots: dict[str, str] = {}
        self._uses = Counter(
            record.snapshot
            for item in reader.messages({"RecordedEpisode"})
            if (record := decode(reader, RecordedEpisode, item)).snapshot
        )
        self._steps = self._episodes = self._unknown = 0
        self._skipped: list[str] = []
        self._due_s = monotonic()

    def run(self) -> DriveResult:
        for item in self._reader.messages(_SCHEMAS):
            if item.schema == "RecordedEpisode":
                self._on_start(decode(self._reader, RecordedEpisode, item))
            elif item.schema == "RecordedSnapshot":
                self._on_snapshot(decode(self._reader, RecordedSnapshot, item))
            else:
                self._on_order(decode(self._reader, RecordedOrder, item))
        if self._unknown:
            self._skipped.insert(0, f"{self._unknown:,} timesteps of episodes whose start is not in the recording")
        if self._reader.end.text:
            self._skipped.append(self._reader.end.text)
        if not self._steps:
            raise InvalidRecording(f"{self._reader.path} has no commands from the start of an episode on")
        return DriveResult(self._steps, self._episodes, tuple(self._skipped))

    def _on_start(self, record: RecordedEpisode) -> None:
        """Reset the node with the next order or snapshot: most recordings begin with an episode without a step."""
        is_whole = len(record.slots) == self._reader.manifest.slots
        if not is_whole and self._is_known:
            self._reset_pending()
        if is_whole or self._is_known:
            self._start, self._is_known = record, True
        if record.snapshot and record.snapshot not in self._snapshots:
            self._start, self._is_known = None, False
            self._skipped.append(f"episode {record.episode[0]}, which returns to snapshot {record.snapshot!r}")

    def _reset_pending(self) -> None:
        record, self._start = self._start, None
        if record is None:
            return
        if record.snapshot:
            self._link.reset(snapshot=self._snapshots[record.snapshot])
            self._uses[record.snapshot] -= 1
            if not self._uses[record.snapshot]:
                self._drop(record.snapshot)
        else:
            is_whole = len(record.slots) == self._reader.manifest.slots
            self._link.reset(seed=[*record.seeds], slots=None if is_whole else [*record.slots])
        self._episodes += len(record.slots)
        self._due_s = monotonic()

    def _on_snapshot(self, record: RecordedSnapshot) -> None:
        if self._is_known:
            self._reset_pending()
        if not self._uses[record.snapshot]:
            return
        if record.snapshot in self._snapshots:  # a node that went on with a recording begins its numbers again
            self._drop(record.snapshot)
        if self._is_known:
            taken = self._link.bus.snapshot(self._link.manifest.node, controller=self._link.name)
            self._snapshots[record.snapshot] = taken.snapshot

    def _drop(self, snapshot: str) -> None:
        """Drop a snapshot to which the recording does not return again: the node allows only some at a time."""
        link = self._link
        link.bus.drop(link.manifest.node, self._snapshots.pop(snapshot), controller=link.name)

    def _on_order(self, record: RecordedOrder) -> None:
        if not self._is_known:
            self._unknown += 1
            return
        self._reset_pending()
        values = _table(self._reader, record.values)[:, self._columns]
        is_relinquished = np.isnan(values)
        operations = np.where(is_relinquished, _RELINQUISH, _SET).astype(np.uint8).tobytes()
        commands: Any = np.where(is_relinquished, 0.0, values)
        still = {*range(self._reader.manifest.slots)} - {*record.slots}
        self._link.send(commands[0] if self._is_single else commands, operations, still=still)
        sample = self._link.receive()
        self._steps += 1
        self._progress(sample.message.time[0], sample.message.step[0])
        if self._speed is not None:
            self._due_s += self._reader.manifest.step_s / self._speed
            sleep(max(self._due_s - monotonic(), 0.0))
