"""PID controller of one temperature."""

from __future__ import annotations

import math
from collections.abc import Sequence

from zenostat.agent_sdk.controllers.action_roles import SETPOINTS, Role, role_of, temperature_sensors
from zenostat.agent_sdk.controllers.base import Controller, Values
from zenostat.agent_sdk.controllers.parameters import ControllerMismatch, actuator_values, number
from zenostat.bridge.client.sample import SampleView
from zenostat.topics.errors import InvalidConfig, did_you_mean
from zenostat.topics.messages import Action, Actuator, Manifest, Sensor
from zenostat.topics.points import bounds

_FLOATING_K = 0.5
"""Distance of a zone from its setpoint at which it is neither cooled nor heated."""


class PIDController(Controller):
    """Control one temperature with one action or actuator.

    With the error e = setpoint - T (T - setpoint if direct acting) and the timestep dt in hours, the output is

        u = bias + kp e + I + D,    I = I + min(ki dt, a) e,    D = -kd dT/dt (+kd dT/dt if direct acting)

    clipped to its limits. The derivative acts on the measurement, so that a change of the setpoint causes no kick; it
    is 0 at the first sample of an episode.

    The integral does not wind up. It changes no further than until the output reaches its limit (Astrom and Hagglund,
    Advanced PID Control, chapter 3), or is 0.5 K beyond the temperature of a zone that floats: a zone that is colder
    than its cooling setpoint is not cooled, so raising that setpoint further has no effect, and likewise for heating.

    The gain of the integral for one timestep is at most a = 1 - kp if the output is a zone setpoint and kp < 1. The
    loop is then stable for any timestep if the zone follows its setpoint with a gain of at most 1, at once or with a
    lag; with a gain of 1 and no lag, its poles are those of z^2 = kp. For other outputs, a = 7/3 kp has the same effect
    if kp times the change of the temperature per unit of the output is at most 0.3. With kp = 0 there is no such limit.

    Args:
        manifest: manifest of the node.
        setpoint: setpoint of the temperature, degC.
        sensor: name of a sensor in degC; None: the only zone air temperature.
        actuator: name of an action or an actuator; None: the only action.
        kp: proportional gain, output unit/K. The default is stable if the output is a zone setpoint.
        ki: integral gain, output unit/(K h).
        kd: derivative gain, output unit h/K.
        low: lower limit of the output; None: the lower bound of the action or actuator and, if the output is a zone
            setpoint, `setpoint` - `max_offset`.
        high: upper limit of the output; None: the upper bound and `setpoint` + `max_offset`, likewise.
        max_offset: maximum difference between `setpoint` and an output that is a zone setpoint, K, above 0.
        bias: output at zero error; None: `setpoint` if the output is a zone setpoint, else the middle of the limits.
        reverse: whether the output falls as the temperature rises (reverse acting), as for heating and for all
            setpoints; False for cooling power, valves and flows.
        others: fixed values of other actions or actuators, by name.

    Raises:
        InvalidConfig: there is no temperature sensor or actuator, or several of which none is named, or a parameter is
            invalid; or `setpoint` is further than `max_offset` outside the bounds of a zone setpoint.
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
        max_offset: float = 2.0,
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
        self._outputs = output.actuators if isinstance(output, Action) else (output.name,)
        self._role = role_of(output, next(a for a in manifest.actuators if a.name in self._outputs))
        limits = bounds(output)
        if self._role in SETPOINTS:
            limits = _around(self._setpoint, number("max_offset", max_offset, minimum=0.0), output)
        self._low, self._high = _limits(output, low, high, limits)
        middle = self._setpoint if self._role in SETPOINTS else (self._low + self._high) / 2
        self._bias = min(max(middle, self._low), self._high) if bias is None else number("bias", bias)
        self._fixed: Values = dict(actuator_values(manifest, others))
        conflicts = set(self._outputs) & set(self._fixed)
        if conflicts:
            raise InvalidConfig(
                f"{', '.join(sorted(conflicts))}: the controller's own output cannot have a fixed value"
            )
        self._dt_h = manifest.step_h
        self._integral_gain = min(self._gains[1] * self._dt_h, self._max_integral_gain())
        self._integral, self._previous = 0.0, math.nan

    def _max_integral_gain(self) -> float:
        kp = self._gains[0]
        if self._role in SETPOINTS and kp < 1.0:
            return 1.0 - kp
        return 7.0 / 3.0 * kp if kp else math.inf

    def begin(self, sample: SampleView) -> None:  # noqa: ARG002
        """Reset the integral and the previous temperature."""
        self._integral, self._previous = 0.0, math.nan

    def act(self, sample: SampleView) -> Values:
        """Return the output and the fixed values for the timestep that begins at `sample.time`."""
        kp, _, kd = self._gains
        measured = sample[self._sensor]
        error = self._sign * (self._setpoint - measured)
        rate = 0.0 if math.isnan(self._previous) else (measured - self._previous) / self._dt_h
        self._previous = measured
        without_integral = self._bias + kp * error - self._sign * kd * rate
        self._integrate(self._integral_gain * error, without_integral, measured)
        output = min(max(without_integral + self._integral, self._low), self._high)
        return {**self._fixed, **dict.fromkeys(self._outputs, output)}

    def _integrate(self, increment: float, without_integral: float, measured: float) -> None:
        """Change the integral by at most `increment`, and only as far as the output has an effect."""
        if increment > 0.0:
            highest = min(self._high, measured + _FLOATING_K) if self._role is Role.COOLING else self._high
            self._integral = max(self._integral, min(self._integral + increment, highest - without_integral))
        else:
            lowest = max(self._low, measured - _FLOATING_K) if self._role is Role.HEATING else self._low
            self._integral = min(self._integral, max(self._integral + increment, lowest - without_integral))


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


def _around(setpoint: float, max_offset: float, output: Action | Actuator) -> tuple[float, float]:
    """Return the default limits of a zone setpoint."""
    if max_offset == 0.0:
        raise InvalidConfig("max_offset = 0; expected more than 0 K")
    minimum, maximum = bounds(output)
    low, high = max(minimum, setpoint - max_offset), min(maximum, setpoint + max_offset)
    if low >= high:
        raise InvalidConfig(
            f"setpoint = {setpoint:g} is out of reach: {output.name!r} has bounds of {minimum:g} to {maximum:g} degC, "
            f"and max_offset is {max_offset:g} K"
        )
    return low, high


def _limits(
    output: Action | Actuator, low: float | None, high: float | None, defaults: tuple[float, float]
) -> tuple[float, float]:
    minimum, maximum = bounds(output)
    lower = defaults[0] if low is None else number("low", low, minimum=minimum, maximum=maximum)
    upper = defaults[1] if high is None else number("high", high, minimum=minimum, maximum=maximum)
    if math.isinf(lower) or math.isinf(upper):
        raise InvalidConfig(f"{output.name!r} has no bounds: set the limits of the output by low=... and high=...")
    if not lower < upper:
        raise InvalidConfig(f"low = {lower:g} is not below high = {upper:g}")
    return lower, upper
