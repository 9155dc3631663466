"""The file of a district: its plants and their connections, with the line of each for errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, get_type_hints

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Discriminator, Field, Tag, create_model

from zenostat.cosim.market import MarketSpec
from zenostat.topics.calendar import parse_duration
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.file_fields import as_tuple
from zenostat.topics.file_kinds import FileKind
from zenostat.topics.messages.base import SafeName
from zenostat.topics.model_file import FileErrors, read_with_lines
from zenostat.topics.scenario_fields import MEANING, NodeArguments
from zenostat.topics.yaml12 import Lines

RESERVED = ("balance", "exchange", "loop", "plant", "residual")
"""First parts of the names of the orchestrator's own points; no plant has such a name."""

BUILDING_KINDS = ("building", "scenario", "config")
"""Fields that make a plant a building; any of them."""


class OnLost(StrEnum):
    """Reaction to the end of a plant's node.

    `WAIT`: all others wait until it is back; it is brought to the present step with the commands that it had. `GO_ON`
    (`continue` in files): its last values hold until it is back. `STOP`: the episode ends with an error.
    """

    WAIT = "wait"
    GO_ON = "continue"
    STOP = "stop"


class Resample(StrEnum):
    """Conversion of the values of one timestep to those of another one.

    `HOLD`: the latest value. `MEAN`: the mean over the timestep, which keeps the sum. `INTERPOLATE`: the mean of the
    straight lines through the samples.
    """

    HOLD = "hold"
    MEAN = "mean"
    INTERPOLATE = "interpolate"


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, populate_by_name=False)


def _duration(value: float | str) -> float:
    if isinstance(value, str):
        try:
            return parse_duration(value, "the duration")
        except InvalidConfig as error:
            raise ValueError(str(error)) from None
    return value


def _kind_of_duration(value: Any) -> str:
    return "@text" if isinstance(value, str) else "@seconds"


Duration = Annotated[
    Annotated[float, Field(gt=0), Tag("@seconds")] | Annotated[str, Tag("@text")],
    Discriminator(_kind_of_duration),
    AfterValidator(_duration),
]
"""Seconds, or a text such as `15min`."""


def _whole_microseconds(value: float | str) -> float | str:
    if isinstance(value, float) and (value < 1e-6 or round(value, 6) != value):
        raise ValueError("a whole number of microseconds expected, at least 1")
    return value


Timestep = Annotated[Duration, AfterValidator(_whole_microseconds)]
"""A duration that can be a timestep."""

PlantName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_\-]{0,63}$")]
"""A name without dots: `office.zone_temperature` is the point `zone_temperature` of the plant `office`."""

PointName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_\-]*\.[A-Za-z0-9_.\-]+$")]
"""A point with its plant: `PLANT.POINT`."""


Targets = Annotated[
    tuple[PointName, ...],
    Field(min_length=1),
    BeforeValidator(as_tuple, json_schema_input_type=PointName | Annotated[list[PointName], Field(min_length=1)]),
]
"""One point, or several that get the same value."""


class _PlantFields(_Part):
    """Fields of a plant besides the settings of its node."""

    node: SafeName | None = Field(None, description="Name of a node that runs already, on the bus of `connect`.")
    connect: str | None = Field(None, description="Endpoint of the bus of `node`, such as tcp/127.0.0.1:7447.")
    keys: Path | None = Field(None, description="Folder of the keys for the bus of `node`.")
    district: Path | None = Field(None, description="File of another district, which is a plant of this one.")
    market: MarketSpec | None = Field(None, description="A market, whose price reaches bidders by connections.")
    on_lost: OnLost | None = Field(None, description="Reaction to the end of its node; by default the district's.")


_NOT_OF_A_PLANT = ("file", "record", "record_on_full", "baseline")
_SETTINGS: dict[str, Any] = {
    name: (hint, Field(default=None, description=MEANING[name]))
    for name, hint in get_type_hints(NodeArguments).items()
    if name not in _NOT_OF_A_PLANT
}
PlantSpec: Any = create_model("PlantSpec", __base__=_PlantFields, __doc__="A plant.", **_SETTINGS)
"""A plant: what it is, and the settings of its node as in a scenario."""

OWN_FIELDS = tuple(_PlantFields.model_fields)
"""Fields of a plant that are not settings of its node."""


class ConnectionSpec(_Part):
    """A connection from a sensor or meter of one plant to an actuator of another, or of the same one."""

    source: PointName = Field(alias="from", description="PLANT.POINT, a sensor or meter.")
    targets: Targets = Field(alias="to", description="PLANT.POINT, an actuator, or a list of several.")
    name: SafeName | None = Field(None, description="Name in points and reports; by default FROM-TO.")
    unit: str | None = Field(
        None,
        description="Unit to which the source is converted before the factor, which makes the result a value in the "
        "target's unit, whatever this unit is; by default the target's unit.",
    )
    factor: float = Field(1.0, description="Factor, after the conversion of units.")
    offset: float = Field(0.0, description="Added after the factor, in the target's unit.")
    low: float | None = Field(None, description="Lowest value, in the target's unit.")
    high: float | None = Field(None, description="Highest value, in the target's unit.")
    sum: bool = Field(default=False, description="Add the values of all connections to this target.")
    resample: Resample | None = Field(
        None,
        description="Conversion between different timesteps: hold, mean or interpolate; by default mean for powers, "
        "flows and amounts of a timestep, hold for others.",
    )
    delay: Annotated[int, Field(ge=1, le=10_000)] | None = Field(None, description="Delay in steps of the district.")
    solve: bool = Field(default=False, description="Solve the loop of this connection in each step, by trials.")
    tolerance: Annotated[float, Field(gt=0)] | None = Field(
        None, description="Greatest residual of a solved connection, in the target's unit."
    )
    initial: float | None = Field(
        None,
        description="Value of a delayed connection before there is one, and of a solved one in the first trial, in the "
        "target's unit; by default that of sample 0.",
    )


class SolverSpec(_Part):
    """Limits of the solver of loops."""

    trials: int = Field(12, ge=1, le=1000, description="Greatest number of trials of a step.")
    depth: int = Field(3, ge=0, le=10, description="Depth of Anderson acceleration.")
    damping: float = Field(1.0, gt=0, le=1, description="Relaxation factor of Anderson acceleration.")


class DistrictSpec(_Part):
    """A district: plants and their connections."""

    name: SafeName = Field("district", description="Name of the orchestrator's node.")
    about: str = Field("", description="Description for users.")
    timestep: Timestep | None = Field(
        None, description="Seconds, or a text such as 15min; by default the longest timestep of the plants."
    )
    start: str | None = Field(
        None, description="First day, MM-DD or YYYY-MM-DD; of buildings that have no `begin` as well."
    )
    duration: Duration | None = Field(
        None, description="Length of an episode, such as 1d; by default that of the plant that ends first."
    )
    on_lost: OnLost = Field(OnLost.STOP, description="Reaction to the end of a plant: wait, continue or stop.")
    lost_timeout: Duration = Field(300.0, description="Longest wait for a plant that is lost, in wall time.")
    solver: SolverSpec = Field(SolverSpec(), description="Limits of the solver of loops.")
    reward: dict[str, Any] | None = Field(
        None, description="Reward of environments: kind and parameters; points are named PLANT.POINT."
    )
    plants: dict[PlantName, PlantSpec] = Field(min_length=1, description="Plants by name.")
    connections: tuple[ConnectionSpec, ...] = Field((), description="Connections between points.")


@dataclass(frozen=True, slots=True)
class Connection:
    """A connection to one target; those of an entry with several targets have the same value.

    Attributes:
        entry: index of the entry in the file.
        spec: the entry.
        target: PLANT.POINT.
        name: in points and reports.
    """

    entry: int
    spec: ConnectionSpec
    target: str
    name: str

    @property
    def source(self) -> str:
        """PLANT.POINT."""
        return self.spec.source

    @property
    def location(self) -> tuple[str | int, ...]:
        """Path of the entry in the file."""
        return ("connections", self.entry)


def _connections(spec: DistrictSpec) -> tuple[Connection, ...]:
    connections = []
    for entry, each in enumerate(spec.connections):
        for number, target in enumerate(each.targets, 1):
            name = each.name or f"{each.source}-{target}"
            suffix = f"-{number}" if each.name and len(each.targets) > 1 else ""
            connections.append(Connection(entry, each, target, name + suffix))
    return tuple(connections)


@dataclass(frozen=True)
class DistrictFile:
    """A district's file that has the right form.

    Attributes:
        path: the file.
        spec: its content.
        raw: the fields of each plant as they are in the file.
        lines: lines of its values.
        connections: to one target each, in the order of the file.
    """

    path: Path
    spec: DistrictSpec
    raw: Mapping[str, Mapping[str, Any]]
    lines: Lines
    connections: tuple[Connection, ...]

    def errors(self) -> FileErrors:
        """Return a new list of errors."""
        return FileErrors(self.path, self.lines)

    def line_of(self, connection: int) -> int:
        """Return the line of one of `connections`."""
        return self.lines.at(self.connections[connection].location)


def read_district(path: Path) -> DistrictFile:
    """Read a district's file and check its form.

    Raises:
        InvalidConfig: the file cannot be read, or a field is unknown, missing or wrong; lists all errors with lines.
    """
    spec, mapping, errors = read_with_lines(path, DistrictSpec, FileKind.DISTRICT)
    return DistrictFile(errors.path, spec, mapping["plants"], errors.lines, _connections(spec))


def kind_of(plant: Any) -> tuple[str, ...]:
    """Return the fields that say what a plant is, of which there should be one; those of a building count as one."""
    kinds = [
        name
        for name in ("plant", "fmu", "grid", "district", "node", "market")
        if getattr(plant, name, None) is not None
    ]
    if any(getattr(plant, name, None) is not None for name in BUILDING_KINDS):
        kinds.insert(0, "building")
    return tuple(kinds)


def json_schema() -> dict[str, Any]:
    """Return the JSON schema of district files, for editors."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **DistrictSpec.model_json_schema(by_alias=True)}
