"""The file of an electric grid: its fields, units and rules."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from datetime import datetime
from enum import StrEnum
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Discriminator, Field, Tag, model_validator
from pydantic_core import PydanticCustomError

from zenostat.topics.errors import did_you_mean
from zenostat.topics.keys import check_name

Positive = Annotated[float, Field(strict=True, gt=0.0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(strict=True, ge=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Share = Annotated[float, Field(strict=True, ge=0.0, le=1.0)]
Name = Annotated[str, AfterValidator(lambda name: check_name(name, "the name"))]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)


class Profile(_Part):
    """A column of a CSV file with a header: means over consecutive intervals from the begin of an episode on.

    After its last row it begins again.

    Attributes:
        file: relative to the grid's file.
        column: name of the column.
        step_s: length of an interval, s.
        factor: of all values.
    """

    file: str
    column: str
    step_s: Positive = 3600.0
    factor: Finite = 1.0


def _kind_of_series(value: Any) -> str:
    return "@profile" if isinstance(value, Profile | Mapping) else "@number"


_KIND = Discriminator(_kind_of_series)
FiniteSeries = Annotated[Annotated[Finite, Tag("@number")] | Annotated[Profile, Tag("@profile")], _KIND]
NotNegativeSeries = Annotated[Annotated[NotNegative, Tag("@number")] | Annotated[Profile, Tag("@profile")], _KIND]


class Bus(_Part):
    """A bus with its rated line-to-line voltage."""

    voltage_kv: Positive


class Source(_Part):
    """The connection to the grid above: a constant voltage behind an impedance.

    Attributes:
        bus: where it is connected.
        voltage_pu: its voltage, per unit.
        short_circuit_mva: short-circuit power, MVA; by default so large that the bus has the constant voltage.
    """

    bus: str
    voltage_pu: Positive = 1.0
    short_circuit_mva: Positive = 1e12


class Line(_Part):
    """A line or cable: the pi model with the positive-sequence values of its data sheet.

    Attributes:
        start, end: its buses (`from` and `to` in the file).
        length_m: length, m.
        resistance_ohm_km, reactance_ohm_km, capacitance_nf_km: per kilometer and conductor.
        ampacity_a: rated current, which is a loading of 100 %.
        parallel: number of equal lines in parallel.
        open_end: the end at which a switch is open, `from` or `to`.
    """

    start: str = Field(alias="from")
    end: str = Field(alias="to")
    length_m: Positive
    resistance_ohm_km: NotNegative
    reactance_ohm_km: Finite
    capacitance_nf_km: NotNegative = 0.0
    ampacity_a: Positive
    parallel: Annotated[int, Field(strict=True, ge=1)] = 1
    open_end: Literal["from", "to"] | None = None


class Transformer(_Part):
    """A transformer with two windings, with the values of its rating plate.

    Attributes:
        start, end: buses of its primary and secondary side (`from` and `to` in the file).
        power_kva: rated power.
        primary_kv, secondary_kv: rated voltages; by default those of the buses.
        short_circuit_percent: short-circuit voltage.
        copper_loss_w: losses at rated current.
        iron_loss_w, no_load_percent: losses and current without load.
        clock: clock number of the vector group; those of transformers in a loop must agree.
        tap_percent: additional voltage of the primary winding at the present tap position.
    """

    start: str = Field(alias="from")
    end: str = Field(alias="to")
    power_kva: Positive
    primary_kv: Positive | None = None
    secondary_kv: Positive | None = None
    short_circuit_percent: Annotated[float, Field(strict=True, gt=0.0, le=100.0)]
    copper_loss_w: NotNegative
    iron_loss_w: NotNegative = 0.0
    no_load_percent: NotNegative = 0.0
    clock: Annotated[int, Field(strict=True, ge=0, le=12)] = 5
    tap_percent: Annotated[float, Field(strict=True, gt=-50.0, lt=50.0)] = 0.0


class Load(_Part):
    """A load: what it draws from its bus. An actuator replaces it, such as the demand of a simulated building.

    Attributes:
        bus: where it is connected.
        power_w: constant active power, W; or a profile. Negative: it feeds in.
        power_factor: active over apparent power; the load is inductive.
        reactive_var: reactive power in place of a power factor, var.
        low_w, high_w: bounds of the actuator.
    """

    bus: str
    power_w: FiniteSeries = 0.0
    power_factor: Annotated[float, Field(strict=True, gt=0.0, le=1.0)] = 1.0
    reactive_var: Finite | None = None
    low_w: Finite | None = None
    high_w: Finite | None = None


class Pv(_Part):
    """A photovoltaic system.

    Attributes:
        bus: where it is connected.
        power_w: available power, W: constant, or a profile.
    """

    bus: str
    power_w: NotNegativeSeries


class Battery(_Part):
    """A battery with its inverter.

    Attributes:
        bus: where it is connected.
        capacity_kwh: usable energy.
        power_kw: highest power of charging and discharging, at the bus.
        charge_efficiency, discharge_efficiency: energy stored over energy drawn, and energy fed in over energy taken.
        initial: state of charge at sample 0.
    """

    bus: str
    capacity_kwh: Positive
    power_kw: Positive
    charge_efficiency: Annotated[float, Field(strict=True, gt=0.0, le=1.0)] = 0.95
    discharge_efficiency: Annotated[float, Field(strict=True, gt=0.0, le=1.0)] = 0.95
    initial: Share = 0.5


class Session(_Part):
    """A stay of a vehicle.

    Attributes:
        arrival_h, departure_h: hours from the begin of an episode.
        energy_kwh: energy that it needs by its departure, at the bus.
    """

    arrival_h: NotNegative
    departure_h: NotNegative
    energy_kwh: NotNegative

    @model_validator(mode="after")
    def _check_order(self) -> Session:
        if not self.arrival_h < self.departure_h:
            raise ValueError(f"departure_h {self.departure_h:g} is not after arrival_h {self.arrival_h:g}")
        return self


class Draw(_Part):
    """A normal distribution, cut at two standard deviations."""

    mean: Finite
    deviation: NotNegative = 0.0


class DrawnSessions(_Part):
    """Stays that are drawn from the episode's seed, one each day.

    Attributes:
        arrival_h: hour of the day of the arrival.
        departure_h: hour of the day of the departure; on the next day if it is before the arrival.
        energy_kwh: energy needed.
        share: share of the days with a stay.
    """

    arrival_h: Draw
    departure_h: Draw
    energy_kwh: Draw
    share: Share = 1.0


class SessionFile(_Part):
    """A CSV file with the columns `arrival_h`, `departure_h`, `energy_kwh` and optionally `charger`, a name."""

    file: str


def _kind_of_sessions(value: Any) -> str:
    if isinstance(value, SessionFile) or (isinstance(value, Mapping) and "file" in value):
        return "@file"
    return "@drawn" if isinstance(value, DrawnSessions | Mapping) else "@list"


Sessions = Annotated[
    Annotated[list[Session], Tag("@list")]
    | Annotated[SessionFile, Tag("@file")]
    | Annotated[DrawnSessions, Tag("@drawn")],
    Discriminator(_kind_of_sessions),
]


class Charger(_Part):
    """A charger of electric vehicles.

    Attributes:
        bus: where it is connected.
        power_kw: highest power.
        sessions: stays, as a list, in a file, or drawn.
    """

    bus: str
    power_kw: Positive
    sessions: Sessions = Field(default_factory=list)


class Price(_Part):
    """The price of energy.

    Attributes:
        price: constant, or a profile.
        unit: for example `EUR/kWh`.
    """

    price: FiniteSeries
    unit: str = "1/kWh"


class OnDivergence(StrEnum):
    """Policy for a power flow that does not converge: keep the last good state, or stop the episode."""

    KEEP = "keep"
    STOP = "stop"


class Grid(_Part):
    """An electric grid with three balanced phases.

    Attributes:
        name: of the grid.
        begin: simulated time of sample 0.
        step_s, duration_s: timestep, and length of an episode.
        frequency_hz: for the capacitance of lines.
        on_divergence: policy for a power flow that does not converge.
        source, buses, lines, transformers: the network.
        loads, pv, batteries, chargers: what is connected to it.
        price: of the coming timestep; None: there is no price.
    """

    name: Name = "grid"
    begin: datetime = datetime(2001, 1, 1)
    step_s: Positive = 900.0
    duration_s: Positive = 86400.0
    frequency_hz: Literal[50, 60] = 50
    on_divergence: OnDivergence = OnDivergence.KEEP
    source: Source
    buses: dict[Name, Bus]
    lines: dict[Name, Line] = Field(default_factory=dict)
    transformers: dict[Name, Transformer] = Field(default_factory=dict)
    loads: dict[Name, Load] = Field(default_factory=dict)
    pv: dict[Name, Pv] = Field(default_factory=dict)
    batteries: dict[Name, Battery] = Field(default_factory=dict)
    chargers: dict[Name, Charger] = Field(default_factory=dict)
    price: Price | None = None

    @model_validator(mode="after")
    def _check_references(self) -> Grid:
        errors = [*self._errors_of_names(), *self._errors_of_buses()]
        if not errors:
            errors = [*self._errors_of_voltages(), *self._errors_of_islands()] or [*self._errors_of_clocks()]
        if errors:
            raise PydanticCustomError("grid", "{text}", {"text": "; ".join(errors), "errors": errors})
        return self

    def parts(self) -> Iterator[tuple[str, str, Any]]:
        """Yield kind, name and content of everything that is connected to a bus."""
        for kind in ("lines", "transformers", "loads", "pv", "batteries", "chargers"):
            for name, part in getattr(self, kind).items():
                yield kind, name, part

    def _errors_of_names(self) -> Iterator[str]:
        owners: dict[str, str] = {}
        for kind, name, _ in (*(("buses", name, None) for name in self.buses), *self.parts()):
            if name in owners:
                yield f"{kind}.{name}: {owners[name]} have this name as well; each name is used once"
            owners[name] = kind

    def _errors_of_buses(self) -> Iterator[str]:
        ends = [("source", "", self.source), *self.parts()]
        for kind, name, part in ends:
            for field in ("bus", "start", "end"):
                bus = getattr(part, field, None)
                if bus is not None and bus not in self.buses:
                    place = f"{kind}.{name}".removesuffix(".")
                    yield f"{place}: there is no bus {bus!r}; {did_you_mean(bus, list(self.buses))}"

    def _errors_of_voltages(self) -> Iterator[str]:
        for name, line in self.lines.items():
            voltages = [self.buses[bus].voltage_kv for bus in (line.start, line.end)]
            if line.start == line.end:
                yield f"lines.{name}: it begins and ends at {line.start!r}"
            elif voltages[0] != voltages[1]:
                yield f"lines.{name}: its buses have {voltages[0]:g} and {voltages[1]:g} kV; a transformer is needed"
            elif not line.resistance_ohm_km and not line.reactance_ohm_km:
                yield f"lines.{name}: it has no impedance; give it a resistance, or make both buses one"
        for name, transformer in self.transformers.items():
            if transformer.start == transformer.end:
                yield f"transformers.{name}: it begins and ends at {transformer.start!r}"
            limit_w = transformer.short_circuit_percent * 10.0 * transformer.power_kva
            if transformer.copper_loss_w > limit_w:
                text = (
                    f"copper_loss_w is {transformer.copper_loss_w:g}, of which {transformer.short_circuit_percent:g} %"
                )
                yield f"transformers.{name}: {text} of short-circuit voltage allow at most {limit_w:g}"

    def _errors_of_islands(self) -> Iterator[str]:
        if isolated := sorted(self.buses.keys() - self._bus_clocks()):
            yield f"no line or transformer connects the bus {', '.join(isolated)} with the source"

    def _errors_of_clocks(self) -> Iterator[str]:
        """Yield an error for each branch between buses whose phases differ by the clock numbers on another path."""
        clocks = self._bus_clocks()
        for kind, name, part, clock in self._closed_branches():
            expected = (clocks[part.end] - clocks[part.start]) % 12
            if clock % 12 != expected:
                text = "short circuit: with the other clock numbers, its buses are"
                yield f"{kind}.{name}: {text} {30 * ((expected - clock) % 12)} degrees apart"

    def _closed_branches(self) -> Iterator[tuple[str, str, Line | Transformer, int]]:
        """Yield kind, name, content and clock number of each line without an open end and each transformer."""
        for name, line in self.lines.items():
            if line.open_end is None:
                yield "lines", name, line, 0
        for name, transformer in self.transformers.items():
            yield "transformers", name, transformer, transformer.clock

    def _bus_clocks(self) -> dict[str, int]:
        return bus_clocks(
            self.source.bus, ((part.start, part.end, clock) for *_, part, clock in self._closed_branches())
        )


def bus_clocks(source: str, branches: Iterable[tuple[str, str, int]]) -> dict[str, int]:
    """Return the buses that are connected with the source, with the sum of the clock numbers on a path to each.

    Args:
        source: the bus of the source.
        branches: each given as its two buses and its clock number, which is 0 for a line.
    """
    neighbors: dict[str, list[tuple[str, int]]] = {}
    for start, end, clock in branches:
        neighbors.setdefault(start, []).append((end, clock))
        neighbors.setdefault(end, []).append((start, -clock))
    clocks = {source: 0}
    pending = [source]
    while pending:
        bus = pending.pop()
        for neighbor, clock in neighbors.get(bus, ()):
            if neighbor not in clocks:
                clocks[neighbor] = clocks[bus] + clock
                pending.append(neighbor)
    return clocks
