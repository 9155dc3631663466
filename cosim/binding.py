"""The connections of a district with the points of its plants: units, timesteps, bounds, and the time of an episode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from math import gcd

import numpy as np

from zenostat.bridge.node.plant import RunPeriod
from zenostat.bridge.python_plant.description import BEGIN
from zenostat.cosim.file import BUILDING_KINDS, Connection, DistrictFile, Resample, kind_of
from zenostat.cosim.market_plant import Market
from zenostat.cosim.resampling import TICK_S, Resampler, whole_steps
from zenostat.cosim.topology import MAX_POINT_NAME, Topology, plant_of
from zenostat.topics.arrays import Floats
from zenostat.topics.calendar import format_duration, parse_day
from zenostat.topics.errors import InvalidConfig, did_you_mean
from zenostat.topics.messages import Actuator, Aggregation, Manifest, Meter, Sensor
from zenostat.topics.model_file import FileErrors
from zenostat.topics.points import bounds, describe_bounds
from zenostat.topics.units import conversion, quantity

_RATES = ("power", "mass flow", "volume flow", "reactive power", "apparent power", "current")
"""Quantities that are exchanged as means over the timestep."""
_RATE_UNITS = {"J": "W", "kg": "kg/s", "m3": "m3/s", "L": "L/s"}
"""Units of amounts, and those of their rates."""


@dataclass(frozen=True, slots=True)
class Member:
    """A plant of the district, as its manifest describes it.

    Attributes:
        name: in the district.
        manifest: of its node.
        steps: number of its timesteps in a step of the district.
    """

    name: str
    manifest: Manifest
    steps: int

    @property
    def step_s(self) -> float:
        """Length of its timestep in seconds."""
        return self.manifest.step_s


@dataclass(frozen=True)
class Transfer:
    """A connection with its points.

    A value is converted (`factor`, `offset`), resampled, and limited to `low` and `high`, in this order.

    Attributes:
        entry: index of its entry in the file; connections of one entry have the same value.
        name: of the connection.
        source, target: names of the plants.
        column: of the source among the values of its plant.
        input: of the target among the actuators of its plant.
        unit: of the target.
        factor, offset: from the source's value to the target's unit.
        low, high: bounds; of a connection that is not added to others also those of the actuator.
        delay: steps of the district; 0: none.
        tolerance: of a solved connection; None: it is not solved.
        initial: first value; None: that of sample 0.
        resample: the conversion of timesteps.
        source_step_s, target_step_s: timesteps of the two plants.
        source_steps, target_steps: their numbers in a step of the district.
    """

    entry: int
    name: str
    source: str
    target: str
    column: int
    input: int
    unit: str
    factor: float
    offset: float
    low: float
    high: float
    delay: int
    tolerance: float | None
    initial: float | None
    resample: Resampler
    source_step_s: float
    target_step_s: float
    source_steps: int
    target_steps: int

    @property
    def balance_terms(self) -> tuple[str, ...]:
        """Terms of its balance, besides what it received, that may differ from 0; see `ConnectionBalance`."""
        may_differ = {
            "sent": True,
            "clipped": True,
            "resampled": not self.resample.is_identity,
            "residual": self.tolerance is not None,
            "stored": self.delay > 0,
        }
        return tuple(name for name, may in may_differ.items() if may)

    def convert(self, values: Floats) -> Floats:
        """Return values of the source in the target's unit."""
        if self.factor == 1.0 and self.offset == 0.0:
            return values
        return self.factor * values + self.offset

    def clip(self, values: Floats) -> Floats:
        """Return values within the bounds."""
        return np.minimum(np.maximum(values, self.low), self.high)


@dataclass(frozen=True, slots=True)
class Input:
    """An actuator that connections feed.

    Attributes:
        plant: name of its plant.
        actuator: the actuator.
        column: its index among those of the plant.
        transfers: indices of the connections, whose values are added.
        low, high: bounds of the actuator.
    """

    plant: str
    actuator: Actuator
    column: int
    transfers: tuple[int, ...]
    low: float
    high: float


@dataclass(frozen=True)
class Binding:
    """A district whose connections fit its plants.

    Attributes:
        members: the plants by name.
        transfers: the connections, in the order of the file.
        inputs: the actuators that they feed.
        topology: the order of a step.
        run_period: begin, step and number of steps of an episode.
        warnings: what may be wrong.
        markets: by the names of their plants.
    """

    members: Mapping[str, Member]
    transfers: tuple[Transfer, ...]
    inputs: tuple[Input, ...]
    topology: Topology
    run_period: RunPeriod
    warnings: tuple[str, ...] = field(default=())
    markets: Mapping[str, Market] = field(default_factory=dict)


def bind(file: DistrictFile, topology: Topology, manifests: Mapping[str, Manifest]) -> Binding:
    """Check the connections against the plants' points, and return them ready to use.

    Args:
        file: the district's file.
        topology: the order of a step, from `check_file`.
        manifests: of the plants' nodes, by the plants' names.

    Raises:
        InvalidConfig: lists all errors with their lines.
    """
    errors, warnings = file.errors(), list[str]()
    for name, manifest in manifests.items():
        if manifest.slots != 1:
            errors.add(("plants", name), f"plant {name!r} has {manifest.slots} slots; a plant of a district has one")
        _check_point_names(name, manifest, errors)
    step_s = _timestep(file, manifests, errors)
    errors.raise_if_any()
    members = {name: Member(name, m, round(step_s / m.step_s)) for name, m in manifests.items()}
    run_period = _run_period(file, members, step_s, errors, warnings)
    transfers = [_transfer(file, connection, members, errors, warnings) for connection in file.connections]
    errors.raise_if_any()
    bound = _with_common_bounds(file, [transfer for transfer in transfers if transfer is not None], errors)
    markets = _markets(file, members, errors)
    errors.raise_if_any()
    return Binding(members, bound, _inputs(bound, members), topology, run_period, tuple(warnings), markets)


def _check_point_names(plant: str, manifest: Manifest, errors: FileErrors) -> None:
    """Report points that have too long a name together with that of their plant."""
    points = (*manifest.points, *manifest.actuators, *manifest.task.actions)
    for name in dict.fromkeys(point.name for point in points):
        length = len(f"{plant}.{name}")
        if length > MAX_POINT_NAME:
            text = f"its point {plant}.{name} would have a name of {length} characters, of which there are at most "
            rest = MAX_POINT_NAME - len(f".{name}")
            advice = f"give plant {plant!r} a name of at most {rest}" if rest > 0 else "give the point a shorter name"
            errors.add(("plants", plant), f"{text}{MAX_POINT_NAME}; {advice}")


def _markets(file: DistrictFile, members: Mapping[str, Member], errors: FileErrors) -> dict[str, Market]:
    markets = {}
    for name, plant in file.spec.plants.items():
        if plant.market is None:
            continue
        plants, columns, factors = list[str](), list[int](), list[float]()
        for number, bidder in enumerate(plant.market.bidders):
            location = ("plants", name, "market", "bidders", number)
            member, point = members[plant_of(bidder.demand)], bidder.demand.partition(".")[2]
            if point not in member.manifest.names:
                near = did_you_mean(point, member.manifest.names)
                errors.add(location, f"{bidder.demand}: plant {member.name!r} has no sensor or meter {point!r}; {near}")
                continue
            column = member.manifest.names.index(point)
            demand = member.manifest.points[column]
            linear = _conversion(demand, member.step_s, "W", member.step_s)
            if linear is None:
                errors.add(location, f"{bidder.demand} is in {demand.unit}; a demand is a power, or an energy")
                continue
            plants.append(member.name)
            columns.append(column)
            factors.append(linear[0])
        markets[name] = Market(name, plant.market, tuple(plants), tuple(columns), tuple(factors))
    return markets


def _timestep(file: DistrictFile, manifests: Mapping[str, Manifest], errors: FileErrors) -> float:
    """Return the step of the district, of which each plant's timestep is a divisor."""
    spec = file.spec
    longest = max(manifests, key=lambda name: manifests[name].step_s)
    step_s = manifests[longest].step_s if spec.timestep is None else float(spec.timestep)
    for name, manifest in manifests.items():
        if not _divides(manifest.step_s, step_s):
            own = format_duration(manifest.step_s)
            if spec.timestep is not None:
                text = f"the timestep {format_duration(step_s)} is no multiple of the {own} of plant {name!r}"
                errors.add(("timestep",), text)
            else:
                text = f"the {own} of plant {name!r} do not divide the {format_duration(step_s)} of {longest!r}"
                common_s = _common_multiple([m.step_s for m in manifests.values()])
                hint = f"; set `timestep: {common_s:g}`" if common_s <= 86400.0 else ""
                errors.add(("plants", name), text + hint)
    return step_s


def _divides(part_s: float, whole_s: float) -> bool:
    return round(whole_s / TICK_S) % round(part_s / TICK_S) == 0


def _common_multiple(steps_s: Sequence[float]) -> float:
    multiple = 1
    for step_s in steps_s:
        ticks = round(step_s / TICK_S)
        multiple = multiple * ticks // gcd(multiple, ticks)
    return multiple * TICK_S


def _run_period(
    file: DistrictFile, members: Mapping[str, Member], step_s: float, errors: FileErrors, warnings: list[str]
) -> RunPeriod:
    """Return the time of an episode, which all plants can simulate."""
    lengths = {name: m.manifest.steps * m.step_s for name, m in members.items()}
    shortest = min(lengths, key=lambda name: lengths[name])
    if file.spec.duration is None:
        steps = whole_steps(lengths[shortest], step_s)
        if steps < 1:
            errors.add(
                ("plants", shortest), f"an episode of plant {shortest!r} is shorter than the timestep of {step_s:g} s"
            )
    else:
        duration_s = float(file.spec.duration)
        steps = round(duration_s / step_s)
        if steps < 1 or not _divides(step_s, duration_s):
            errors.add(("duration",), f"the duration {duration_s:g} s is no multiple of the timestep {step_s:g} s")
        for name, length_s in lengths.items():
            if duration_s > length_s:
                text = f"the duration is {format_duration(duration_s)}, but an episode of plant {name!r} ends after "
                errors.add(("duration",), text + format_duration(length_s))
    begin = _begin(file, members, errors, warnings)
    return RunPeriod(begin, step_s, steps)


def _begin(file: DistrictFile, members: Mapping[str, Member], errors: FileErrors, warnings: list[str]) -> datetime:
    """Return the time of sample 0: that of the first building, or else of the first plant."""
    begins = {name: member.manifest.time_at(0) for name, member in members.items()}
    buildings = [name for name, plant in file.spec.plants.items() if kind_of(plant) == ("building",)]
    reference = [*buildings, *begins][0]
    begin = begins[reference]
    if file.spec.start is not None:
        try:
            day = parse_day(file.spec.start, "start", begin.year)
        except InvalidConfig as error:
            errors.add(("start",), str(error))
            return begin
        if buildings and (begin.month, begin.day) != (day.month, day.day):
            text = f"plant {reference!r} begins on {begin:%m-%d}, not on {day:%m-%d}; leave out one of the two"
            errors.add(("start",), text)
        begin = datetime(day.year, day.month, day.day) if not buildings else begin
    for name, own in begins.items():
        is_building, is_market = name in buildings, file.spec.plants[name].market is not None
        if not is_building and not is_market and own != BEGIN and _time_of_year(own) != _time_of_year(begin):
            warnings.append(
                f"{file.path}:{file.lines.at(('plants', name))}: plant {name!r} begins at {own:%Y-%m-%d %H:%M}, the "
                f"district at {begin:%Y-%m-%d %H:%M}"
            )
    for name in buildings:
        if _time_of_year(begins[name]) != _time_of_year(begin):
            errors.add(
                ("plants", name),
                f"plant {name!r} begins at {begins[name]:%m-%d %H:%M}, {reference!r} at {begin:%m-%d %H:%M}",
            )
        elif begins[name].weekday() != begin.weekday():
            warnings.append(
                f"{file.path}:{file.lines.at(('plants', name))}: plant {name!r} begins on a {begins[name]:%A}, "
                f"{reference!r} on a {begin:%A}"
            )
    return begin


def _time_of_year(time: datetime) -> tuple[int, ...]:
    return time.month, time.day, time.hour, time.minute, time.second, time.microsecond


def _transfer(
    file: DistrictFile, connection: Connection, members: Mapping[str, Member], errors: FileErrors, warnings: list[str]
) -> Transfer | None:
    spec, location = connection.spec, connection.location
    source, target = members[plant_of(connection.source)], members[plant_of(connection.target)]
    point, actuator = _point(source, connection, errors), _actuator(target, connection, errors)
    if point is None or actuator is None:
        return None
    linear = _units(connection, (source, point), (target, actuator), errors)
    if linear is None:
        return None
    if _is_instant_power(source, point):
        warnings.append(
            f"{file.path}:{file.lines.at(location)}: {spec.source} is the value at the end of a timestep; energy is "
            "exchanged as a mean: choose the aggregation `mean`, or a meter"
        )
    is_added = [other.target for other in file.connections].count(connection.target) > 1
    low, high = bounds(spec) if is_added else _bounds(connection, actuator, errors)
    if spec.initial is not None and not low <= spec.initial <= high:
        errors.add(
            (*location, "initial"), f"initial = {spec.initial:g} is outside of {low:g} to {high:g} {actuator.unit}"
        )
    is_mean = _is_amount(point) or quantity(point.unit) in _RATES
    kind = spec.resample or (Resample.MEAN if is_mean else Resample.HOLD)
    return Transfer(
        entry=connection.entry,
        name=connection.name,
        source=source.name,
        target=target.name,
        column=source.manifest.names.index(point.name),
        input=[a.name for a in target.manifest.actuators].index(actuator.name),
        unit=actuator.unit,
        factor=linear[0],
        offset=linear[1],
        low=low,
        high=high,
        delay=spec.delay or 0,
        tolerance=spec.tolerance,
        initial=spec.initial,
        resample=Resampler(kind, source.steps, target.steps),
        source_step_s=source.step_s,
        target_step_s=target.step_s,
        source_steps=source.steps,
        target_steps=target.steps,
    )


def _with_common_bounds(file: DistrictFile, transfers: Sequence[Transfer], errors: FileErrors) -> tuple[Transfer, ...]:
    """Return the connections with the bounds that those of the same entry have in common, so that they are equal."""
    by_entry: dict[int, list[Transfer]] = {}
    for transfer in transfers:
        by_entry.setdefault(transfer.entry, []).append(transfer)
    common = {}
    for entry, group in by_entry.items():
        low, high = max(transfer.low for transfer in group), min(transfer.high for transfer in group)
        if len({(transfer.unit, transfer.target_steps) for transfer in group}) > 1:
            text = "its targets differ in unit or timestep, so they cannot have the same value; give each an entry"
            errors.add(("connections", entry), text)
        if low > high:
            targets = ", ".join(file.spec.connections[entry].targets)
            errors.add(("connections", entry), f"the bounds of {targets} have no value in common")
        common[entry] = low, high
    return tuple(replace(t, low=common[t.entry][0], high=common[t.entry][1]) for t in transfers)


def _point(member: Member, spec: Connection, errors: FileErrors) -> Sensor | Meter | None:
    name, points = spec.source.partition(".")[2], {point.name: point for point in member.manifest.points}
    if name in points:
        return points[name]
    is_actuator = name in {actuator.name for actuator in member.manifest.actuators}
    text = "is an actuator; a connection begins at a sensor or meter" if is_actuator else did_you_mean(name, points)
    kind = "" if is_actuator else f"plant {member.name!r} has no sensor or meter {name!r}; "
    errors.add((*spec.location, "from"), f"{spec.source}: {kind}{text}")
    return None


def _actuator(member: Member, spec: Connection, errors: FileErrors) -> Actuator | None:
    name, actuators = spec.target.partition(".")[2], {actuator.name: actuator for actuator in member.manifest.actuators}
    if name in actuators:
        return actuators[name]
    is_point = name in member.manifest.names
    text = "is a sensor or meter; a connection ends at an actuator" if is_point else did_you_mean(name, actuators)
    kind = "" if is_point else f"plant {member.name!r} has no actuator {name!r}; "
    errors.add((*spec.location, "to"), f"{spec.target}: {kind}{text}")
    return None


def _is_amount(point: Sensor | Meter) -> bool:
    """Return whether a point is the amount of a timestep, such as its energy, and not one that is stored."""
    is_sum = isinstance(point, Meter) or point.aggregation is Aggregation.SUM
    return is_sum and quantity(point.unit) not in _RATES


def _is_instant_power(source: Member, point: Sensor | Meter) -> bool:
    return (
        bool(source.manifest.versions.energyplus)
        and isinstance(point, Sensor)
        and point.aggregation is Aggregation.INSTANT
        and quantity(point.unit) == "power"
    )


def _units(
    connection: Connection, source: tuple[Member, Sensor | Meter], target: tuple[Member, Actuator], errors: FileErrors
) -> tuple[float, float] | None:
    """Return factor and offset from a value of the source to one in the target's unit."""
    spec, location = connection.spec, connection.location
    (sender, point), (receiver, actuator) = source, target
    unit = spec.unit or actuator.unit
    linear = _conversion(point, sender.step_s, unit, receiver.step_s)
    if linear is None and spec.unit is not None:
        errors.add((*location, "unit"), f"{spec.source} is in {point.unit}, which is not converted to {spec.unit}")
        return None
    if linear is None:
        errors.add(
            location,
            f"{spec.source} is in {point.unit} and {connection.target} in {actuator.unit}, which are unlike; if the "
            f"factor is meant to convert them, name the unit that it begins with: `unit: {point.unit}`",
        )
        return None
    return spec.factor * linear[0], spec.factor * linear[1] + spec.offset


def _conversion(
    point: Sensor | Meter, source_step_s: float, unit: str, target_step_s: float
) -> tuple[float, float] | None:
    linear = conversion(point.unit, unit)
    if not _is_amount(point):
        return linear
    if linear is not None:  # an amount of the target's timestep, at the same rate
        return (linear[0] * (target_step_s / source_step_s), linear[1])
    for amount, rate in _RATE_UNITS.items():
        to_amount, from_rate = conversion(point.unit, amount), conversion(rate, unit)
        if to_amount is not None and from_rate is not None:
            return to_amount[0] / source_step_s * from_rate[0], 0.0
    return None


def _bounds(connection: Connection, actuator: Actuator, errors: FileErrors) -> tuple[float, float]:
    """Return the bounds of a connection that is not added to others: its own, within those of its actuator."""
    low, high = bounds(connection.spec)
    lowest, highest = bounds(actuator)
    if low > highest or high < lowest:
        errors.add(
            connection.location,
            f"{low:g} to {high:g} has no value within the bounds of {connection.target}, {describe_bounds(actuator)}",
        )
    return max(low, lowest), min(high, highest)


def _inputs(transfers: Sequence[Transfer], members: Mapping[str, Member]) -> tuple[Input, ...]:
    by_target: dict[tuple[str, int], list[int]] = {}
    for position, transfer in enumerate(transfers):
        by_target.setdefault((transfer.target, transfer.input), []).append(position)
    inputs = []
    for (plant, column), positions in by_target.items():
        actuator = members[plant].manifest.actuators[column]
        inputs.append(Input(plant, actuator, column, tuple(positions), *bounds(actuator)))
    return tuple(inputs)


def is_building(plant: Mapping[str, object]) -> bool:
    """Return whether the fields of a plant in a file are those of a building."""
    return any(name in plant for name in BUILDING_KINDS)
