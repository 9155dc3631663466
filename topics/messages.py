"""Every message class of the bus.

Each is frozen, refuses unknown fields and refuses NaN and infinities: a message that exists is
valid. Arrays travel as raw little-endian float64 (`values`, `applied`) or uint8 (`mask`, `ruler`)
bytes in C order with the shape `(slots, points)`, in the manifest's order.
"""

from __future__ import annotations

from enum import IntEnum, IntFlag, StrEnum
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

SCHEMA = 1
"""Version of the contract; part of every key's root and of every message's encoding."""

SafeName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.\-]{0,127}$")]
"""A name that may stand as a chunk of a key: letters, digits, `_`, `.`, `-`; at most 128."""

# Strict where strangers write: a text is no number, and true is no step.
Count = Annotated[int, Field(ge=0, strict=True)]
Level = Annotated[int, Field(ge=1, le=16, strict=True)]
Finite = Annotated[float, Field(strict=True)]
Raw = Annotated[bytes, Field(strict=True)]
Scalar = Annotated[str, Field(strict=True)] | Annotated[bool, Field(strict=True)] | Annotated[int, Field(strict=True)]


class Message(BaseModel):
    """Base of everything that travels."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, ser_json_inf_nan="null")


class Reading(StrEnum):
    """How a sensor is read over a timestep.

    `MEAN` and `SUM` are what EnergyPlus reports for the timestep: the time-weighted mean, or the sum,
    over its system timesteps. `INSTANT` is the state at the end of the timestep.
    """

    MEAN = "mean"
    SUM = "sum"
    INSTANT = "instant"


class Mode(StrEnum):
    """Who sets the pace of simulated time."""

    LOCKSTEP = "lockstep"
    FREE = "free"


class Policy(StrEnum):
    """What the node does when a required controller gives no valid command."""

    WAIT = "wait"


class State(StrEnum):
    """Where a node stands in an episode."""

    STARTING = "starting"
    WAITING = "waiting"
    RUNNING = "running"
    ENDED = "ended"
    FAILED = "failed"
    STOPPED = "stopped"


class Start(StrEnum):
    """How the engine of an episode came to sample 0.

    `READY`: it waited there untouched. `FORKED`: from one that waits there. `AHEAD`: it was started while the episode
    before ran. `STARTED`: afresh.
    """

    NONE = ""
    READY = "ready"
    FORKED = "forked"
    AHEAD = "ahead"
    STARTED = "started"


class Flag(IntFlag):
    """What a sample says about its episode."""

    NONE = 0
    FIRST = 1
    TRUNCATED = 2


class Mask(IntEnum):
    """What a command does to one actuator at the controller's level."""

    KEEP = 0
    SET = 1
    RELEASE = 2


class Sensor(Message):
    """An EnergyPlus output variable, under a name of the user's."""

    name: SafeName
    variable: str
    key: str
    unit: str
    reading: Reading
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


class Choice(Message):
    """One discrete dimension: the actions that it sets, and a row of their values for each choice."""

    actions: Annotated[tuple[SafeName, ...], Field(min_length=1)]
    values: Annotated[tuple[tuple[float, ...], ...], Field(min_length=1)]


class Limit(Message):
    """An episode is terminated when one of the points has been outside the range for `for_s` without a break."""

    points: Annotated[tuple[SafeName, ...], Field(min_length=1)]
    low: float | None = None
    high: float | None = None
    for_s: Annotated[float, Field(ge=0)] = 0.0


class Task(Message):
    """What an agent of this node observes besides its points, what it decides, and what it is rewarded for.

    With `choices` the action is discrete: one number for each of them. Without, it is a value for each of
    `actions`. `reward` is a kind and its parameters, as `agent_sdk.rewards` reads them; `wrappers` are names and
    arguments, the innermost first, as `agent_sdk.wrappers` reads them.
    """

    scenario: str = ""
    time: tuple[TimeField, ...] = ()
    actions: tuple[Action, ...] = ()
    choices: tuple[Choice, ...] = ()
    reward: dict[str, Any] | None = None
    terminate: tuple[Limit, ...] = ()
    wrappers: tuple[dict[str, Any], ...] = ()


class Versions(Message):
    """What a node is made of."""

    zenostat: str
    energyplus: str
    contract: int = SCHEMA


class Manifest(Message):
    """All that a stranger needs to read a node's samples and to command it."""

    node: SafeName
    instance: str
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
    mode: Mode
    policy: Policy
    sensors: tuple[Sensor, ...]
    meters: tuple[Meter, ...]
    actuators: tuple[Actuator, ...]
    task: Task = Task()
    warnings: tuple[str, ...] = ()
    versions: Versions
    host: str = ""
    cpu: int | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of `Sample.values`: the sensors, then the meters."""
        return tuple(p.name for p in self.sensors) + tuple(p.name for p in self.meters)


class Sample(Message):
    """One frame a step. Lists have an entry a slot; slot 0 is the only one of a plain node.

    `values` are the sensors, then the meters. `applied` says what each actuator really was in the
    timestep that this sample closes; NaN where EnergyPlus has no variable that tells. `ruler` is an
    index into `rulers`: who set it, with `rulers[0]` the building's own control.
    """

    episode: list[Count]
    step: list[Count]
    time: list[str]
    elapsed_s: list[float]
    flags: list[int]
    values: bytes
    applied: bytes
    ruler: bytes
    rulers: list[str]
    late: Count = 0
    rejected: Count = 0


class Command(Message):
    """A controller's answer to sample `step` of `episode`; it rules timestep `step + 1`.

    `values` has all actuators of all slots. `mask` (one `Mask` byte each) says which of them are
    set, kept as they are, or released; without it all are set. `values` stands last, so that a command's
    bytes are a head that the node can foresee and the values: it needs no decoding (`codec.command_head`).
    """

    episode: list[Count]
    step: list[Count]
    mask: Raw | None = None
    values: Raw


class Write(Message):
    """One actuator, written by a device or a person; `value` None releases it.

    `priority` as in BACnet: 1 the highest, 16 the lowest, 8 a person's.
    `for_s`: seconds of simulated time after which it is released by itself.
    """

    value: Finite | None
    priority: Level = 8
    for_s: Annotated[float, Field(gt=0, strict=True)] | None = None
    source: str = "anonymous"


class PointValue(Message):
    """One point at one step, for dashboards and devices that want just that."""

    value: float
    unit: str
    episode: Count
    step: Count
    time: str


class EventKind(StrEnum):
    """What an event tells."""

    STARTED = "started"
    ENDED = "ended"
    FAILED = "failed"
    STOPPED = "stopped"
    REJECTED = "rejected"
    LATE = "late"
    DUPLICATE = "duplicate"
    WRITTEN = "written"
    EXPIRED = "expired"
    JOINED = "joined"
    LEFT = "left"
    WARNING = "warning"


class Event(Message):
    """What happened on a node; `source` is the controller or device that it is about."""

    kind: EventKind
    text: str
    source: str = ""
    error: str = ""
    episode: Count = 0
    step: Count = 0


class Claim(Message):
    """Asks for a priority level on actuators (None: all). Required controllers are waited for."""

    controller: SafeName
    level: Level = 10
    actuators: list[str] | None = None
    required: bool = True


class Reset(Message):
    """Asks for a new episode."""

    controller: str = ""
    seed: Annotated[int, Field(ge=0)] | None = None
    options: dict[str, Scalar | Finite | None] = Field(default_factory=dict)


class Stop(Message):
    """Asks the node to end."""

    source: str = ""


class WeatherQuery(Message):
    """Asks for columns of the weather file that the present episode reads, by their EPW names."""

    columns: Annotated[list[str], Field(min_length=1, max_length=40)]


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


class Ask(Message):
    """A question without parameters (status, scenario)."""


class Accepted(Message):
    """The node took a request. `episode` is the one that is running or starting now.

    After a reset, `start` says how its engine came to sample 0, `weather` is the episode's weather file, `drawn` the
    parameters of its variability, by column (`dry_bulb_temperature.sigma`), and `outputs` the folder of EnergyPlus's
    own files, if they are kept.
    """

    episode: list[Count]
    start: Start = Start.NONE
    weather: str = ""
    drawn: dict[str, float] = Field(default_factory=dict)
    outputs: str = ""


class Denied(Message):
    """The node did not take a request: an error class of `topics.errors` and its text."""

    error: str
    message: str


class ControllerStatus(Message):
    """One controller that has claimed something."""

    controller: str
    level: Level
    actuators: Count
    required: bool
    present: bool
    accepted: Count


class Status(Message):
    """Where a node stands."""

    node: SafeName
    state: State
    building: str
    weather: str
    mode: Mode
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
    node_rss_bytes: Count = 0
    engine_rss_bytes: Count = 0
