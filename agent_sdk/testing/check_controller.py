"""Conformance checks for controllers."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable, Iterator, Mapping
from numbers import Real
from typing import Any

import numpy as np

from zenostat.agent_sdk.controllers.base import ControllerProtocol
from zenostat.agent_sdk.testing import synthetic_samples
from zenostat.agent_sdk.testing.fake_building import FakeBuilding
from zenostat.agent_sdk.testing.fake_link import FakeLink
from zenostat.agent_sdk.testing.report import Check, Report, name_of, raised, run
from zenostat.bridge.client.sample import SampleView
from zenostat.topics.energyplus_names import THERMOSTAT
from zenostat.topics.errors import UnknownName, ZenostatError
from zenostat.topics.messages import Manifest
from zenostat.topics.points import contains, describe_bounds

ControllerFactory = Callable[[Manifest], ControllerProtocol]
"""A controller class, or a function that creates a controller."""

_SAMPLES = 200
_THERMOSTAT = THERMOSTAT.casefold()


def check_controller(make: ControllerFactory, manifest: Manifest | None = None, *, skip: Iterable[str] = ()) -> Report:
    """Check a controller: `check_controller(MyRules)`, `check_controller(lambda m: MyRules(m, margin=0.5))`.

    The controller receives episodes of synthetic samples. Without a `manifest`, they are those of a fake building, of
    which the controller also controls a whole episode. A controller that names points needs the manifest of its node.

    Args:
        make: function that creates the controller from a manifest. A random controller needs a fixed seed.
        manifest: manifest of the node that the controller is for.
        skip: names of checks to skip.

    Returns:
        Report of all checks.

    Raises:
        ConformanceError: some checks failed; the text names each with its errors.
    """
    checks = (
        CONTROLLER_CHECKS if manifest is None else {n: c for n, c in CONTROLLER_CHECKS.items() if c is not _controls}
    )
    return run(name_of(make), checks, _CheckContext(make, manifest), skip).require()


class _CheckContext:
    """Factory of a controller, with the answers of a new controller to an episode."""

    def __init__(self, make: ControllerFactory, manifest: Manifest | None) -> None:
        self.make = make
        self.manifest = FakeBuilding(begin="07-02", end="07-03").manifest if manifest is None else manifest
        self.hint = "; for another node than the fake building, pass its manifest" if manifest is None else ""
        self.manifest_before = self.manifest.model_dump()
        self._answers: list[Any] | None = None

    def samples(self, seed: int) -> list[SampleView]:
        return synthetic_samples.samples(self.manifest, _SAMPLES, seed)

    @property
    def answers(self) -> list[Any]:
        """Return the answers of a new controller to the first episode; an exception in place of a missing answer."""
        if self._answers is None:
            self._answers = play(self.make(self.manifest), self.samples(0))
        return self._answers

    @property
    def valid_answers(self) -> Iterator[tuple[int, Mapping[str, Any]]]:
        """Yield the steps and answers that are mappings."""
        return ((step, a) for step, a in enumerate(self.answers) if isinstance(a, Mapping))


def play(controller: ControllerProtocol, samples: list[SampleView]) -> list[Any]:
    """Return a controller's answers to all samples of an episode but the last; exceptions in place of answers."""
    begin(controller, samples[0])
    return [_answer(controller, sample) for sample in samples[:-1]]


def begin(controller: ControllerProtocol, sample: SampleView) -> None:
    """Call the controller's `begin(sample)` if it has one."""
    if hasattr(controller, "begin"):
        controller.begin(sample)


def _answer(controller: ControllerProtocol, sample: SampleView) -> Any:
    try:
        answer = controller.act(sample)
    except Exception as error:
        return error
    # Copy the answer: the controller may change its own dictionary later.
    return dict(answer) if isinstance(answer, Mapping) else answer


def _is_created(context: _CheckContext) -> Iterator[str]:
    try:
        controller = context.make(context.manifest)
    except Exception as error:
        yield raised(error, f"creating it from the manifest of node {context.manifest.node!r}")
        return
    if not callable(getattr(controller, "act", None)):
        yield f"{name_of(controller)} has no method act(sample)"


def _answers(context: _CheckContext) -> Iterator[str]:
    errors = [(step, answer) for step, answer in enumerate(context.answers) if isinstance(answer, Exception)]
    if errors:
        step, error = errors[0]
        hint = context.hint if isinstance(error, UnknownName) else ""
        yield f"{raised(error, 'act')} (at sample {step}; at {len(errors)} of {len(context.answers)} samples){hint}"
    for step, answer in enumerate(context.answers):
        if not isinstance(answer, Mapping | Exception | None):
            yield f"act returned {answer!r} at sample {step}; expected a dictionary of actuators and values"
            return


def _names_known(context: _CheckContext) -> Iterator[str]:
    names = {a.name for a in context.manifest.actuators}
    for _, answer in context.valid_answers:
        for name in answer:
            if name not in names:
                yield f"the node has no actuator {name!r}{context.hint}"


def _finite(context: _CheckContext) -> Iterator[str]:
    reported = set()
    for step, answer in context.valid_answers:
        for name, value in answer.items():
            if value is not None and not _is_number(value) and name not in reported:
                reported.add(name)
                yield f"{name} = {value!r} at sample {step}; expected a finite number, or None to relinquish it"


def _is_number(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)


def _bounded(context: _CheckContext) -> Iterator[str]:
    actuators = {a.name: a for a in context.manifest.actuators}
    reported = set()
    for step, answer in context.valid_answers:
        for name, value in answer.items():
            if name not in actuators or not _is_number(value) or name in reported:
                continue
            if not contains(actuators[name], value):
                reported.add(name)
                yield f"{name} = {value:g} at sample {step}; its bounds are {describe_bounds(actuators[name])}"


def _uncrossed(context: _CheckContext) -> Iterator[str]:
    thermostats = [a for a in context.manifest.actuators if a.component_type.casefold() == _THERMOSTAT]
    kinds = ("heating setpoint", "cooling setpoint")
    by_kind = [{a.key: a.name for a in thermostats if a.control_type.casefold() == kind} for kind in kinds]
    pairs = [(by_kind[0][key], by_kind[1][key]) for key in by_kind[0] if key in by_kind[1]]
    commanded: dict[str, Any] = {}
    for step, answer in context.valid_answers:
        commanded |= answer
        for heating, cooling in pairs:
            low, high = commanded.get(heating, math.nan), commanded.get(cooling, math.nan)
            if _is_number(low) and _is_number(high) and low > high:
                yield (
                    f"{heating} = {float(low):g} is above {cooling} = {float(high):g} at sample {step}; "
                    "EnergyPlus stops in that case"
                )
                return


def _harmless(context: _CheckContext) -> Iterator[str]:
    samples = context.samples(0)
    wires = [sample.message.model_dump() for sample in samples]
    play(context.make(context.manifest), samples)
    if context.manifest.model_dump() != context.manifest_before:
        yield "it changed the manifest"
    for sample, wire in zip(samples, wires, strict=True):
        if sample.message.model_dump() != wire:
            yield f"it changed sample {sample.step}"
            return


def _repeatable(context: _CheckContext) -> Iterator[str]:
    again = play(context.make(context.manifest), context.samples(0))
    yield from _difference(context.answers, again, "a second instance answered the same samples differently")


def _resets(context: _CheckContext) -> Iterator[str]:
    used = context.make(context.manifest)
    play(used, context.samples(1))
    after = play(used, context.samples(0))
    hint = "" if hasattr(used, "begin") else "; it has no begin(sample) to reset its state"
    yield from _difference(context.answers, after, f"after another episode it answered differently{hint}")


def _separate(context: _CheckContext) -> Iterator[str]:
    checked, companion = context.make(context.manifest), context.make(context.manifest)
    samples, other_samples = context.samples(0), context.samples(1)
    begin(checked, samples[0])
    begin(companion, other_samples[0])
    answers = []
    for sample, other_sample in zip(samples[:-1], other_samples[:-1], strict=True):
        answers.append(_answer(checked, sample))
        _answer(companion, other_sample)
    yield from _difference(
        context.answers, answers, "next to an instance that controls another node it answered differently"
    )


def _difference(expected: list[Any], actual: list[Any], description: str) -> Iterator[str]:
    for step, (first, second) in enumerate(zip(expected, actual, strict=True)):
        # Compare texts: exceptions are only equal to themselves.
        if repr(first) != repr(second):
            yield f"{description}: at sample {step} {_short(first)} and {_short(second)}"
            return


def _short(answer: Any) -> str:
    text = repr(answer)
    return text if len(text) <= 120 else text[:119] + "…"


def _joins(context: _CheckContext) -> Iterator[str]:
    late = context.samples(0)[_SAMPLES // 2 :]
    controller = context.make(context.manifest)
    try:
        begin(controller, late[0])
        controller.act(late[0])
    except Exception as error:
        if not isinstance(context.answers[_SAMPLES // 2], Exception):
            yield raised(error, f"joining at sample {late[0].step}")


def _leaves_random_alone(context: _CheckContext) -> Iterator[str]:
    python, numpy = random.getstate(), repr(np.random.get_state())
    play(context.make(context.manifest), context.samples(0))
    if random.getstate() != python:
        yield "it draws from Python's global generator; use an own random.Random"
    if repr(np.random.get_state()) != numpy:
        yield "it draws from NumPy's global generator; use an own numpy.random.default_rng"


def _controls(context: _CheckContext) -> Iterator[str]:
    link = FakeLink(FakeBuilding(begin="07-02", end="07-03"))
    controller = context.make(link.manifest)
    sample = link.reset(seed=0)
    begin(controller, sample)
    while not sample.truncated:
        try:
            link.send(controller.act(sample))
            sample = link.receive()
        except ZenostatError as error:
            yield raised(error, f"the episode ended at sample {sample.step}: it")
            return


CONTROLLER_CHECKS: dict[str, Check[_CheckContext]] = {
    "is created from a manifest": _is_created,
    "answers each sample": _answers,
    "names only actuators of the node": _names_known,
    "values are finite": _finite,
    "values are within bounds": _bounded,
    "heating stays below cooling": _uncrossed,
    "changes neither sample nor manifest": _harmless,
    "the same samples get the same answers": _repeatable,
    "resets at the start of an episode": _resets,
    "shares no state between instances": _separate,
    "can join during an episode": _joins,
    "leaves the global random generators alone": _leaves_random_alone,
    "controls a fake building to the end of the episode": _controls,
}
"""Checks by name, in the order in which `check_controller` runs them."""
