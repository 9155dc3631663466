"""PID controller of one temperature."""

from __future__ import annotations

import math
from collections.abc import Sequence

from agent_sdk.bus.sample import SampleView
from agent_sdk.controllers.action_roles import SETPOINTS, role_of, temperature_sensors
from agent_sdk.controllers.base import Controller, Values
from agent_sdk.controllers.parameters import ControllerMismatch, actuator_values, number
from topics.errors import InvalidConfig, did_you_mean
from topics.messages import Action, Actuator, Manifest, Sensor
from topics.points import bounds


class PIDController(Controller):
    """Control one temperature with one action or actuator.

    With the error e = setpoint - T (T - setpoint if direct acting) and the timestep dt in hours, the output is

        u = bias + kp e + I + D,    I = I + ki e dt,    D = -kd dT/dt (+kd dT/dt if direct acting)

    clipped to its limits. The derivative acts on the measurement, so that a change of the setpoint causes no kick; it
    is 0 at the first sample of an episode. The integral is frozen while the output is at a limit and the error would
    drive it further out (conditional integration; Astrom and Hagglund, Advanced PID Control, chapter 3).

    Args:
        manifest: manifest of the node.
        setpoint: setpoint of the temperature, degC.
        sensor: name of a sensor in degC; None: the only zone air temperature.
        actuator: name of an action or an actuator; None: the only action.
        kp: proportional gain, output unit/K. The default is stable if the output is a zone setpoint: the zone follows
            it with a gain of at most 1, with or without a lag, so that the loop gain stays below 1.
        ki: integral gain, output unit/(K h).
        kd: derivative gain, output unit h/K.
        low: lower limit of the output; None: the lower bound of the action or actuator.
        high: upper limit of the output; None: the upper bound.
        bias: output at zero error; None: `setpoint` if the output is a zone setpoint, else the middle of the limits.
        reverse: whether the output falls as the temperature rises (reverse acting), as for heating and for all
            setpoints; False for cooling power, valves and flows.
        others: fixed values of other actions or actuators, by name.

    Raises:
        InvalidConfig: there is no temperature sensor or actuator, or several of which none is named, or a parameter is
            invalid.
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
        self._gains = tuple(number(n, v, minimum=0.0) for n, v in (("kp", kp), ("ki", ki), ("kd", kd)))
        if not isinstance(reverse, bool):
            raise InvalidConfig(f"reverse = {reverse!r}; expected true or false")
        self._sign = 1.0 if reverse else -1.0
        self._sensor = _sensor(manifest, sensor)
        output = _output(manifest, actuator)
        self._low, self._high = _limits(output, low, high)
        self._outputs = output.actuators if isinstance(output, Action) else (output.name,)
        self._bias = self._default_bias(output) if bias is None else number("bias", bias)
        self._fixed: Values = dict(actuator_values(manifest, others))
        conflicts = set(self._outputs) & set(self._fixed)
        if conflicts:
            raise InvalidConfig(
                f"{', '.join(sorted(conflicts))}: the controller's own output cannot have a fixed value"
            )
        self._dt_h = manifest.step_s / 3600.0
        self._integral, self._previous = 0.0, math.nan

    def _default_bias(self, output: Action | Actuator) -> float:
        actuator = next((a for a in self.manifest.actuators if a.name in self._outputs), None)
        if actuator is not None and role_of(output, actuator) in SETPOINTS:
            return min(max(self._setpoint, self._low), self._high)
        return (self._low + self._high) / 2

    def begin(self, sample: SampleView) -> None:  # noqa: ARG002
        """Reset the integral and the previous temperature."""
        self._integral, self._previous = 0.0, math.nan

    def act(self, sample: SampleView) -> Values:
        """Return the output and the fixed values for the timestep that begins at `sample.time`."""
        kp, ki, kd = self._gains
        measured = sample[self._sensor]
        error = self._sign * (self._setpoint - measured)
        rate = 0.0 if math.isnan(self._previous) else (measured - self._previous) / self._dt_h
        without_integral = self._bias + kp * error - self._sign * kd * rate
        integral = self._integral + ki * error * self._dt_h
        output = without_integral + integral
        if (output > self._high and error > 0.0) or (output < self._low and error < 0.0):
            output = without_integral + self._integral
        else:
            self._integral = integral
        self._previous = measured
        return {**self._fixed, **dict.fromkeys(self._outputs, min(max(output, self._low), self._high))}


def _sensor(manifest: Manifest, name: str | None) -> str:
    candidates = [s.name for s in manifest.sensors if s.unit == "degC"]
    if not candidates:
        raise ControllerMismatch(
            f"pid needs a sensor in degC, but node {manifest.node!r} has none: add one to the scenario's sensors, for "
            f"example [Zone Air Temperature, ZONE]"
        )
    if name is None:
        return _only(temperature_sensors(manifest), "sensor", candidates)
    if name not in candidates:
        raise InvalidConfig(f"there is no sensor {name!r} in degC for pid; {did_you_mean(name, candidates)}")
    return name


def _output(manifest: Manifest, name: str | None) -> Action | Actuator:
    points: dict[str, Action | Actuator] = {a.name: a for a in manifest.actuators}
    points |= {a.name: a for a in manifest.task.actions}
    if not points:
        raise ControllerMismatch(
            f"pid needs an actuator, but node {manifest.node!r} has none: add one to the scenario's actuators"
        )
    selected = _only(manifest.task.actions, "actuator", points) if name is None else name
    if selected not in points:
        raise InvalidConfig(f"there is no action or actuator {name!r} for pid; {did_you_mean(str(name), points)}")
    return points[selected]


def _only(
    defaults: Sequence[Sensor | Action], parameter: str, candidates: Sequence[str] | dict[str, Action | Actuator]
) -> str:
    if len(defaults) != 1:
        raise ControllerMismatch(
            f"pid takes one {parameter}: name it by {parameter}=...; {did_you_mean('', candidates)}"
        )
    return defaults[0].name


def _limits(output: Action | Actuator, low: float | None, high: float | None) -> tuple[float, float]:
    minimum, maximum = bounds(output)
    lower = minimum if low is None else number("low", low, minimum=minimum, maximum=maximum)
    upper = maximum if high is None else number("high", high, minimum=minimum, maximum=maximum)
    if math.isinf(lower) or math.isinf(upper):
        raise InvalidConfig(f"{output.name!r} has no bounds: set the limits of the output by low=... and high=...")
    if not lower < upper:
        raise InvalidConfig(f"low = {lower:g} is not below high = {upper:g}")
    return lower, upper
