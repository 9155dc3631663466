"""The manifest: the description that a node publishes of itself."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Annotated, Any

from pydantic import Field

from zenostat.topics.errors import BadMessage
from zenostat.topics.messages.base import SCHEMA_VERSION, Count, Lines, Message, SafeName
from zenostat.topics.messages.enums import Aggregation, Mode, Policy, TimeField
from zenostat.topics.messages.status import Statistics


class Sensor(Message):
    """A measured point; of EnergyPlus, the output variable `variable` of the object `key`.

    `observed`: whether it is part of an agent's observation; pictures, reports and metrics may use any point.
    `lead_s`: for a schedule, how long after the sample's time it has this value; one timestep is the value in effect
    during the next one.
    """

    name: SafeName
    variable: str = ""
    key: str = ""
    unit: str
    aggregation: Aggregation = Aggregation.INSTANT
    lead_s: Annotated[float, Field(ge=0)] = 0.0
    low: float | None = None
    high: float | None = None
    observed: bool = True


class Meter(Message):
    """A meter: the consumption in the timestep (J for energy); of EnergyPlus, the meter `meter`.

    `observed`: as for `Sensor`.
    """

    name: SafeName
    meter: str = ""
    unit: str
    low: float | None = None
    high: float | None = None
    observed: bool = True


class Actuator(Message):
    """A point that can be commanded.

    Of EnergyPlus, `component_type`, `control_type` and `key` name the actuator, and `feedback` the output variable that
    reports its effective value. `default` is its value while nobody commands it, where that is constant.
    `baseline_sensor` is the sensor of its value under baseline control in the next timestep, where that is known.
    """

    name: SafeName
    component_type: str = ""
    control_type: str = ""
    key: str = ""
    unit: str
    low: float | None = None
    high: float | None = None
    default: float | None = None
    feedback: str | None = None
    baseline_sensor: SafeName | None = None


class Action(Message):
    """One dimension of an agent's action: it sets all its actuators to the same value.

    With `relative` it is an offset, and `low` and `high` are its bounds: each actuator is set to its value under
    baseline control, which its `baseline_sensor` has, plus the offset, within the actuator's bounds. An offset of 0
    relinquishes the actuator to baseline control.
    """

    name: SafeName
    unit: str
    low: float | None = None
    high: float | None = None
    actuators: Annotated[tuple[SafeName, ...], Field(min_length=1)]
    relative: bool = False


class DiscreteAction(Message):
    """One discrete dimension of an agent's action: `values` has a row of values for `actions` for each choice."""

    actions: Annotated[tuple[SafeName, ...], Field(min_length=1)]
    values: Annotated[tuple[tuple[float, ...], ...], Field(min_length=1)]


class TerminationLimit(Message):
    """Terminates an episode once a point has been outside its range for `duration_s` without interruption."""

    points: Annotated[tuple[SafeName, ...], Field(min_length=1)]
    low: float | None = None
    high: float | None = None
    duration_s: Annotated[float, Field(ge=0)] = 0.0


class Task(Message):
    """The agent's part of a scenario: time features, actions, reward, termination limits and wrappers.

    With `discrete_actions` the action is discrete: a number for each of them. Otherwise it is a value for each of
    `actions`. `reward` is what the environment pays: a kind with its parameters, as `zenostat.rewards` reads them, or
    `{"kind": "custom", "name": …}` for code of the user's program. `scenario_reward` is the scenario's own reward where
    `reward` replaces it: its comfort band applies where `reward` has none. `wrappers` are names with arguments,
    innermost first, as `zenostat.wrappers` reads them.
    """

    scenario: str = ""
    time: tuple[TimeField, ...] = ()
    actions: tuple[Action, ...] = ()
    discrete_actions: tuple[DiscreteAction, ...] = ()
    reward: dict[str, Any] | None = None
    scenario_reward: dict[str, Any] | None = None
    terminate: tuple[TerminationLimit, ...] = ()
    wrappers: tuple[dict[str, Any], ...] = ()

    def with_reward(self, reward: dict[str, Any] | None) -> Task:
        """Return the task of an environment that pays another reward than the scenario's."""
        return self.model_copy(update={"reward": reward, "scenario_reward": self.scenario_reward or self.reward})


class Versions(Message):
    """Versions of a node's software and of its message schema; `energyplus` is empty for other plants."""

    zenostat: str
    energyplus: str = ""
    schema_version: int = SCHEMA_VERSION


class Manifest(Message):
    """Everything that a client needs to read a node's samples and to command the node.

    `building`: name of the building or plant. `zones`: names of all its zones, in its own order. `floor_area_m2`: floor
    area of the zones that EnergyPlus counts, with multipliers; None where it is unknown. `begin`, `end`: simulated time
    of the first and the last sample. `step_s`: length of a timestep in seconds. `steps`: number of timesteps of an
    episode. `slots`: number of copies that step together, each with its own episode. `branch_of`: the node that this
    one branched from. `replay`: whether it is the replay of a recording, which takes no requests. `baseline`: whether
    samples include the building under baseline control. `speed`: simulated seconds per second of wall time, in paced
    mode. `grace_s`: how long a controller may be disconnected before the fallback policy applies. `deadline_s`: how
    long each step waits for commands. `faults_injected`: whether samples contain injected faults. `history_samples`:
    how many of the latest samples of the present episode the node keeps for `rpc/history`, in `history_bytes` bytes of
    memory; a slot that does not step with the others has fewer of its own. `connected`: inputs of a district's plants
    that its connections determine, which are therefore no actuators, and the points that they are connected to.
    `statistics`: only in replies to queries.
    """

    node: SafeName
    instance: str
    branch_of: str = ""
    replay: bool = False
    building: str
    zones: tuple[str, ...] = ()
    floor_area_m2: Annotated[float, Field(gt=0)] | None = None
    weather: str = ""
    location: str = ""
    latitude_deg: float | None = None
    longitude_deg: float | None = None
    begin: str
    end: str
    step_s: Annotated[float, Field(gt=0, le=86400)]
    steps: Count
    slots: Annotated[int, Field(ge=1)] = 1
    baseline: bool = False
    mode: Mode
    speed: Annotated[float, Field(gt=0)] = 1.0
    policy: Policy
    grace_s: Annotated[float, Field(ge=0)] = 0.0
    deadline_s: Annotated[float, Field(gt=0)] | None = None
    faults_injected: bool = False
    history_samples: Count = 0
    history_bytes: Count = 0
    sensors: tuple[Sensor, ...]
    meters: tuple[Meter, ...]
    actuators: tuple[Actuator, ...]
    connected: dict[str, str] = Field(default_factory=dict)
    task: Task = Task()
    warnings: tuple[Lines, ...] = ()
    versions: Versions
    host: str = ""
    cpu: int | None = None
    statistics: Statistics | None = None

    @property
    def points(self) -> tuple[Sensor | Meter, ...]:
        """The points of `Sample.values`: the sensors, then the meters."""
        return (*self.sensors, *self.meters)

    @property
    def timestep(self) -> timedelta:
        """Length of a timestep."""
        return timedelta(seconds=self.step_s)

    @property
    def step_h(self) -> float:
        """Length of a timestep in hours."""
        return self.step_s / 3600.0

    def time_at(self, step: int) -> datetime:
        """Return the simulated time of the sample of a step, naive local standard time.

        Raises:
            BadMessage: It is after the year 9999, so the step is none of this node's.
        """
        try:
            return datetime.fromisoformat(self.begin) + step * self.timestep
        except OverflowError:
            raise BadMessage(f"step {step} is after the year 9999") from None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of `Sample.values`: the sensors, then the meters."""
        return tuple(point.name for point in self.points)

    @property
    def observed_points(self) -> tuple[Sensor | Meter, ...]:
        """The points of an agent's observation, in the order of `points`."""
        return tuple(point for point in self.points if point.observed)

    @property
    def observed_names(self) -> tuple[str, ...]:
        """Names of `observed_points`."""
        return tuple(point.name for point in self.observed_points)
