"""The interface between a node and the plant that it simulates.

A node puts one plant on the bus: it publishes samples, collects commands, paces, injects faults, answers requests. The
plant computes. A plant has one or more slots, independent copies that step together, each with its own episode.

Values cross this interface as raw bytes of native float64, so that a timestep creates no object per point:

    commands   shape (slots, actuators); NaN: the actuator is relinquished, and the plant's own control applies
    values     shape (slots, sensors + meters), in the order of the description; all finite
    effective  shape (slots, actuators); what acted in the latest timestep; NaN: unknown

A plant computes in processes of its own, for which `zenostat.bridge.engine` has the client, or in the node's. Its life,
all in the node's thread unless noted:

    create ─▶ start ─▶ step … ─▶ close
                ▲        │
                └─ next_episode, later start; or restore of a fork
                         │
                         └─▶ fork ─▶ a plant of its own: step, fork, close

`values` and `effective` describe the latest sample of each slot; sample 0 follows `start`. After a `SimulatorError` the
node calls `end`, and the plant does not step again until all slots have been started. Any other exception is an error
in the program, and the node ends with it.

Other threads read `description`, `site`, `simulators` and `memory_bytes` at any time, for queries.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

from zenostat.bridge.engine.registry import EngineRegistry
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import ForkFailed, RequestRejected
from zenostat.topics.messages import Actuator, EpisodeStart, Geometry, Meter, Sensor, Systems, Task, Versions


@dataclass(frozen=True, slots=True)
class RunPeriod:
    """The simulated time of an episode.

    Attributes:
        begin: of sample 0, in the plant's local standard time.
        step_s: length of a timestep in seconds.
        steps: number of timesteps.
    """

    begin: datetime
    step_s: float
    steps: int

    def time(self, step: int) -> datetime:
        """Return the simulated time of a sample."""
        return self.begin + timedelta(seconds=step * self.step_s)

    @property
    def end(self) -> datetime:
        """Simulated time of the last sample."""
        return self.time(self.steps)


@dataclass(frozen=True, slots=True)
class Site:
    """The weather and the location of an episode; empty for a plant without weather."""

    weather: str = ""
    location: str = ""
    latitude_deg: float | None = None
    longitude_deg: float | None = None
    time_zone_h: float | None = None


@dataclass(frozen=True, slots=True)
class Provenance:
    """Origin of a plant: all that is needed to create it again.

    Attributes:
        kind: which program can: `energyplus`, `python`; empty: none.
        settings: for that program, JSON built-ins.
        files: paths of the files that determine the results, by their roles (`model`, `weather 1`, `engine`).
    """

    kind: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    files: Mapping[str, Path] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class PlantDescription:
    """Properties of a plant that do not change while it exists.

    Attributes:
        name: of the building or plant.
        scenario: the text that `rpc/scenario` returns.
        warnings: texts for the manifest.
        zones, floor_area_m2: as in the manifest.
        geometry: zones and surfaces, for pictures; None for a plant without.
        without_geometry: why there is none; the text of the error that `rpc/geometry` replies with.
        semantic: returns the semantic model of the building as Turtle, for the name of a node; called in any thread, it
            takes a second at most. None for a plant without.
        without_semantic: why there is none; the text of the error that `rpc/semantic` replies with.
        systems: components and loops, for schematics; None for a plant without.
        connected: as in the manifest.
        provenance: what creates the same plant again, for recordings.
    """

    name: str
    run_period: RunPeriod
    sensors: tuple[Sensor, ...]
    meters: tuple[Meter, ...]
    actuators: tuple[Actuator, ...]
    versions: Versions
    task: Task = field(default_factory=Task)
    scenario: str = ""
    warnings: tuple[str, ...] = ()
    zones: tuple[str, ...] = ()
    floor_area_m2: float | None = None
    geometry: Geometry | None = None
    without_geometry: str = "this plant has no geometry"
    semantic: Callable[[str], str] | None = None
    without_semantic: str = "this plant has no semantic model"
    systems: Systems | None = None
    connected: Mapping[str, str] = field(default_factory=dict)
    provenance: Provenance = field(default_factory=Provenance)


class WeatherTable(NamedTuple):
    """Weather of an episode: values of shape (rows, columns), NaN where unknown, each at the end of its interval."""

    columns: list[str]
    units: list[str]
    step_s: float
    values: Floats


@dataclass(frozen=True, slots=True)
class SlotPlacement:
    """The cores of one slot; empty leaves them to the system.

    Attributes:
        cpus: cores of its engine.
        spare: cores on which the engine of the next episode may start.
        poll: whether its engine has a core of its own and may poll for orders.
    """

    cpus: tuple[int, ...] = ()
    spare: tuple[int, ...] = ()
    poll: bool = False


@dataclass(frozen=True, slots=True)
class PlantContext:
    """Resources that a node provides to its plant.

    Attributes:
        folder: for the plant's files; the node removes it at the end.
        placement: of each slot.
        cpus: cores that forks may use; empty leaves them to the system.
        baseline: whether each slot has a second copy that receives no commands. A factory whose plant cannot have one
            raises `InvalidConfig`.
        registry: where the plant registers its engine processes, so that a node that ends can kill them at any time.
    """

    folder: Path
    placement: tuple[SlotPlacement, ...] = (SlotPlacement(),)
    cpus: tuple[int, ...] = ()
    baseline: bool = False
    registry: EngineRegistry = field(default_factory=EngineRegistry)

    @property
    def slots(self) -> int:
        """Number of slots."""
        return len(self.placement)


class SampleSource(Protocol):
    """The part of a plant from which its samples are encoded; see `RunningPlant`."""

    @property
    def description(self) -> PlantDescription:
        """Description of the plant."""

    @property
    def effective(self) -> bytes:
        """Effective value of each actuator in the latest timestep."""

    @property
    def has_baseline(self) -> bool:
        """Whether `baseline_values` and `baseline_effective` return anything."""

    def baseline_values(self) -> bytes:
        """Return the latest values of the copies without commands; empty without a baseline."""

    def baseline_effective(self) -> bytes:
        """Return the effective values of these copies."""


class RunningPlant(SampleSource, Protocol):
    """A plant that waits at the latest sample of each slot: a node's own, a snapshot's or a branch's."""

    def step(self, commands: bytes, active_slots: Sequence[int]) -> list[bool]:
        """Simulate a timestep in the active slots; return for each of them whether it was its last.

        Raises:
            SimulatorError: the plant failed; its text names the reason.
        """

    def values(self) -> bytes:
        """Return the latest sensor and meter values."""

    def check(self) -> None:
        """Raise the `SimulatorError` of a simulator that has ended while it waited; quick, called when woken."""

    def fork(self, slots: Sequence[int], folder: Path, *, baseline: bool = False) -> RunningPlant:
        """Return a copy at the same samples.

        Args:
            slots: for each slot of the copy, the slot that it copies.
            folder: for the files of the copy; it does not exist yet, and the caller removes it.
            baseline: whether to copy the slots' baseline as well, if there is one.

        Raises:
            ForkFailed: the plant cannot be copied, or the system lacks the resources. This plant is unchanged.
            SimulatorError: a simulator has failed.
        """

    def site(self, slot: int) -> Site:
        """Return the weather and the location of the present episode of a slot. Thread-safe."""

    def notes(self, slot: int) -> list[str]:
        """Return texts that describe the present episode of a slot, for the event that reports its start."""

    def weather(self, slot: int, columns: Sequence[str]) -> WeatherTable:
        """Return weather columns from the begin of the present episode until after its end.

        Raises:
            RequestRejected: the plant has no weather.
            UnknownName: there is no such column.
        """

    def memory_bytes(self, *, private: bool = False) -> int:
        """Return the memory of all simulators; `private`: without pages that processes share. Thread-safe."""

    @property
    def simulators(self) -> int:
        """Number of simulators, including those of the baseline."""

    def interrupt(self) -> None:
        """Make a running `step` or `start` raise a `SimulatorError` soon; thread-safe."""

    def end(self, *, failed: bool = False) -> None:
        """End the simulators; those that have not failed may finish files that are kept. Idempotent.

        `start` may follow: it begins new ones.
        """

    def close(self) -> None:
        """End everything and release all resources; idempotent."""


class Plant(RunningPlant, Protocol):
    """The plant of a node, which also begins episodes."""

    def next_episode(
        self, slots: Sequence[int], seeds: Sequence[int | None], episode: Sequence[int], untouched: Sequence[bool]
    ) -> list[EpisodeStart]:
        """Choose the inputs of the next episode of some slots; `start` begins it. Waits for no simulator to start.

        Args:
            slots: slots to reset.
            seeds: one for each of them; None continues the sequence of the previous seed.
            episode: numbers of the episodes, of all slots of the plant.
            untouched: of each of `slots`, whether it waits at sample 0 and has received no command.

        Raises:
            SimulatorError: the inputs cannot be prepared.
        """

    def start(self, slots: Sequence[int]) -> None:
        """Bring some slots to sample 0 of the episode that `next_episode` chose, or of the first one.

        Raises:
            SimulatorError: a simulator cannot be started or failed.
        """

    def restore(self, saved: RunningPlant, episode: Sequence[int]) -> list[EpisodeStart]:
        """Continue all slots from a copy that `fork` returned, which remains as it is.

        If this fails, the present episode can continue.

        Raises:
            SimulatorError: the copy cannot be forked.
        """

    def clean_up(self) -> None:
        """End simulators that `start` or `restore` replaced, and prepare the next episodes.

        Called after the first sample has been published, which is not delayed by this work.
        """

    def drain_warnings(self) -> list[str]:
        """Return warnings since the last call, for events."""


@runtime_checkable
class RepeatablePlant(Plant, Protocol):
    """A plant that can repeat a recorded episode."""

    def episode_inputs(self, slot: int) -> dict[str, Any]:
        """Return what determines the present episode of a slot besides its commands, as JSON built-ins."""

    def repeat_episode(self, slots: Sequence[int], inputs: Sequence[Mapping[str, Any]], episode: Sequence[int]) -> None:
        """Choose the inputs of the next episode of some slots, as `next_episode` does; `start` begins it.

        Args:
            slots: slots to reset.
            inputs: of each of them, as `episode_inputs` returned them.
            episode: numbers of the episodes, of all slots of the plant.

        Raises:
            InvalidRecording: these are not inputs of this plant.
            SimulatorError: the inputs cannot be prepared.
        """


@runtime_checkable
class PlanningPlant(RunningPlant, Protocol):
    """A plant that simulates several timesteps at once faster than by `step`."""

    def run(self, commands: Sequence[bytes], active_slots: Sequence[int]) -> Iterator[list[bool]]:
        """Simulate several timesteps in the active slots.

        Args:
            commands: of each timestep, as of `step`.
            active_slots: as of `step`; none of them is at its last sample before the last of these timesteps.

        Yields:
            The result of `step` for each timestep, while `values` and `effective` are those of this timestep.

        Raises:
            SimulatorError: the plant failed; its text names the reason.
        """


@runtime_checkable
class ForecastPlant(RunningPlant, Protocol):
    """A plant whose copies can simulate a weather forecast with errors."""

    def fork_with_error(self, slots: Sequence[int], folder: Path, forecast_error: Sequence[float]) -> RunningPlant:
        """Return a copy, as `fork` does, whose outdoor temperature differs from that of the weather file.

        Args:
            slots: as of `fork`.
            folder: as of `fork`.
            forecast_error: added in each timestep of the copy, K; the last one stays.
        """


@runtime_checkable
class TryingPlant(RunningPlant, Protocol):
    """A plant that has copies for trials at less cost than those of `fork`."""

    def fork_for_trial(
        self, slots: Sequence[int], folder: Path, timesteps: int, *, baseline: bool = False
    ) -> RunningPlant:
        """Return a copy, as `fork` does, that ends before this plant steps.

        Args:
            slots: as of `fork`.
            folder: as of `fork`.
            timesteps: greatest number that it has to simulate.
            baseline: as of `fork`.
        """


@runtime_checkable
class WarningPlant(Protocol):
    """A plant that warns of what happened in a timestep, such as a calculation that did not converge."""

    def drain_step_warnings(self) -> list[str]:
        """Return the warnings of the timesteps since the last call, for events."""


@runtime_checkable
class WaitingPlant(Protocol):
    """A plant whose timestep may wait for others, such as a district's for somebody on the bus of one of its plants.

    Attributes:
        on_waiting: called by `step` and `start` with each new reason to wait, in the node's thread, or in another one
            for which that waits.
    """

    on_waiting: Callable[[str], None]

    @property
    def waiting(self) -> str:
        """Why the running timestep waits; empty if it does not. Thread-safe."""


@runtime_checkable
class AbandonablePlant(Protocol):
    """A plant whose running `step` or `start` can be given up while the node goes on; else `interrupt` is called."""

    def abandon(self, reason: str, *, is_starting: bool) -> None:
        """Make a running `step`, or `start`, raise a `SimulatorError` with the reason soon; thread-safe.

        A plant need not give up a `start` that ends by itself. All slots are started again.
        """


@runtime_checkable
class ClosingPlant(Protocol):
    """A plant that takes a while to end, in processes that need nobody to wait for them."""

    def order_close(self) -> None:
        """Let all simulators end, without waiting for that; only `close` may follow, which waits."""

    @property
    def has_ended(self) -> bool:
        """Whether all simulators have ended."""


PlantFactory = Callable[[PlantContext], Plant]
"""Creates a plant; does not start a simulator.

Raises:
    InvalidConfig: the plant lacks what the context asks for.
"""


def without_weather() -> RequestRejected:
    """Return the error of a plant that has no weather."""
    return RequestRejected("this plant has no weather")


class PlantDefaults:
    """The methods of a plant that computes in the node's process, without baseline, weather, copies and warnings.

    A class that inherits them needs `description`, `simulators`, `effective`, `next_episode`, `start`, `step` and
    `values` to be a `Plant`.
    """

    @property
    def has_baseline(self) -> bool:
        """False: there is no baseline."""
        return False

    def baseline_values(self) -> bytes:
        """Return nothing: there is no baseline."""
        return b""

    def baseline_effective(self) -> bytes:
        """Return nothing: there is no baseline."""
        return b""

    def check(self) -> None:
        """Do nothing: no simulator ends while it waits."""

    def fork(self, slots: Sequence[int], folder: Path, *, baseline: bool = False) -> RunningPlant:  # noqa: ARG002
        """Raise `ForkFailed`."""
        raise ForkFailed("this plant cannot be copied")

    def restore(self, saved: RunningPlant, episode: Sequence[int]) -> list[EpisodeStart]:  # noqa: ARG002
        """Raise `ForkFailed`: there are no copies."""
        raise ForkFailed("this plant cannot be copied")

    def site(self, slot: int) -> Site:  # noqa: ARG002
        """Return an empty site."""
        return Site()

    def notes(self, slot: int) -> list[str]:  # noqa: ARG002
        """Return no texts."""
        return []

    def weather(self, slot: int, columns: Sequence[str]) -> WeatherTable:  # noqa: ARG002
        """Raise `RequestRejected`."""
        raise without_weather()

    def memory_bytes(self, *, private: bool = False) -> int:  # noqa: ARG002
        """Return 0: no simulator has a process of its own."""
        return 0

    def clean_up(self) -> None:
        """Do nothing."""

    def drain_warnings(self) -> list[str]:
        """Return no warnings."""
        return []

    def interrupt(self) -> None:
        """Do nothing: a step does not wait."""

    def end(self, *, failed: bool = False) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""
