"""The manifest: the description that a node publishes of itself."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from topics.messages.base import SCHEMA_VERSION, Count, Message, SafeName
from topics.messages.enums import Aggregation, Mode, Policy, TimeField
from topics.messages.status import Statistics


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
