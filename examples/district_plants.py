"""Two plants for `examples/district.yaml`: a house with radiators, and a heat pump."""

from __future__ import annotations

from math import exp


class House:
    """A heated house: C dT/dt = heat - loss (T - outdoor), solved exactly for a constant heat over a timestep.

    Its radiators ask for the heat that brings it to its setpoint within an hour, at a flow temperature that rises with
    this demand.
    """

    step_s = 900.0
    begin = "2026-01-12T00:00"
    duration_s = 86400.0
    forkable = True
    sensors = {
        "temperature": ("degC", -30.0, 60.0),
        "demand": ("W", 0.0, 12000.0),
        "flow_temperature": ("degC", 20.0, 60.0),
    }
    meters = {"heat": ("J", 0.0, None)}
    actuators = {
        "heat_supply": ("W", 0.0, 12000.0, 0.0),
        "setpoint": ("degC", 15.0, 25.0, 21.0),
        "outdoor": ("degC", -30.0, 40.0, -5.0),
    }

    def __init__(self, loss_w_k: float = 180.0, capacity_j_k: float = 2.5e7) -> None:
        self.loss_w_k, self.capacity_j_k = loss_w_k, capacity_j_k

    def reset(self, seed: int) -> dict[str, float]:
        """Begin at 18 to 22 degC."""
        self.temperature = 18.0 + seed % 5
        return self.values(0.0, 21.0, -5.0)

    def step(self, commands: dict[str, float]) -> dict[str, float]:
        """Simulate a timestep."""
        heat, outdoor = commands["heat_supply"], commands["outdoor"]
        steady = outdoor + heat / self.loss_w_k
        decay = exp(-self.step_s * self.loss_w_k / self.capacity_j_k)
        self.temperature = steady + (self.temperature - steady) * decay
        return self.values(heat, commands["setpoint"], outdoor)

    def values(self, heat: float, setpoint: float, outdoor: float) -> dict[str, float]:
        """Return the values after a timestep with this heat."""
        missing = self.capacity_j_k * (setpoint - self.temperature) / 3600.0
        demand = min(max(missing + self.loss_w_k * (setpoint - outdoor), 0.0), 12000.0)
        return {
            "temperature": self.temperature,
            "demand": demand,
            "flow_temperature": 20.0 + 40.0 * demand / 12000.0,
            "heat": heat * self.step_s,
        }


class HeatPump:
    """A heat pump of 4 kW electric: its COP is 45 % of Carnot's between outdoors and the flow temperature."""

    step_s = 900.0
    begin = "2026-01-12T00:00"
    duration_s = 86400.0
    forkable = True
    sensors = {"heat": ("kW", 0.0, None), "power": ("kW", 0.0, 4.0), "cop": ("1", 1.0, 10.0)}
    meters = {"electricity": ("kWh", 0.0, None)}
    actuators = {
        "demand": ("kW", 0.0, 12.0, 0.0),
        "flow_temperature": ("degC", 20.0, 60.0, 35.0),
        "outdoor": ("degC", -30.0, 40.0, -5.0),
    }

    def reset(self, seed: int) -> dict[str, float]:  # noqa: ARG002  # no random numbers
        """Begin at rest."""
        return self.values(0.0, 1.0)

    def step(self, commands: dict[str, float]) -> dict[str, float]:
        """Deliver the heat that is asked for, as far as 4 kW are enough for it."""
        flow = commands["flow_temperature"]
        cop = min(max(0.45 * (flow + 273.15) / max(flow - commands["outdoor"], 5.0), 1.0), 10.0)
        return self.values(min(commands["demand"] / cop, 4.0), cop)

    def values(self, power: float, cop: float) -> dict[str, float]:
        """Return the values after a timestep with this power."""
        return {"heat": power * cop, "power": power, "cop": cop, "electricity": power * self.step_s / 3600.0}
