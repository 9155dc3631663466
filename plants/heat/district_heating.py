"""A district heating plant: a heat source, a storage tank, a supply and a return pipe with losses, and substations.

The equations are heat balances, of which docs/heat.md has the derivation. All temperatures but that of the tank are
quasi-steady: pipes have no storage and no transport delay. Mass flows are constant during a timestep, so the tank's
balance is linear and its solution exact.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import exp, expm1, isfinite
from typing import Any

from zenostat.topics.errors import InvalidConfig
from zenostat.topics.keys import check_name

WATER_J_KG_K = 4186.0
"""Specific heat capacity of water, J/(kg K)."""
KELVIN = 273.15
SETPOINT_LIMIT_C = 95.0
COP_LIMITS = (1.0, 8.0)
_SMALL = 1e-3
"""Ratio of a timestep to a time constant up to which the mean of a response is a series."""


class DistrictHeating:
    """A plant that heats a tank, which supplies substations by a pair of pipes.

    The source heats the tank to its setpoint as fast as its power allows. Substations take the mass flow that covers
    their demand with the present supply temperature, up to a limit, and return water of a constant temperature.

    Args:
        source: `boiler` (gas) or `heat_pump` (electricity).
        power_w: largest heat of the source, W.
        efficiency: of a boiler: heat over fuel; of a heat pump: its COP over that of the Carnot cycle.
        tank_m3: volume of the tank.
        tank_loss_w_k: loss coefficient of the tank, W/K, to its surroundings of `ambient_c`.
        pipe_m: length of each of the two pipes, m.
        pipe_loss_w_m_k: loss coefficient of a pipe per length, W/(m K), to the ground of `ground_c`.
        return_c: return temperature of the substations, degC.
        flow_kg_s: largest mass flow of a substation, kg/s.
        consumers: demand of each substation while nobody commands it, W, by its name.
        initial_c: temperature of the tank at sample 0, degC.
        step_s, duration_s, begin: see `zenostat.bridge.python_plant.Plant`.

    Raises:
        InvalidConfig: an argument is not valid.
    """

    forkable = True

    def __init__(
        self,
        source: str = "heat_pump",
        power_w: float = 100e3,
        efficiency: float = 0.5,
        tank_m3: float = 10.0,
        tank_loss_w_k: float = 20.0,
        pipe_m: float = 500.0,
        pipe_loss_w_m_k: float = 0.25,
        return_c: float = 40.0,
        flow_kg_s: float = 2.0,
        consumers: Mapping[str, float] | None = None,
        ambient_c: float = 15.0,
        ground_c: float = 10.0,
        initial_c: float = 70.0,
        step_s: float = 300.0,
        duration_s: float = 86400.0,
        begin: str = "2026-01-12T00:00",
    ) -> None:
        if source not in ("boiler", "heat_pump"):
            raise InvalidConfig(f"source = {source!r}: boiler or heat_pump expected")
        self.step_s, self.duration_s, self.begin, self._source = step_s, duration_s, begin, source
        consumers = {"north": 30e3, "south": 20e3} if consumers is None else consumers
        if not isinstance(consumers, Mapping) or "source" in consumers:
            raise InvalidConfig(f"consumers = {consumers!r}: demands by name expected, of which none is 'source'")
        self._demands = {check_name(str(name), "a consumer's name"): demand for name, demand in consumers.items()}
        _check("above", 0.0, power_w=power_w, efficiency=efficiency, tank_m3=tank_m3, flow_kg_s=flow_kg_s)
        _check("above", -KELVIN, return_c=return_c, ambient_c=ambient_c, ground_c=ground_c, initial_c=initial_c)
        _check("of at least", 0.0, tank_loss_w_k=tank_loss_w_k, pipe_m=pipe_m, pipe_loss_w_m_k=pipe_loss_w_m_k)
        _check("of at least", 0.0, **{f"consumers[{name!r}]": demand for name, demand in self._demands.items()})
        if return_c >= SETPOINT_LIMIT_C:
            raise InvalidConfig(f"return_c = {return_c!r}: a number below {SETPOINT_LIMIT_C:g} expected")
        self._power_w, self._efficiency, self._flow_kg_s = power_w, efficiency, flow_kg_s
        self._capacity_j_k = tank_m3 * 1000.0 * WATER_J_KG_K
        self._tank_loss_w_k, self._pipe_loss_w_k = tank_loss_w_k, pipe_m * pipe_loss_w_m_k
        self._return_c, self._ambient_c, self._ground_c, self._initial_c = return_c, ambient_c, ground_c, initial_c
        self.sensors: dict[str, tuple[str | float | None, ...]] = {
            "tank_temperature": ("degC", None, None),
            **{f"{name}_temperature": ("degC", None, None, "mean") for name in ("supply", "return")},
            **{f"{name}_heat": ("W", 0.0, None, "mean") for name in ("source", *self._demands)},
            **{f"{name}_unmet": ("W", None, None, "mean") for name in self._demands},
            **dict.fromkeys(("tank_loss", "pipe_loss", "tank_charge"), ("W", None, None, "mean")),
            "flow": ("kg/s", 0.0, None, "mean"),
            "source_power": ("W", 0.0, None, "mean"),
            "efficiency": ("1", 0.0, None, "mean"),
        }
        self._meter = "natural_gas" if source == "boiler" else "electricity"
        self.meters = {self._meter: ("J", 0.0, None)}
        self.actuators: dict[str, tuple[Any, ...]] = {
            "setpoint": ("degC", return_c, SETPOINT_LIMIT_C, max(70.0, return_c)),
            "outdoor_temperature": ("degC", -50.0, 50.0, 0.0),
            **{f"{name}_demand": ("W", 0.0, None, demand) for name, demand in self._demands.items()},
        }
        self.actions = ["setpoint"]

    def reset(self, seed: int) -> dict[str, float]:  # noqa: ARG002  # nothing is drawn
        """Begin an episode with the initial temperature of the tank and a source that is off."""
        self._tank_c = self._initial_c
        values = self._advance({name: spec[3] for name, spec in self.actuators.items()}, heat_w=0.0)
        self._tank_c = self._initial_c
        return {**values, "tank_temperature": self._initial_c, self._meter: 0.0}

    def step(self, commands: Mapping[str, float]) -> dict[str, float]:
        """Simulate a timestep; powers and the supply and return temperature are means over it."""
        return self._advance(commands, heat_w=None)

    def _advance(self, commands: Mapping[str, float], heat_w: float | None) -> dict[str, float]:
        """Advance the tank: C dT/dt = heat - m c (T - T_return) - UA (T - T_ambient), with constant coefficients."""
        demands = {name: commands[f"{name}_demand"] for name in self._demands}
        flows, supply_factor, return_c = self._flows(demands)
        total = sum(flows.values()) * WATER_J_KG_K
        begin_c, warming_s_k = self._tank_c, self.step_s / self._capacity_j_k  # K per W
        losses = total * (begin_c - return_c) + self._tank_loss_w_k * (begin_c - self._ambient_c)  # W, at the begin
        at_end, on_average = _responses((total + self._tank_loss_w_k) * warming_s_k)
        if heat_w is None:
            needed_w = losses + (commands["setpoint"] - begin_c) / (warming_s_k * at_end)
            heat_w = min(max(needed_w, 0.0), self._power_w)
        self._tank_c = begin_c + (heat_w - losses) * warming_s_k * at_end
        mean_c = begin_c + (heat_w - losses) * warming_s_k * on_average
        supply_c = self._ground_c + (mean_c - self._ground_c) * supply_factor
        heats = {name: flow * WATER_J_KG_K * max(supply_c - self._return_c, 0.0) for name, flow in flows.items()}
        efficiency = self._present_efficiency(mean_c, commands["outdoor_temperature"])
        return {
            "tank_temperature": self._tank_c,
            "supply_temperature": supply_c,
            "return_temperature": return_c,
            "source_heat": heat_w,
            **{f"{name}_heat": heat for name, heat in heats.items()},
            **{f"{name}_unmet": demands[name] - heat for name, heat in heats.items()},
            "tank_loss": self._tank_loss_w_k * (mean_c - self._ambient_c),
            "pipe_loss": total * (mean_c - return_c) - sum(heats.values()),
            "tank_charge": self._capacity_j_k * (self._tank_c - begin_c) / self.step_s,
            "flow": sum(flows.values()),
            "source_power": heat_w / efficiency,
            "efficiency": efficiency,
            self._meter: heat_w / efficiency * self.step_s,
        }

    def _flows(self, demands: Mapping[str, float]) -> tuple[dict[str, float], float, float]:
        """Return the mass flows, and of the pipes the factor of the supply and the return temperature at the tank.

        A pipe with the heat balance m c dT/dx = -k (T - T_ground) has at its end T_ground + (T_0 - T_ground)
        exp(-k L / (m c)). Flow and supply temperature depend on each other: the total flow is the only zero of a
        function that changes its sign between 0 and the largest flow, and is bisected to the bit.
        """
        capacity_w_k = self._flow_kg_s * WATER_J_KG_K
        low, high, factor, lift_k = 0.0, capacity_w_k * sum(demand > 0.0 for demand in demands.values()), 0.0, 0.0
        while low < (total := 0.5 * (low + high)) < high:
            factor = exp(-self._pipe_loss_w_k / total)
            lift_k = self._ground_c + (self._tank_c - self._ground_c) * factor - self._return_c
            needed = sum(min(demand, capacity_w_k * lift_k) for demand in demands.values())
            low, high = (total, high) if lift_k <= 0.0 or needed > total * lift_k else (low, total)
        if lift_k <= 0.0 or self._tank_c <= self._return_c:
            return dict.fromkeys(demands, 0.0), 0.0, self._return_c
        flows = {name: min(demand / (WATER_J_KG_K * lift_k), self._flow_kg_s) for name, demand in demands.items()}
        return flows, factor, self._ground_c + (self._return_c - self._ground_c) * factor

    def _present_efficiency(self, tank_c: float, outdoor_c: float) -> float:
        """Return heat over fuel, or the COP: a constant part of the Carnot cycle's T_hot / (T_hot - T_cold)."""
        if self._source == "boiler":
            return self._efficiency
        lift_k, (low, high) = tank_c - outdoor_c, COP_LIMITS
        return min(max(self._efficiency * (tank_c + KELVIN) / lift_k, low), high) if lift_k > 0.0 else high

    def save(self) -> float:
        """Return the temperature of the tank, which is the whole state."""
        return self._tank_c

    def restore(self, state: float) -> None:
        """Continue from a state that `save` returned."""
        self._tank_c = state


def _responses(x: float) -> tuple[float, float]:
    """Return (1 - exp(-x)) / x, and (1 - that) / x: parts of a linear change, at its end and on average.

    With heat h at the begin and the conductance k, a tank of the capacity C changes by h t / C times these in the time
    t, with x = k t / C; without a conductance by h t / C and half of that. The second is a series where x is small.
    """
    at_end = -expm1(-x) / x if x else 1.0
    on_average = (1.0 - at_end) / x if x > _SMALL else 0.5 - x * (1.0 - x * (1.0 - x / 5.0) / 4.0) / 6.0
    return at_end, on_average


def _check(relation: str, low: float, **values: Any) -> None:
    for name, value in values.items():
        is_number = isinstance(value, int | float) and isfinite(value)
        if not is_number or value < low or (value == low and relation == "above"):
            raise InvalidConfig(f"{name} = {value!r}: a number {relation} {low:g} expected")
