"""A PID controller on one temperature."""

from __future__ import annotations

import math
from collections.abc import Sequence

from agent_sdk.bus.sample import SampleView
from agent_sdk.controllers.action_roles import SETPOINTS, role_of, temperature_sensors
from agent_sdk.controllers.base import Controller, Values
from agent_sdk.controllers.parameters import ControllerMismatch, bounds, named, number
from topics.errors import InvalidConfig, did_you_mean
from topics.messages import Action, Actuator, Manifest, Sensor


class PIDController(Controller):
    """Drives one action or actuator from one temperature.

    With the error e = setpoint - T, of the other sign where it is not reverse acting, and dt = a timestep in hours:

        u = bias + kp e + I + D,    I = I + ki e dt,    D = -kd dT/dt (of the other sign likewise)

    within the output's limits. The derivative is that of the measurement, so that a new setpoint gives no kick, and 0
    at an episode's first sample. The integral takes nothing on while the output is at a limit and the error would
    drive it further out (conditional integration; Astrom and Hagglund, Advanced PID Control, chapter 3).

    Args:
        manifest: of the node.
        setpoint: degC.
        sensor: name of a sensor in degC; None: the only zone air temperature.
        actuator: name of an action or an actuator; None: the only action.
        kp: output unit a K. The default is safe where the output is a room's setpoint: the temperature then follows
            it by no more than its own change, at once or with a lag, so that the gain of the loop stays below 1.
        ki: output unit a K h.
        kd: output unit h a K.
        low: lowest output; None: the lower bound of the action or actuator.
        high: highest output; None: the upper bound.
        bias: output without error; None: `setpoint` where the output is a room's setpoint, else the middle of the
            limits.
        reverse: whether the output falls as the temperature rises (reverse acting), as for heating and for all
            setpoints; False for cooling power, valves and flows.
        others: fixed values of other actions or actuators, by name.

    Raises:
        InvalidConfig: no temperature sensor or no actuator, several and none named, or a parameter that cannot be.
    """

    def __init__(
        self,
        manifest: Manifest,
        *,
        setpoint: float,
        sensor: str | None = None,
        actuator: str | None = None,
        kp: float = 0.3,
        ki: float = 0.5,
        kd: float = 0.0,
        low: float | None = None,
        high: float | None = None,
        bias: float | None = None,
        reverse: bool = True,
        **others: float,
    ) -> None:
        super().__init__(manifest)
        self._setpoint = number("setpoint", setpoint)
        self._gains = tuple(number(n, v, least=0.0) for n, v in (("kp", kp), ("ki", ki), ("kd", kd)))
        if not isinstance(reverse, bool):
            raise InvalidConfig(f"reverse = {reverse!r}; true or false expected")
        self._sign = 1.0 if reverse else -1.0
        self._sensor = _sensor(manifest, sensor)
        output = _output(manifest, actuator)
        self._low, self._high = _limits(output, low, high)
        self._driven = output.actuators if isinstance(output, Action) else (output.name,)
        self._bias = self._default_bias(output) if bias is None else number("bias", bias)
        self._others: Values = dict(named(manifest, others))
        twice = set(self._driven) & set(self._others)
        if twice:
            raise InvalidConfig(f"{', '.join(sorted(twice))}: driven by the controller, so it takes no fixed value")
        self._dt_h = 1 / manifest.steps_per_hour
        self._integral, self._before = 0.0, math.nan

    def _default_bias(self, output: Action | Actuator) -> float:
        actuator = next((a for a in self.manifest.actuators if a.name in self._driven), None)
        if actuator is not None and role_of(output, actuator) in SETPOINTS:
            return min(max(self._setpoint, self._low), self._high)
        return (self._low + self._high) / 2

    def begin(self, sample: SampleView) -> None:  # noqa: ARG002
        """Forgets the integral and the temperature before."""
        self._integral, self._before = 0.0, math.nan

    def act(self, sample: SampleView) -> Values:
        """The output for the timestep that begins at `sample.time`."""
        kp, ki, kd = self._gains
        measured = sample[self._sensor]
        error = self._sign * (self._setpoint - measured)
        rate = 0.0 if math.isnan(self._before) else (measured - self._before) / self._dt_h
        base = self._bias + kp * error - self._sign * kd * rate
        integral = self._integral + ki * error * self._dt_h
        wanted = base + integral
        if (wanted > self._high and error > 0.0) or (wanted < self._low and error < 0.0):
            wanted = base + self._integral
        else:
            self._integral = integral
        self._before = measured
        return {**self._others, **dict.fromkeys(self._driven, min(max(wanted, self._low), self._high))}


def _sensor(manifest: Manifest, name: str | None) -> str:
    fit = [s.name for s in manifest.sensors if s.unit == "degC"]
    if not fit:
        raise ControllerMismatch(
            f"pid needs a sensor in degC, and node {manifest.node!r} has none: name one in the scenario's sensors, as "
            f"[Zone Air Temperature, ZONE]"
        )
    if name is None:
        return _only(temperature_sensors(manifest), "sensor", fit)
    if name not in fit:
        raise InvalidConfig(f"pid has no sensor {name!r} in degC to read; {did_you_mean(name, fit)}")
    return name


def _output(manifest: Manifest, name: str | None) -> Action | Actuator:
    points: dict[str, Action | Actuator] = {a.name: a for a in manifest.actuators}
    points |= {a.name: a for a in manifest.task.actions}
    if not points:
        raise ControllerMismatch(
            f"pid needs an actuator to drive, and node {manifest.node!r} has none: name one in actuators"
        )
    found = _only(manifest.task.actions, "actuator", points) if name is None else name
    if found not in points:
        raise InvalidConfig(f"pid has no actuator {name!r} to drive; {did_you_mean(str(name), points)}")
    return points[found]


def _only(found: Sequence[Sensor | Action], what: str, fit: Sequence[str] | dict[str, Action | Actuator]) -> str:
    if len(found) != 1:
        raise ControllerMismatch(f"pid takes one {what}: name it by {what}=...; {did_you_mean('', fit)}")
    return found[0].name


def _limits(output: Action | Actuator, low: float | None, high: float | None) -> tuple[float, float]:
    least, most = bounds(output)
    lowest = least if low is None else number("low", low, least=least, most=most)
    highest = most if high is None else number("high", high, least=least, most=most)
    if math.isinf(lowest) or math.isinf(highest):
        raise InvalidConfig(
            f"{output.name!r} has no bounds of its own: name the output's limits by low=... and high=..."
        )
    if not lowest < highest:
        raise InvalidConfig(f"low = {lowest:g} is not below high = {highest:g}")
    return lowest, highest
