"""Verify a recording: a new plant receives the recorded orders, and its values are compared with the recorded ones.

The orders are the actuator values that the plant received, so the comparison does not depend on timing, priorities,
expiries, fallback policies or injected faults. Nothing between the node's exchange and the controller takes part.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import timedelta
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from zenostat.bridge.node.plant import PlantDescription, RepeatablePlant, RunningPlant
from zenostat.bridge.recording.audit_chain import AuditResult, check_audit
from zenostat.bridge.recording.checked_messages import decode
from zenostat.bridge.recording.reader import RecordedItem, RecordingReader
from zenostat.topics import VERSION
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidRecording
from zenostat.topics.messages import Flag, Sample
from zenostat.topics.plurals import counted
from zenostat.topics.printable import replace_controls
from zenostat.topics.recording import RecordedEpisode, RecordedOrder, RecordedSnapshot

_TRUNCATED = int(Flag.TRUNCATED)
_SCHEMAS = frozenset(("Sample", "RecordedOrder", "RecordedEpisode", "RecordedSnapshot"))

Progress = Callable[[int, int], None]
"""Called with the number of timesteps so far and in total."""


@runtime_checkable
class ExpectingPlant(Protocol):
    """A plant whose steps also depend on what happened around it, such as the loss of a part, which it measures."""

    def expect(self, recorded: Mapping[str, float]) -> None:
        """Prepare for the next timestep, of which these are the recorded values by name."""


@dataclass(frozen=True, slots=True)
class Difference:
    """The first value that is not equal.

    Attributes:
        episode, slot, step: of the sample.
        time: simulated time of the sample, as recorded.
        point: name of the point; `time`, `step` or `end of the episode` for those.
        recorded, verified: the value in the recording, and that of the new plant.
    """

    episode: int
    slot: int
    step: int
    time: str
    point: str
    recorded: Any
    verified: Any

    def __str__(self) -> str:
        slot = f", slot {self.slot}" if self.slot else ""
        distance = ""
        if isinstance(self.recorded, float) and isinstance(self.verified, float):
            distance = f" (difference {self.verified - self.recorded:.3g})"
        return (
            f"episode {self.episode}{slot}, step {self.step} ({self.time}): {self.point} is {self.verified!r}, "
            f"recorded {self.recorded!r}{distance}"
        )


@dataclass(slots=True)
class Verification:
    """Result of a verification.

    Attributes:
        steps: number of timesteps that were simulated and compared, of all slots.
        episodes: number of episodes of which the first sample was compared, of all slots.
        points, actuators: numbers of values and of effective values that were compared per sample.
        difference: the first value that is not equal; None if there is none.
        greatest: greatest absolute difference by point, if a tolerance was set; infinite where only one value is NaN.
        tolerance: greatest absolute difference that is accepted; None: all values are equal to the bit.
        skipped: what could not be verified, and why.
        notes: what differs from the recording's software, model and weather.
        end: why the recording ends early, or what is damaged; empty if it is whole.
        is_damaged: whether the file is damaged.
        is_complete: whether the file is completed, so that its messages are verified also if it is damaged.
        audit: the chain of the audit log.
    """

    steps: int = 0
    episodes: int = 0
    points: int = 0
    actuators: int = 0
    difference: Difference | None = None
    greatest: dict[str, float] = field(default_factory=dict)
    tolerance: float | None = None
    skipped: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    end: str = ""
    is_damaged: bool = False
    is_complete: bool = False
    audit: AuditResult = field(default_factory=AuditResult)

    @property
    def passed(self) -> bool:
        """Whether values were compared, all of them are equal or within the tolerance, and the audit log is whole."""
        if not self.episodes or self.is_damaged or self.difference is not None or self.audit.problems:
            return False
        return self.tolerance is None or all(value <= self.tolerance for value in self.greatest.values())

    def __str__(self) -> str:
        compared = ", ".join(
            [counted(self.steps, "step", ","), counted(self.points, "point"), counted(self.actuators, "actuator")]
        )
        if self.difference is not None:
            return f"different after {compared}: {self.difference}"
        is_cut = self.is_damaged and not self.is_complete
        what = "the file is damaged" if self.is_damaged and self.is_complete else "the recording ends early"
        end = f"; {what}: {self.end}" if self.end else ""
        if not self.episodes:
            return f"nothing could be verified{end}"
        if not self.steps and self.tolerance is None:
            compared = f"the first sample of {counted(self.episodes, 'episode')}, after which there is no timestep"
        if self.tolerance is None:
            return f"identical{' up to the damage' if is_cut else ''}: {compared}{end}"
        above = [name for name, value in self.greatest.items() if not value <= self.tolerance]
        within = f"{len(above)} of {len(self.greatest)} differ by more than" if above else "all are within"
        return f"compared: {compared}; {within} {self.tolerance:g}{end}"


@dataclass(slots=True)
class _Copy:
    """A snapshot of the plant during the verification."""

    plant: RunningPlant
    step: list[int]
    known: list[bool]


class _Columns:
    """Columns that recording and plant have in common; `ours` and `theirs` are None if all columns are the same."""

    def __init__(self, recorded: Sequence[str], present: Sequence[str]) -> None:
        self.names = [name for name in recorded if name in set(present)]
        self.missing = [name for name in recorded if name not in set(present)]
        self.recorded_width, self.width = len(recorded), len(present)
        self.is_same = list(recorded) == list(present)
        self.theirs = [recorded.index(name) for name in self.names]
        self.ours = [present.index(name) for name in self.names]


class Verifier:
    """Verifies a recording with a new plant.

    Args:
        reader: of the recording.
        plant: created from the recording's provenance, not started; the caller closes it.
        folder: for the copies that snapshots need; the caller removes it.
        tolerance: greatest absolute difference that is accepted; None compares to the bit, up to the first difference.
        progress: called after each timestep.

    Raises:
        InvalidRecording: the plant lacks points or actuators of the recording (without a tolerance: any difference).
    """

    def __init__(
        self,
        reader: RecordingReader,
        plant: RepeatablePlant,
        folder: Path,
        *,
        tolerance: float | None = None,
        progress: Progress | None = None,
    ) -> None:
        self._reader, self._plant, self._folder, self._progress = reader, plant, folder, progress
        manifest, present = reader.manifest, plant.description
        self._slots = manifest.slots
        self._values = _Columns(manifest.names, _names(present))
        actuators = [actuator.name for actuator in manifest.actuators]
        self._effective = _Columns(actuators, [actuator.name for actuator in present.actuators])
        self._check_points(tolerance)
        self.result = Verification(
            points=len(self._values.names), actuators=len(self._effective.names), tolerance=tolerance
        )
        self._timestep = timedelta(seconds=present.run_period.step_s)
        self._begin = present.run_period.begin
        self._step = [0] * self._slots
        self._known = [False] * self._slots
        self._is_started = False
        self._order: RecordedOrder | None = None
        self._is_over = [False] * self._slots
        self._unknown_samples = 0
        self._copies: dict[str, _Copy] = {}
        self._folders = itertools.count(1)
        self._uses: dict[str, int] = {}
        self._total = 0
        self._greatest: dict[str, Floats] = {}

    def _check_points(self, tolerance: float | None) -> None:
        missing = self._values.missing + self._effective.missing
        if tolerance is None and not (self._values.is_same and self._effective.is_same):
            names = f": {', '.join(missing)} are missing" if missing else ""
            raise InvalidRecording(f"the model's points are not those of the recording{names}")
        if self._effective.missing:
            raise InvalidRecording(
                f"the model lacks actuators that the recording commands: {', '.join(self._effective.missing)}"
            )

    def run(self) -> Verification:
        """Verify the whole recording; without a tolerance, up to the first difference.

        Raises:
            InvalidRecording: the recording's plant cannot repeat episodes, or a record is not valid.
            SimulatorError: the new plant failed.
        """
        result = self.result
        recorded_version = self._reader.about.get("zenostat", "")
        if recorded_version != VERSION:
            result.notes.append(f"recorded by Zenostat {recorded_version}, verified by {VERSION}")
        result.audit = check_audit(self._reader)
        self._scan()
        for item in self._reader.messages(_SCHEMAS):
            self._process(item)
            if result.difference is not None and result.tolerance is None:
                return result
        end = self._reader.end
        result.is_damaged, result.is_complete, result.end = end.is_damaged, end.is_complete, end.text
        if self._unknown_samples:
            result.skipped.insert(
                0, f"{self._unknown_samples:,} samples of episodes whose start is not in the recording"
            )
        if result.tolerance is not None:
            result.greatest = self._greatest_by_name()
            result.notes += [
                f"{name} is not a point of the model and was not compared" for name in self._values.missing
            ]
        return result

    def _scan(self) -> None:
        """Find the snapshots to which the recording returns, and count its timesteps."""
        for item in self._reader.messages({"RecordedEpisode", "RecordedOrder"}):
            if item.schema == "RecordedOrder":
                self._total += 1
            elif snapshot := decode(self._reader, RecordedEpisode, item).snapshot:
                self._uses[snapshot] = self._uses.get(snapshot, 0) + 1

    def _process(self, item: RecordedItem) -> None:
        if item.schema == "Sample":
            self._on_sample(decode(self._reader, Sample, item))
        elif item.schema == "RecordedOrder":
            self._order = decode(self._reader, RecordedOrder, item)  # an order without a sample: its timestep failed
        elif item.schema == "RecordedEpisode":
            self._on_episode(decode(self._reader, RecordedEpisode, item))
        else:
            self._on_snapshot(decode(self._reader, RecordedSnapshot, item))

    # Episodes and snapshots

    def _on_episode(self, record: RecordedEpisode) -> None:
        self._order = None
        if record.snapshot:
            self._return_to(record)
            return
        if not record.inputs:
            raise InvalidRecording("its plant cannot repeat an episode, so the recording cannot be verified")
        plant, numbers = self._plant, [0] * self._slots
        for slot, number in zip(record.slots, record.episode, strict=True):
            numbers[slot] = number
        plant.repeat_episode(record.slots, record.inputs, numbers)
        plant.start(record.slots if self._is_started else range(self._slots))
        plant.clean_up()
        self._is_started = True
        for slot in record.slots:
            self._step[slot], self._known[slot], self._is_over[slot] = 0, True, False
        self.result.episodes += len(record.slots)

    def _return_to(self, record: RecordedEpisode) -> None:
        copy = self._copies.get(record.snapshot)
        if copy is None:
            self._known = [False] * self._slots
            self.result.skipped.append(
                f"episode {record.episode[0]}, which returns to snapshot {record.snapshot!r}, taken before the "
                "recording began"
            )
            return
        self._plant.restore(copy.plant, record.episode)
        self._plant.clean_up()
        self._step, self._known, self._is_over = [*copy.step], [*copy.known], [False] * self._slots
        self.result.episodes += sum(copy.known)
        self._uses[record.snapshot] -= 1
        if not self._uses[record.snapshot]:
            self._copies.pop(record.snapshot).plant.close()

    def _on_snapshot(self, record: RecordedSnapshot) -> None:
        if self._uses.get(record.snapshot) and any(self._known):
            baseline = self._reader.manifest.baseline
            folder = self._folder / str(next(self._folders))  # a name from a file could be a path
            if (previous := self._copies.pop(record.snapshot, None)) is not None:
                previous.plant.close()  # a node that went on with a recording begins its numbers again
            copy = self._plant.fork(range(self._slots), folder, baseline=baseline)
            self._copies[record.snapshot] = _Copy(copy, [*self._step], [*self._known])

    def close(self) -> None:
        """End the copies of the plant; idempotent."""
        for copy in self._copies.values():
            copy.plant.close()
        self._copies.clear()

    # Samples

    def _on_sample(self, sample: Sample) -> None:
        order, self._order = self._order, None
        slots = [slot for slot in order.slots if self._known[slot]] if order is not None else []
        if order is not None and slots:
            if isinstance(self._plant, ExpectingPlant):
                row = np.frombuffer(sample.fault_free_values or sample.values)
                self._plant.expect(dict(zip(self._reader.manifest.names, row.tolist(), strict=False)))
            last = self._plant.step(self._commands(order.values), slots)
            for slot, self._is_over[slot] in zip(slots, last, strict=True):
                self._step[slot] += 1
            self.result.steps += len(slots)
            if self._progress is not None:
                self._progress(self.result.steps // self._slots, self._total)
        if not all(self._known):
            self._unknown_samples += self._known.count(False)
        if any(self._known):
            self._compare(sample)

    def _commands(self, values: bytes) -> bytes:
        columns = self._effective
        if columns.is_same:
            return values
        commands = np.full((self._slots, columns.width), np.nan)
        commands[:, columns.ours] = np.frombuffer(values).reshape(self._slots, columns.recorded_width)[
            :, columns.theirs
        ]
        return commands.tobytes()

    def _compare(self, sample: Sample) -> None:
        plant = self._plant
        for slot in range(self._slots):
            if self._known[slot]:
                self._compare_time(sample, slot)
        recorded = sample.fault_free_values or sample.values
        self._compare_values(sample, recorded, plant.values(), self._values, "")
        self._compare_values(sample, sample.effective, plant.effective, self._effective, "effective ")
        if sample.baseline and plant.has_baseline:
            self._compare_values(sample, sample.baseline, plant.baseline_values(), self._values, "baseline ")
            effective = plant.baseline_effective()
            self._compare_values(sample, sample.baseline_effective, effective, self._effective, "baseline effective ")

    def _compare_time(self, sample: Sample, slot: int) -> None:
        step = self._step[slot]
        elapsed = step * self._timestep
        pairs = (
            ("step", sample.step[slot], step),
            ("time", sample.time[slot], (self._begin + elapsed).isoformat()),
            ("elapsed_s", sample.elapsed_s[slot], elapsed.total_seconds()),
            ("end of the episode", bool(sample.flags[slot] & _TRUNCATED), self._is_over[slot]),
        )
        for name, recorded, present in pairs:
            if recorded != present:
                self._set_difference(sample, slot, name, recorded, present)

    def _compare_values(self, sample: Sample, recorded: bytes, present: bytes, columns: _Columns, prefix: str) -> None:
        if columns.is_same and recorded == present:
            return
        theirs = np.frombuffer(recorded).reshape(self._slots, columns.recorded_width)[:, columns.theirs]
        ours = np.frombuffer(present).reshape(self._slots, columns.width)[:, columns.ours]
        is_equal = equal_bits(theirs, ours)
        is_equal[~np.array(self._known)] = True
        if is_equal.all():
            return
        slot, index = np.argwhere(~is_equal)[0]
        name = prefix + columns.names[index]
        if self.result.tolerance is None:
            self._set_difference(sample, int(slot), name, float(theirs[slot, index]), float(ours[slot, index]))
            return
        with np.errstate(invalid="ignore"):
            distance = np.where(is_equal, 0.0, np.abs(theirs - ours))
        distance[np.isnan(distance)] = np.inf
        previous = self._greatest.get(prefix)
        row = distance.max(axis=0)
        self._greatest[prefix] = row if previous is None else np.maximum(previous, row)

    def _greatest_by_name(self) -> dict[str, float]:
        columns = {"": self._values, "effective ": self._effective}
        columns |= (
            {"baseline ": self._values, "baseline effective ": self._effective} if self._plant.has_baseline else {}
        )
        return {
            prefix + name: float(self._greatest[prefix][index]) if prefix in self._greatest else 0.0
            for prefix, selected in columns.items()
            for index, name in enumerate(selected.names)
        }

    def _set_difference(self, sample: Sample, slot: int, name: str, recorded: Any, present: Any) -> None:
        if self.result.difference is None:
            episode, step, time = sample.episode[slot], sample.step[slot], replace_controls(sample.time[slot])
            self.result.difference = Difference(episode, slot, step, time, name, recorded, present)


def equal_bits(left: Floats, right: Floats) -> NDArray[np.bool_]:
    """Return which values of two arrays of one shape are equal to the bit; any NaN is equal to any other."""
    is_equal: NDArray[np.bool_] = (left.view(np.uint64) == right.view(np.uint64)) | (np.isnan(left) & np.isnan(right))
    return is_equal


def _names(plant: PlantDescription) -> list[str]:
    return [*(sensor.name for sensor in plant.sensors), *(meter.name for meter in plant.meters)]
