"""Requests to a node, and their replies."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from zenostat.topics.messages.base import Count, Finite, Lines, Message, Priority, Raw, SafeName, Seeds, SourceName
from zenostat.topics.messages.enums import EngineStart, Mode


class Claim(Message):
    """Claim a priority of some actuators (None: all). In lockstep, the node waits for required controllers."""

    controller: SourceName = ""
    priority: Priority = 10
    actuators: list[str] | None = None
    required: bool = True


class Reset(Message):
    """Start a new episode in all slots or in some, or return to a snapshot.

    `seed`: restarts the random draws of weather and noise. With one seed for several slots, the first slot gets this
    seed, the next one `seed + 1` and so on; a list has a seed per slot.
    """

    controller: SourceName = ""
    seed: Seeds = None
    slots: Annotated[list[Count], Field(min_length=1)] | None = None
    snapshot: str = ""


class TakeSnapshot(Message):
    """Take a snapshot of the running episode; it is kept until it is dropped or its owner disconnects."""

    controller: SourceName = ""


class SnapshotTaken(Message):
    """A snapshot's name, and the episode and step of each slot."""

    snapshot: str
    episode: list[Count]
    step: list[Count]


class DropSnapshot(Message):
    """Drop a snapshot and free its memory. On a bus with keys, its owner drops it."""

    snapshot: str
    controller: SourceName = ""


class CreateBranch(Message):
    """Create a branch: a node that continues independently from the current sample or from a snapshot.

    A branch ends on a `Stop`, when its owner disconnects, or with its parent. `relinquished`: the branch starts with
    all commands relinquished, under baseline control. `slots`: number of engines of the branch, all forked from the
    slot `slot`. `forecast_error`: added to the outdoor dry-bulb temperature in the branch's timesteps, K, one value for
    each; the last one stays. The branch then is a forecast of the weather with errors.
    """

    controller: SourceName = ""
    snapshot: str = ""
    relinquished: bool = False
    slots: Annotated[int, Field(ge=1, le=256, strict=True)] = 1
    slot: Count = 0
    forecast_error: Annotated[list[Annotated[Finite, Field(ge=-50, le=50)]], Field(max_length=2000)] = Field(
        default_factory=list
    )


class BranchCreated(Message):
    """The node name of a branch."""

    node: SafeName


class SimulatePlan(Message):
    """Simulate several timesteps of a branch, with a command for each of them, in one request.

    `episode`, `step`: those of the current sample, which the first command answers. `values`: float64, shape
    (timesteps, slots, actuators). `operations`: as those of a `Command`, in the shape of `values`; None sets all. The
    commands are those of the controller, which has the only required claim.
    """

    controller: SourceName = ""
    episode: list[Count]
    step: list[Count]
    timesteps: Annotated[int, Field(ge=1, le=2000, strict=True)]
    operations: Raw | None = None
    values: Raw


class PlanSimulated(Message):
    """The samples of a plan: the payload of each timestep's `Sample`; fewer than requested if all episodes end."""

    samples: list[bytes]


class TrySteps(Message):
    """Simulate timesteps from the current sample under alternative commands, on copies of the plant.

    The node stays at its sample, and nothing of a trial is published or recorded. `episode`, `step`: those of the
    current sample; None is the present ones. `values`: float64, shape (alternatives, timesteps, slots, actuators).
    `operations`: as those of a `Command`, in the shape of `values`; None sets all. The sender's claim determines its
    priority and its actuators; `priority` is that of a sender without a claim, which may command all actuators.
    """

    controller: SourceName = ""
    episode: list[Count] | None = None
    step: list[Count] | None = None
    alternatives: Annotated[int, Field(ge=1, le=256, strict=True)]
    timesteps: Annotated[int, Field(ge=1, le=2000, strict=True)] = 1
    priority: Priority = 10
    operations: Raw | None = None
    values: Raw


class StepsTried(Message):
    """The samples of a trial: the payload of each timestep's `Sample`, those of the first alternative first.

    Each alternative has equally many: fewer than requested if an episode ends.
    """

    samples: list[bytes]


class SetPace(Message):
    """Change the mode, or the speed in paced mode (simulated seconds per second of wall time), from now on.

    The mode `paced` needs a `speed`, and the others have none.
    """

    source: SourceName = ""
    mode: Mode = Mode.PACED
    speed: Annotated[float, Field(ge=1e-6, le=1e9, strict=True)] | None = None


class Pause(Message):
    """Pause the node, in any mode."""

    source: SourceName = ""


class Resume(Message):
    """Resume a paused node; in paced mode it does not catch up."""

    source: SourceName = ""


class StepRequest(Message):
    """Simulate some timesteps of a paused node: in lockstep as they are answered, otherwise immediately."""

    source: SourceName = ""
    steps: Annotated[int, Field(ge=1, le=1_000_000, strict=True)] = 1


class Stop(Message):
    """Stop the node.

    `instance`: that of the node's manifest. A branch has that of its node. A node of the name with another instance
    rejects the request; empty: every node of the name accepts it.
    """

    source: SourceName = ""
    instance: str = ""


class Revoke(Message):
    """Revoke the name of a certificate on this node: its claims end, and the node accepts nothing of it any more.

    Names below it are revoked as well. The node keeps the name in the file `revoked.txt` in its folder of keys.
    """

    name: SafeName
    source: SourceName = ""


class WeatherQuery(Message):
    """Request columns, by their EPW names, of the weather file that a slot's current episode reads."""

    columns: Annotated[list[str], Field(min_length=1, max_length=40)]
    slot: Count = 0


class WeatherSeries(Message):
    """The weather of an episode and of the week after it, as EnergyPlus reads it, including noise.

    `values` is raw, of shape (rows, columns). Row k is valid `step_s * (k + 1)` seconds after the start of the episode;
    NaN where the file has no value.
    """

    episode: Count
    columns: list[str]
    units: list[str]
    step_s: float
    values: bytes


class ScenarioText(Message):
    """The scenario that a node simulates, as a scenario file (YAML)."""

    text: Lines


class SemanticModel(Message):
    """The semantic model of a node's building as Turtle: a Brick graph with references to its points."""

    text: Lines


class PriorityArrays(Message):
    """The priority array of each actuator, in manifest order, as it is before the next timestep.

    `values` is raw, of shape (slots, actuators, 16): element p - 1 is the value at priority p, NaN where it is
    relinquished (BACnet: Null). `source_index`, of the same shape, has the source of each value, an index into
    `sources`; it is 0 where a value is relinquished. `remaining_s` is raw, of shape (actuators, 16): simulated seconds
    after which a written value is relinquished, NaN for values without a duration; empty if there is none with one.
    """

    episode: list[Count]
    step: list[Count]
    values: bytes
    source_index: bytes
    sources: list[str]
    remaining_s: bytes = b""


class Query(Message):
    """Query of a node's status, scenario, geometry, semantic model, systems or priority arrays.

    `memory`: include each process's private memory in the status.
    """

    memory: bool = False


class EpisodeStart(Message):
    """The start of an episode in one slot.

    `engine_start`: how its engine reached the first sample. `weather`: the weather file. `noise_parameters`: the
    parameters of the weather noise, by column (`dry_bulb_temperature.sigma`). `output_dir`: the folder of EnergyPlus's
    output files, if they are kept.
    """

    engine_start: EngineStart
    weather: str
    noise_parameters: dict[str, float] = Field(default_factory=dict)
    output_dir: str = ""


class Ack(Message):
    """The node accepted a request. `episode`: of each slot, the episode that is running or starting.

    After a reset, `episode_starts` has an entry for each slot that was reset. After a command or a write, `step` is the
    current step of each slot, after which it takes effect, and `text` describes a write.
    """

    episode: list[Count]
    step: list[Count] = Field(default_factory=list)
    text: Lines = ""
    episode_starts: list[EpisodeStart] = Field(default_factory=list)


class ErrorReply(Message):
    """The node rejected a request: an error class of `zenostat.topics.errors` and its text."""

    error: str
    message: Lines
