"""Requests to a node, and their replies."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from topics.messages.base import Count, Message, Priority, SafeName, Seed, SourceName
from topics.messages.enums import EngineStart, Mode


class Claim(Message):
    """Asks for a priority level on actuators (None: all). Required controllers are waited for."""

    controller: SafeName
    priority: Priority = 10
    actuators: list[str] | None = None
    required: bool = True


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
