"""Every message class of the bus.

Each is frozen, refuses unknown fields and refuses NaN and infinities: a message that exists is
valid. Arrays travel as raw little-endian float64 (`values`, `effective`), uint16 (`source_index`) or uint8
(`operations`) bytes in C order with the shape `(slots, points)`, in the manifest's order.
"""

from __future__ import annotations

from enum import IntEnum, IntFlag, StrEnum
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

SCHEMA_VERSION = 2
"""Version of the contract; part of every key's root and of every message's encoding."""

SafeName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.\-]{0,127}$")]
"""A name that may stand as a chunk of a key: letters, digits, `_`, `.`, `-`; at most 128."""

SourceName = Annotated[str, Field(max_length=128)]
"""Who asks or writes, in its own words."""

ANONYMOUS = "anonymous"
"""Source of a write that names none."""

# Strict where strangers write: a text is no number, and true is no step.
Count = Annotated[int, Field(ge=0, strict=True)]
Priority = Annotated[int, Field(ge=1, le=16, strict=True)]
Finite = Annotated[float, Field(strict=True)]
Raw = Annotated[bytes, Field(strict=True)]
Scalar = Annotated[str, Field(strict=True)] | Annotated[bool, Field(strict=True)] | Annotated[int, Field(strict=True)]


class Message(BaseModel):
    """Base of everything that travels."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, ser_json_inf_nan="null")


class Aggregation(StrEnum):
    """How a sensor is read over a timestep.

    `MEAN` and `SUM` are what EnergyPlus reports for the timestep: the time-weighted mean, or the sum,
    over its system timesteps. `INSTANT` is the state at the end of the timestep.
    """

    MEAN = "mean"
    SUM = "sum"
    INSTANT = "instant"


class Mode(StrEnum):
    """Who sets the pace of simulated time.

    `LOCKSTEP`: the required controllers. `PACED`: the wall clock, at a multiple of its speed; commands hold. `FREE`:
    nobody; it goes as fast as it can.
    """

    LOCKSTEP = "lockstep"
    PACED = "paced"
    FREE = "free"


class Policy(StrEnum):
    """What the node does when a controller has gone, or gives no valid command in time.

    `WAIT`: waits for it. `HOLD`: goes on with what it commanded last. `RELEASE`: gives what it commanded back, to the
    next priority level or to the building's own control. `ABORT`: ends the episode.
    """

    WAIT = "wait"
    HOLD = "hold"
    RELINQUISH = "relinquish"
    ABORT = "abort"


class State(StrEnum):
    """Where a node stands in an episode."""

    STARTING = "starting"
    WAITING = "waiting"
    RUNNING = "running"
    ENDED = "ended"
    FAILED = "failed"
    STOPPED = "stopped"


class EngineStart(StrEnum):
    """How the engine of an episode came to sample 0.

    `REUSED`: it waited there untouched. `FORKED`: from one that waits there. `PREFETCHED`: it was started while the
    episode before ran. `STARTED`: afresh. `SNAPSHOT`: from a snapshot, at that one's sample.
    """

    NONE = ""
    REUSED = "reused"
    FORKED = "forked"
    PREFETCHED = "prefetched"
    STARTED = "started"
    SNAPSHOT = "snapshot"


class Flag(IntFlag):
    """What a sample says about its episode.

    `FALLBACK`: a required controller gave no command for this timestep; the node's policy went on without it.
    """

    NONE = 0
    FIRST = 1
    TRUNCATED = 2
    FALLBACK = 4


class CommandOp(IntEnum):
    """What a command does to one actuator at the controller's level."""

    KEEP = 0
    SET = 1
    RELINQUISH = 2


class Sensor(Message):
    """An EnergyPlus output variable, under a name of the user's."""

    name: SafeName
    variable: str
    key: str
    unit: str
    aggregation: Aggregation
    low: float | None = None
    high: float | None = None


class Meter(Message):
    """An EnergyPlus meter: what was used in the timestep (J for energy)."""

    name: SafeName
    meter: str
    unit: str
    low: float | None = None
    high: float | None = None


class Actuator(Message):
    """An EnergyPlus actuator. `feedback` is the output variable that tells what really ruled."""

    name: SafeName
    component_type: str
    control_type: str
    key: str
    unit: str
    low: float | None = None
    high: float | None = None
    default: float | None = None
    feedback: str | None = None


class TimeField(StrEnum):
    """A field of the clock that an agent may observe, named as in EnergyPlus's data exchange API.

    They describe the timestep that a sample closes (the episode's begin for sample 0): `hour` is 0 to 23,
    `minutes` 1 to 60 and `current_time` (hours of the day, 0 to 24) its end; `day_of_week` is 1 on Sundays.
    """

    YEAR = "year"
    MONTH = "month"
    DAY_OF_MONTH = "day_of_month"
    DAY_OF_WEEK = "day_of_week"
    DAY_OF_YEAR = "day_of_year"
    HOUR = "hour"
    MINUTES = "minutes"
    CURRENT_TIME = "current_time"


class Action(Message):
    """One dimension of an agent's action: the actuators that it sets, all to the same value."""

    name: SafeName
    unit: str
    low: float | None = None
    high: float | None = None
    actuators: Annotated[tuple[SafeName, ...], Field(min_length=1)]


class DiscreteAction(Message):
    """One discrete dimension: the actions that it sets, and a row of their values for each choice."""

    actions: Annotated[tuple[SafeName, ...], Field(min_length=1)]
    values: Annotated[tuple[tuple[float, ...], ...], Field(min_length=1)]


class TerminationLimit(Message):
    """An episode is terminated when one of the points has been outside the range for `duration_s` without a break."""

    points: Annotated[tuple[SafeName, ...], Field(min_length=1)]
    low: float | None = None
    high: float | None = None
    duration_s: Annotated[float, Field(ge=0)] = 0.0


class Task(Message):
    """What an agent of this node observes besides its points, what it decides, and what it is rewarded for.

    With `choices` the action is discrete: one number for each of them. Without, it is a value for each of
    `actions`. `reward` is a kind and its parameters, as `agent_sdk.rewards` reads them; `wrappers` are names and
    arguments, the innermost first, as `agent_sdk.wrappers` reads them.
    """

    scenario: str = ""
    time: tuple[TimeField, ...] = ()
    actions: tuple[Action, ...] = ()
    discrete_actions: tuple[DiscreteAction, ...] = ()
    reward: dict[str, Any] | None = None
    terminate: tuple[TerminationLimit, ...] = ()
    wrappers: tuple[dict[str, Any], ...] = ()


class Versions(Message):
    """What a node is made of."""

    zenostat: str
    energyplus: str
    schema_version: int = SCHEMA_VERSION


class LatencySummary(Message):
    """How long something took: `count` times in all; median and 99th percentile of the latest 4,096; the longest."""

    count: Count = 0
    median_ms: float = 0.0
    p99_ms: float = 0.0
    max_ms: float = 0.0


class Statistics(Message):
    """How a node keeps up, in wall time.

    `step`: from the begin of a timestep to its sample. `cycle`: from sample to sample. `overruns`: paced timesteps
    whose sample came after the next one was due, `max_lag_s` by how much at worst. `missed`: timesteps that went on
    without a required controller. `late`, `rejected`, `duplicate`, `rate_limited`: messages that changed nothing.
    `accepted_late`: commands that were taken although the deadline was over.
    """

    step: LatencySummary = LatencySummary()
    cycle: LatencySummary = LatencySummary()
    overruns: Count = 0
    max_lag_s: float = 0.0
    missed: Count = 0
    late: Count = 0
    rejected: Count = 0
    duplicate: Count = 0
    rate_limited: Count = 0
    accepted_late: Count = 0


class Manifest(Message):
    """All that a stranger needs to read a node's samples and to command it.

    `slots`: engines that step together, each with an episode of its own. `branch_of`: the node that this one is a
    branch of. `baseline`: whether samples tell what the building's own control would have done. `speed`: simulated
    seconds in a second, in paced mode. `grace_s`: how long a controller may be gone before the policy goes on without
    it. `deadline_s`: how long each step waits for commands. `disturbed`: whether samples carry injected faults.
    `statistics`: only in the answer to a query.
    """

    node: SafeName
    instance: str
    branch_of: str = ""
    building: str
    weather: str
    location: str
    latitude_deg: float | None = None
    longitude_deg: float | None = None
    begin: str
    end: str
    steps_per_hour: Annotated[int, Field(ge=1, le=60)]
    steps: Count
    slots: Annotated[int, Field(ge=1)] = 1
    baseline: bool = False
    mode: Mode
    speed: Annotated[float, Field(gt=0)] = 1.0
    policy: Policy
    grace_s: Annotated[float, Field(ge=0)] = 0.0
    deadline_s: Annotated[float, Field(gt=0)] | None = None
    faults_injected: bool = False
    sensors: tuple[Sensor, ...]
    meters: tuple[Meter, ...]
    actuators: tuple[Actuator, ...]
    task: Task = Task()
    warnings: tuple[str, ...] = ()
    versions: Versions
    host: str = ""
    cpu: int | None = None
    statistics: Statistics | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of `Sample.values`: the sensors, then the meters."""
        return tuple(p.name for p in self.sensors) + tuple(p.name for p in self.meters)


class Sample(Message):
    """One frame a step. Lists have an entry a slot; slot 0 is the only one of a plain node.

    `values` are the sensors, then the meters. `effective` says what each actuator really was in the
    timestep that this sample closes; NaN where EnergyPlus has no variable that tells. `source_index` is an
    index into `sources`: who set it, with `sources[0]` the building's own control. `baseline`, like `values`, is the
    same building under its baseline control since sample 0, and `baseline_effective`, like `effective`, what that
    control set its actuators to; empty unless the manifest says so. `fault_free_values`, like `values`, are the
    plant's own where faults are injected into `values`.
    """

    episode: list[Count]
    step: list[Count]
    time: list[str]
    elapsed_s: list[float]
    flags: list[int]
    values: bytes
    effective: bytes
    source_index: bytes
    sources: list[str]
    late: Count = 0
    rejected: Count = 0
    baseline: bytes = b""
    baseline_effective: bytes = b""
    fault_free_values: bytes = b""


class Command(Message):
    """A controller's answer to sample `step` of `episode`; it rules timestep `step + 1`.

    A slot whose step is None is not answered: it stands still while the others go on.

    `values` has all actuators of all slots. `operations` (one `CommandOp` byte each) says which of them are
    set, kept as they are, or released; without it all are set. `values` stands last, so that a command's
    bytes are a head that the node can foresee and the values: it needs no decoding (`codec.command_head`).
    """

    episode: list[Count]
    step: list[Count | None]
    operations: Raw | None = None
    values: Raw


class Write(Message):
    """One actuator, written by a device or a person; `value` None releases it.

    `priority` as in BACnet: 1 the highest, 16 the lowest, 8 a person's.
    `duration_s`: seconds of simulated time after which it is released by itself.
    """

    value: Finite | None
    priority: Priority = 8
    duration_s: Annotated[float, Field(gt=0, strict=True)] | None = None
    source: SourceName = ANONYMOUS


class PointValue(Message):
    """One point at one step, for dashboards and devices that want just that."""

    value: float
    unit: str
    episode: Count
    step: Count
    time: str


class StreamedMessage(Message):
    """A message as it was sent: its topic below the root (`sample`, `event` or `manifest`), and its bytes."""

    topic: str
    payload: Raw


class Batch(Message):
    """What a node has streamed since its last batch, in the order sent: for whoever need not know it at once."""

    messages: list[StreamedMessage]


class EventKind(StrEnum):
    """What an event tells.

    `REJECTED`, `LATE`, `DUPLICATE`: a message that was not taken and changed nothing. `ACCEPTED_LATE`: a command that
    was taken, although the deadline of its step was over.
    """

    STARTED = "started"
    ENDED = "ended"
    FAILED = "failed"
    STOPPED = "stopped"
    REJECTED = "rejected"
    LATE = "late"
    ACCEPTED_LATE = "accepted_late"
    DUPLICATE = "duplicate"
    WRITTEN = "written"
    EXPIRED = "expired"
    CONNECTED = "connected"
    DISCONNECTED = "disconnected"
    WARNING = "warning"
    FALLBACK = "fallback"
    PACE = "pace"
    FAULT = "fault"
    SNAPSHOT = "snapshot"
    BRANCH_CREATED = "branch_created"


class Event(Message):
    """What happened on a node; `source` is the controller or device that it is about.

    `late_s`, in seconds of wall time: how long after its step had gone on a `late` command came, or how long after the
    deadline an `accepted_late` one.
    """

    kind: EventKind
    text: str
    source: str = ""
    error: str = ""
    episode: Count = 0
    step: Count = 0
    late_s: float | None = None


class Claim(Message):
    """Asks for a priority level on actuators (None: all). Required controllers are waited for."""

    controller: SafeName
    priority: Priority = 10
    actuators: list[str] | None = None
    required: bool = True


Seed = Annotated[int, Field(ge=0, strict=True)]


class Reset(Message):
    """Asks for a new episode, of all slots or of some; or to go back to a snapshot.

    `seed`: begins the draws of weather and noise anew; of several slots the first gets this one, the next the one
    after it, or each its own.
    """

    controller: SourceName = ""
    seed: Seed | list[Seed | None] | None = None
    slots: Annotated[list[Count], Field(min_length=1)] | None = None
    snapshot: str = ""


class TakeSnapshot(Message):
    """Asks for a snapshot of the running episode; it lasts until it is dropped, or its owner leaves."""

    controller: SourceName = ""


class SnapshotTaken(Message):
    """A snapshot's name, and where it stands."""

    snapshot: str
    episode: list[Count]
    step: list[Count]


class DropSnapshot(Message):
    """Gives a snapshot's memory back."""

    snapshot: str


class CreateBranch(Message):
    """Asks for a branch: a node of its own that goes on from this sample, or from a snapshot, on its own.

    It ends with a `Stop`, when its owner leaves, or with its parent. `released`: what was commanded up to now holds
    no more; the building's own control goes on. `slots`: how many engines it has, all from this slot.
    """

    controller: SourceName = ""
    snapshot: str = ""
    relinquished: bool = False
    slots: Annotated[int, Field(ge=1, le=256, strict=True)] = 1
    slot: Count = 0


class BranchCreated(Message):
    """A branch's name on the bus."""

    node: SafeName


class SetPace(Message):
    """Asks for another pace, from now on: simulated seconds in a second, or a mode without one."""

    source: SourceName = ""
    mode: Mode = Mode.PACED
    speed: Annotated[float, Field(gt=0, le=1e9, strict=True)] | None = None


class Pause(Message):
    """Asks the node to stand still, in whatever mode."""

    source: SourceName = ""


class Resume(Message):
    """Asks the node to go on; a paced one from here, without catching up."""

    source: SourceName = ""


class StepRequest(Message):
    """Asks a node that stands still for some timesteps: in lockstep once they are answered, else at once."""

    source: SourceName = ""
    steps: Annotated[int, Field(ge=1, le=1_000_000, strict=True)] = 1


class Stop(Message):
    """Asks the node to end."""

    source: SourceName = ""


class WeatherQuery(Message):
    """Asks for columns of the weather file that a slot's present episode reads, by their EPW names."""

    columns: Annotated[list[str], Field(min_length=1, max_length=40)]
    slot: Count = 0


class WeatherSeries(Message):
    """The weather of an episode and of a week after it, as EnergyPlus reads it, noise included.

    Row k of `values`, raw with shape (rows, columns), holds at `step_s * (k + 1)` seconds after the episode's
    begin; NaN where the file says nothing.
    """

    episode: Count
    columns: list[str]
    units: list[str]
    step_s: float
    values: bytes


class ScenarioText(Message):
    """The scenario that a node simulates, as a scenario file (YAML)."""

    text: str


class Query(Message):
    """A question: status, scenario. `memory`: of the status, also what each process shares with no other."""

    memory: bool = False


class EpisodeStart(Message):
    """How an episode begins.

    `engine_start`: how its engine came to its first sample. `weather`: the weather file. `noise_parameters`: the
    parameters of its noise, by column (`dry_bulb_temperature.sigma`). `output_dir`: the folder of EnergyPlus's own
    files, if they are kept.
    """

    engine_start: EngineStart
    weather: str
    noise_parameters: dict[str, float] = Field(default_factory=dict)
    output_dir: str = ""


class Ack(Message):
    """The node took a request. `episode` is the one that is running or starting now, of each slot.

    After a reset, `episode_starts` has an entry for each slot that was reset.
    """

    episode: list[Count]
    episode_starts: list[EpisodeStart] = Field(default_factory=list)


class ErrorReply(Message):
    """The node did not take a request: an error class of `topics.errors` and its text."""

    error: str
    message: str


class ControllerStatus(Message):
    """One controller that has claimed something.

    `accepted_late`: of the accepted commands, those that came after the deadline; `late`: those that were refused
    because their step was over. `missed`: timesteps that went on without its command. `bypassed`: it has gone, and the
    policy goes on without it.
    `unresponsive`: it gave no command by the deadline, and none since. `response`: from a sample to its answer.
    """

    controller: str
    priority: Priority
    actuators: Count
    required: bool
    connected: bool
    accepted: Count
    late: Count = 0
    rejected: Count = 0
    duplicate: Count = 0
    missed: Count = 0
    bypassed: bool = False
    unresponsive: bool = False
    accepted_late: Count = 0
    response: LatencySummary = LatencySummary()


class ForkStatus(Message):
    """A snapshot or branch of a node: at which sample of slot 0, and the memory that is its own alone."""

    name: str
    owner: str
    step: Count
    engines: Count
    private_bytes: Count


class Status(Message):
    """Where a node stands.

    `faults`: the injected faults that are on now. `engine_private_bytes`, and the `private_bytes` of its forks: what
    they share with no other process; 0 unless asked for.
    """

    node: SafeName
    state: State
    building: str
    weather: str
    mode: Mode
    speed: float = 1.0
    paused: bool = False
    policy: Policy = Policy.WAIT
    episode: list[Count]
    step: list[Count]
    steps: Count
    time: list[str]
    controllers: list[ControllerStatus]
    accepted: Count
    rejected: Count
    late: Count
    duplicate: Count
    failure: str = ""
    failure_error: str = ""
    node_rss_bytes: Count = 0
    engine_rss_bytes: Count = 0
    engine_private_bytes: Count = 0
    statistics: Statistics = Statistics()
    faults: list[str] = Field(default_factory=list)
    snapshots: list[ForkStatus] = Field(default_factory=list)
    branches: list[ForkStatus] = Field(default_factory=list)
