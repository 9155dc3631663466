"""A running instance of an FMU, stepped as FMPy's `simulate_fmu` steps it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import inf, ulp
from typing import Any

from zenostat.plants.fmi.model import CO_SIMULATION, Model, fmpy
from zenostat.plants.fmi.variables import Variable
from zenostat.topics.errors import PlantFailed

_MAX_STEP_PARTS = 50.0
"""Part of the episode that a step of CVODE may take at most, as in FMPy."""
_TOLERANCE = 1e-5
"""FMPy's default relative tolerance for model exchange."""
_SAME = 1e-9
"""Part of a communication step by which two equal times may differ."""
_DISCARD = 2
"""FMI's status of a step that the FMU did not take."""


@dataclass(frozen=True, slots=True)
class Experiment:
    """Times, tolerance and start values of a simulation.

    Attributes:
        start_s, step_s, stop_s: begin, communication step and end, in the FMU's time.
        tolerance: relative tolerance; None is the FMU's own.
        starts: start values that replace those of the model description, by the name of the variable.
    """

    start_s: float
    step_s: float
    stop_s: float
    tolerance: float | None = None
    starts: Mapping[str, Any] = field(default_factory=dict)


class Instance(ABC):
    """A running instance; create it with `start`.

    Args:
        model: the FMU.
        experiment: what is simulated.
        inputs, outputs: variables that are set and read.
    """

    def __init__(
        self, model: Model, experiment: Experiment, inputs: Sequence[Variable], outputs: Sequence[Variable]
    ) -> None:
        self._experiment = experiment
        self._description = model.description
        self._is_fmi2 = model.description.fmiVersion == "2.0"
        self._outputs = _Group.of(outputs)
        self._steps = 0
        self.time = experiment.start_s
        self._simulation = fmpy().simulation
        self._fmu: Any = None
        with _Failures(self, "it cannot be instantiated"):
            self._fmu = fmpy().instantiate_fmu(str(model.folder), self._description, model.interface)
        with _Failures(self, "it cannot be initialized"):
            self._initialize(inputs)

    @property
    def name(self) -> str:
        """Name of the model, for errors."""
        return str(self._description.modelName)

    @abstractmethod
    def _initialize(self, inputs: Sequence[Variable]) -> None:
        """Set start values and initialize the FMU."""

    @abstractmethod
    def _advance(self, target_s: float) -> None:
        """Simulate up to a time."""

    @abstractmethod
    def _apply(self, values: Mapping[Variable, Sequence[float]]) -> None:
        """Set inputs at the present time."""

    def step(self, values: Mapping[Variable, Sequence[float]]) -> None:
        """Simulate a communication step with constant inputs.

        Args:
            values: of the inputs' elements.

        Raises:
            PlantFailed: the FMU reports an error, or ends the simulation.
        """
        experiment = self._experiment
        with _Failures(self, f"it failed after {self.time:g} s"):
            self._apply(values)
            self._advance(experiment.start_s + (self._steps + 1) * experiment.step_s)
        self._steps += 1

    def read(self) -> dict[str, float]:
        """Return the outputs, by the names of points."""
        values: dict[str, float] = {}
        with _Failures(self, f"its outputs at {self.time:g} s cannot be read"):
            for group in self._outputs:
                values.update(zip(group.points, self._get(group), strict=True))
        return values

    def _get(self, group: _Group) -> list[float]:
        getter = getattr(self._fmu, f"get{group.kind}")
        raw = getter(group.references) if self._is_fmi2 else getter(group.references, nValues=len(group.points))
        return [float(value) for value in raw]

    def _set(self, values: Mapping[Variable, Sequence[float]]) -> None:
        by_kind: dict[str, tuple[list[int], list[Any]]] = defaultdict(lambda: ([], []))
        for variable, numbers in values.items():
            references, flat = by_kind[variable.kind]
            references.append(variable.reference)
            flat += [float(n) for n in numbers] if variable.is_floating else [round(n) for n in numbers]
        for kind, (references, flat) in by_kind.items():
            converted = [bool(value) for value in flat] if kind == "Boolean" else flat
            getattr(self._fmu, f"set{kind}")(references, converted)

    def _set_starts(self, when: str, left: dict[str, Any]) -> dict[str, Any]:
        """Set the start values that can be set in a mode of the FMU; return the others."""
        settable = getattr(self._simulation, f"settable_in_{when}")
        rest: dict[str, Any] = self._simulation.apply_start_values(self._fmu, self._description, left, settable)
        return rest

    def free(self) -> None:
        """End the instance; an FMU that fails at its end changes nothing."""
        if self._fmu is None:
            return
        fmu, self._fmu = self._fmu, None
        try:
            fmu.terminate()
            fmu.freeInstance()
        except Exception:
            return


@dataclass(frozen=True, slots=True)
class _Group:
    """Variables of one type, which are read with one call."""

    kind: str
    references: list[int]
    points: list[str]

    @classmethod
    def of(cls, variables: Sequence[Variable]) -> list[_Group]:
        groups: dict[str, _Group] = {}
        for variable in variables:
            group = groups.setdefault(variable.kind, cls(variable.kind, [], []))
            group.references.append(variable.reference)
            group.points.extend(variable.points)
        return [*groups.values()]


class _Failures:
    """Raise whatever FMPy raises as `PlantFailed`, with the name of the model."""

    def __init__(self, instance: Instance, text: str) -> None:
        self._instance, self._text = instance, text

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, traceback: object) -> None:
        if isinstance(error, Exception) and not isinstance(error, PlantFailed):
            raise PlantFailed(f"FMU {self._instance.name}: {self._text}: {error}") from None


def _start_inputs(inputs: Sequence[Variable]) -> dict[Variable, Sequence[float]]:
    return {part: part.start for variable in inputs for part in (variable, variable.activation) if part is not None}


class CoSimulation(Instance):
    """An instance for co-simulation, FMI 2.0 or 3.0."""

    def _initialize(self, inputs: Sequence[Variable]) -> None:
        fmu, experiment = self._fmu, self._experiment
        times = {"tolerance": experiment.tolerance, "startTime": experiment.start_s, "stopTime": experiment.stop_s}
        if self._is_fmi2:
            fmu.setupExperiment(**times)
        starts = self._set_starts("instantiated", dict(experiment.starts))
        if self._is_fmi2:
            fmu.enterInitializationMode()
        else:
            fmu.enterInitializationMode(**times)
        self._set_starts("initialization_mode", starts)
        self._set(_start_inputs(inputs))
        fmu.exitInitializationMode()

    def _apply(self, values: Mapping[Variable, Sequence[float]]) -> None:
        self._set(values)

    def _advance(self, target_s: float) -> None:
        size = target_s - self.time
        try:
            result = self._fmu.doStep(currentCommunicationPoint=self.time, communicationStepSize=size)
        except self._simulation.FMICallException as error:
            if (
                error.status == _DISCARD
                and self._is_fmi2
                and self._fmu.getBooleanStatus(self._simulation.fmi2Terminated)
            ):
                last_s = self._fmu.getRealStatus(self._simulation.fmi2LastSuccessfulTime)
                raise PlantFailed(f"FMU {self.name}: it ended the simulation at {last_s:g} s") from None
            raise
        if not self._is_fmi2:
            self._check_result(*result)
        self.time = target_s

    def _check_result(self, event: object, terminated: bool, early: bool, last_s: float) -> None:  # noqa: ARG002, FBT001
        if terminated:
            raise PlantFailed(f"FMU {self.name}: it ended the simulation at {last_s:g} s")
        if early:
            raise PlantFailed(f"FMU {self.name}: it returned early, at {last_s:g} s, which it may not")


class _ConstantInput:
    """Inputs between two communication points, which do not change; FMPy's solver applies them."""

    def apply(self, *_: object, **__: object) -> None:
        """Do nothing."""


class ModelExchange(Instance):
    """An instance for model exchange, FMI 2.0, integrated by FMPy's CVODE."""

    def _initialize(self, inputs: Sequence[Variable]) -> None:
        fmu, experiment = self._fmu, self._experiment
        fmu.setupExperiment(startTime=experiment.start_s, stopTime=experiment.stop_s)
        starts = self._set_starts("instantiated", dict(experiment.starts))
        fmu.enterInitializationMode()
        self._set_starts("initialization_mode", starts)
        self._present: Mapping[Variable, Sequence[float]] = _start_inputs(inputs)
        self._set(self._present)
        fmu.exitInitializationMode()
        self._next_event_s = inf
        self._update_discrete_states()
        from fmpy.sundials import CVodeSolver  # a library that only model exchange needs

        self._solver = CVodeSolver(
            nx=self._description.numberOfContinuousStates,
            nz=self._description.numberOfEventIndicators,
            get_x=fmu.getContinuousStates,
            set_x=fmu.setContinuousStates,
            get_dx=fmu.getDerivatives,
            get_z=fmu.getEventIndicators,
            get_nominals=fmu.getNominalsOfContinuousStates,
            set_time=fmu.setTime,
            input=_ConstantInput(),
            startTime=experiment.start_s,
            maxStep=(experiment.stop_s - experiment.start_s) / _MAX_STEP_PARTS,
            relativeTolerance=experiment.tolerance or _TOLERANCE,
        )

    def _update_discrete_states(self) -> None:
        """Iterate the event in event mode, and return to continuous time."""
        is_needed = True
        while is_needed:
            is_needed, is_terminated, _, _, is_event_defined, event_s = self._fmu.newDiscreteStates()
            if is_terminated:
                raise PlantFailed(f"FMU {self.name}: it ended the simulation at {self.time:g} s")
        self._next_event_s = event_s if is_event_defined else inf
        self._fmu.enterContinuousTimeMode()

    def _apply(self, values: Mapping[Variable, Sequence[float]]) -> None:
        changed = {variable: numbers for variable, numbers in values.items() if numbers != self._present.get(variable)}
        if not changed:
            return
        self._fmu.enterEventMode()
        self._set(values)
        self._update_discrete_states()
        self._solver.reset(self.time)
        self._present = dict(values)

    def _advance(self, target_s: float) -> None:
        while self.time < target_s and not self._are_same(self.time, target_s):
            self._integrate(target_s)

    def _are_same(self, left_s: float, right_s: float) -> bool:
        """Return whether two times differ by rounding alone: a small part of a step, however late they are."""
        return abs(left_s - right_s) <= max(_SAME * self._experiment.step_s, 4.0 * ulp(left_s))

    def _integrate(self, target_s: float) -> None:
        """Integrate up to the target or the next event, and handle that event."""
        fmu, point_s = self._fmu, target_s
        if point_s > self._next_event_s and not self._are_same(point_s, self._next_event_s):
            point_s = self._next_event_s
        is_time_event = self._are_same(point_s, self._next_event_s)
        is_state_event, _, self.time = self._solver.step(self.time, point_s)
        fmu.setTime(self.time)
        is_step_event = False
        if self._description.modelExchange.needsCompletedIntegratorStep:
            is_step_event, is_terminated = fmu.completedIntegratorStep()
            if is_terminated:
                raise PlantFailed(f"FMU {self.name}: it ended the simulation at {self.time:g} s")
        if is_time_event or is_state_event or is_step_event:
            fmu.enterEventMode()
            self._update_discrete_states()
            self._solver.reset(self.time)

    def free(self) -> None:
        """End the instance and its solver."""
        self._solver = None
        super().free()


def start(model: Model, experiment: Experiment, inputs: Sequence[Variable], outputs: Sequence[Variable]) -> Instance:
    """Instantiate and initialize an FMU.

    Raises:
        PlantFailed: the FMU cannot be loaded, or reports an error.
    """
    kind = CoSimulation if model.interface == CO_SIMULATION else ModelExchange
    return kind(model, experiment, inputs, outputs)
