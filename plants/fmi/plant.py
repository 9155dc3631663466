"""An FMU as the class of a plant."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from math import floor, isfinite
from pathlib import Path
from typing import Any

from zenostat.bridge.python_plant.description import BEGIN, DURATION_S, MAX_STEP_S
from zenostat.plants.fmi.instance import Experiment, Instance, start
from zenostat.plants.fmi.model import check_starts, fmpy, read_model
from zenostat.plants.fmi.variables import PointNames, Variable, inputs, outputs
from zenostat.topics.errors import InvalidConfig

_TASKS = "/proc/self/task"
_DESCRIPTORS = Path("/proc/self/fd")


class FmuPlant:
    """An FMU (FMI 2.0 or 3.0 for co-simulation, 2.0 for model exchange); see docs/fmi.md.

    Args:
        file: the FMU.
        set: start values of parameters, inputs and states, by their names in the FMU.
        observe: names of further variables to publish as sensors.
        step_s: timestep; by default that of the model description.
        duration_s: length of an episode; by default that of the model description, rounded down to whole timesteps.
        start_s: the FMU's time at sample 0; by default that of the model description.
        begin: simulated time of sample 0; by default 2001-01-01, plus `start_s`.
        tolerance: relative tolerance; by default that of the model description.
        interface: `CoSimulation` or `ModelExchange`; by default co-simulation if the FMU has it.

    Attributes:
        step_s, duration_s, begin, sensors, actuators, model_name, files, warnings: see
            `zenostat.bridge.python_plant.Plant`.
        copy_error: why it cannot be copied; empty if it can.
    """

    forkable = True
    begins_alike = True
    copy_error = ""

    def __init__(
        self,
        file: str,
        set: Mapping[str, Any] | None = None,  # noqa: A002  # the name of the option
        observe: Sequence[str] = (),
        step_s: float | None = None,
        duration_s: float | None = None,
        start_s: float | None = None,
        begin: str | None = None,
        tolerance: float | None = None,
        interface: str | None = None,
    ) -> None:
        _check_arguments(set, observe, tolerance)
        path = Path(file).absolute()
        self._model = read_model(path, interface)
        self.model_name, self.files = str(self._model.description.modelName), {"fmu": str(path)}
        notes = list(self._model.notes)
        self._experiment = self._read_experiment(step_s, duration_s, start_s, tolerance, set or {}, notes)
        self.step_s = self._experiment.step_s
        self.duration_s = self._experiment.stop_s - self._experiment.start_s
        self.begin = begin or _calendar(self._experiment.start_s)
        names = PointNames()
        self._outputs = outputs(self._model.description, [observe] if isinstance(observe, str) else observe, names)
        self._inputs = inputs(self._model.description, dict(self._experiment.starts), names)
        self.sensors = {point: _sensor(v) for v in self._outputs for point in v.points}
        free = [v for v in self._inputs if not v.is_fixed]
        self.actuators = {p: spec for v in free for p, spec in zip(v.points, _actuators(v), strict=True)}
        if not self.sensors:
            raise InvalidConfig(f"{path} has no output that is a number; name variables to observe: observe=['name']")
        threads, sockets = len(os.listdir(_TASKS)), _count_sockets()
        self._instance: Instance | None = self._start()
        self._is_new = True
        if len(os.listdir(_TASKS)) > threads:
            notes.append("the FMU has threads of its own, so it has no snapshots, branches and trial steps")
        elif _count_sockets() > sockets:
            self.forkable = False  # two processes would send over one connection
            self.copy_error = f"the FMU {path.name} has connections of its own, so it cannot be copied"
            notes.append("the FMU has connections of its own, so it has no snapshots, branches and trial steps")
        self.warnings = notes

    def _read_experiment(
        self,
        step_s: float | None,
        duration_s: float | None,
        start_s: float | None,
        tolerance: float | None,
        starts: Mapping[str, Any],
        notes: list[str],
    ) -> Experiment:
        description = self._model.description
        first_s = _number("start_s", start_s) if start_s is not None else self._default("startTime") or 0.0
        length_s = _number("duration_s", duration_s) if duration_s is not None else None
        if length_s is None:
            stop_s = self._default("stopTime")
            length_s = stop_s - first_s if stop_s is not None and stop_s > first_s else DURATION_S
        step = _number("step_s", step_s) if step_s is not None else self._own_step_s()
        if step is None:
            step = min(float(fmpy().util.auto_interval(length_s)), MAX_STEP_S)
            notes.append(f"the FMU names no step size; step_s = {step:g} (set another: --plant-argument step_s=60)")
        if step <= 0.0:
            raise InvalidConfig(f"step_s = {step:g}: a number of seconds above 0 expected")
        if duration_s is None:
            length_s = max(1, floor(length_s / step + 1e-9)) * step
        own = float(tolerance) if tolerance is not None else self._default("tolerance")
        if own is not None and own <= 0.0:
            notes.append(f"the tolerance of the model description, {own:g}, is not above 0, and not used")
            own = None
        return Experiment(first_s, step, first_s + length_s, own, check_starts(description, starts))

    def _default(self, name: str) -> float | None:
        """Return a number of the model description's default experiment; None without one."""
        text = getattr(self._model.description.defaultExperiment, name, None)
        return None if text is None else _number(f"{name} of the model description", text, "a number")

    def _own_step_s(self) -> float | None:
        default_s = self._default("stepSize")
        fixed = getattr(self._model.description.coSimulation, "fixedInternalStepSize", None)
        if default_s is not None or fixed is None:
            return default_s
        return _number("fixedInternalStepSize of the model description", fixed)

    def _start(self) -> Instance:
        return start(self._model, self._experiment, self._inputs, self._outputs)

    def reset(self, seed: int) -> dict[str, float]:  # noqa: ARG002
        """Begin an episode; an FMU has no seed, so all episodes begin alike."""
        if not self._is_new or self._instance is None:
            self.close()
            self._instance = self._start()
        return self._instance.read()

    def step(self, commands: Mapping[str, float]) -> dict[str, float]:
        """Simulate a timestep with constant inputs; return the outputs at its end."""
        assert self._instance is not None
        self._is_new = False
        values: dict[Variable, tuple[float, ...]] = {}
        for variable in self._inputs:
            values[variable] = tuple(map(commands.get, variable.points, variable.start))
            if variable.activation is not None:
                is_active = variable.points[0] in commands or bool(variable.activation.start[0])
                values[variable.activation] = (float(is_active),)
        self._instance.step(values)
        return self._instance.read()

    def close(self) -> None:
        """End the instance."""
        instance, self._instance = self._instance, None
        if instance is not None:
            instance.free()


def _sensor(variable: Variable) -> tuple[str, float | None, float | None]:
    low, high = variable.low, variable.high
    has_range = low is None or high is None or low < high
    return (variable.unit, low, high) if has_range else (variable.unit, None, None)


def _actuators(variable: Variable) -> list[tuple[str, float | None, float | None, float] | tuple[Any, ...]]:
    bounds = (variable.unit, variable.low, variable.high)
    if variable.activation is not None:  # nobody commands it: the FMU's own control
        return [bounds]
    return [(*bounds, start) for start in variable.start]


def _check_arguments(starts: Any, observe: Any, tolerance: Any) -> None:
    if starts is not None and not isinstance(starts, Mapping):
        raise InvalidConfig(f"set = {starts!r}: values by name expected, such as {{'tank.T0': 293.15}}")
    if not isinstance(observe, str) and not (
        isinstance(observe, Sequence) and all(isinstance(name, str) for name in observe)
    ):
        raise InvalidConfig(f"observe = {observe!r}: a list of names expected")
    if tolerance is not None and (isinstance(tolerance, bool) or _number("tolerance", tolerance, "a number") <= 0.0):
        raise InvalidConfig(f"tolerance = {tolerance!r}: a number above 0 expected")


def _count_sockets() -> int:
    return sum(descriptor.is_socket() for descriptor in _DESCRIPTORS.iterdir())


def _number(name: str, value: Any, expected: str = "a number of seconds") -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InvalidConfig(f"{name} = {value!r}: {expected} expected") from None
    if not isfinite(number):
        raise InvalidConfig(f"{name} = {value!r}: {expected.replace('number', 'finite number')} expected")
    return number


def _calendar(start_s: float) -> datetime:
    try:
        return BEGIN + timedelta(seconds=start_s)
    except OverflowError:
        raise InvalidConfig(f"start_s = {start_s:g}: name the simulated time of sample 0 as well (begin)") from None
