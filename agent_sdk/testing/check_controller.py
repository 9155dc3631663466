"""Checks for controllers."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable, Iterator, Mapping
from numbers import Real
from typing import Any

import numpy as np

from agent_sdk.bus.sample import SampleView
from agent_sdk.controllers.base import ControllerProtocol
from agent_sdk.testing import synthetic_samples
from agent_sdk.testing.fake_building import FakeBuilding
from agent_sdk.testing.fake_link import FakeLink
from agent_sdk.testing.report import Check, Report, name_of, raised, run
from topics.energyplus_names import THERMOSTAT
from topics.errors import ZenostatError
from topics.messages import Manifest

Maker = Callable[[Manifest], ControllerProtocol]
"""A controller's class, or a function that makes one."""

_SAMPLES = 200
_THERMOSTAT = THERMOSTAT.casefold()


def check_controller(make: Maker, manifest: Manifest | None = None, *, skip: Iterable[str] = ()) -> Report:
    """Checks a controller: `check_controller(MyRules)`, `check_controller(lambda m: MyRules(m, margin=0.5))`.

    It is shown episodes of invented samples; without a `manifest` those of a fake building, of which it also
    controls a whole episode.

    Args:
        make: makes the controller from a manifest. A controller that draws needs a fixed seed.
        manifest: of the node that it is for.
        skip: names of checks to leave out.

    Returns:
        What was checked.

    Raises:
        ConformanceError: all that is wrong, each with the name of its check.
    """
    checks = (
        CONTROLLER_CHECKS if manifest is None else {n: c for n, c in CONTROLLER_CHECKS.items() if c is not _controls}
    )
    return run(name_of(make), checks, _Stage(make, manifest), skip).require()


class _Stage:
    """A controller's maker, and what a new controller answers to an episode."""

    def __init__(self, make: Maker, manifest: Manifest | None) -> None:
        self.make = make
        self.manifest = FakeBuilding(begin="07-02", end="07-03").manifest if manifest is None else manifest
        self.before = self.manifest.model_dump()
        self._answers: list[Any] | None = None

    def samples(self, seed: int) -> list[SampleView]:
        return synthetic_samples.samples(self.manifest, _SAMPLES, seed)

    @property
    def answers(self) -> list[Any]:
        """Of a new controller, to the first episode: each what `act` gave, or the exception that it raised."""
        if self._answers is None:
            self._answers = play(self.make(self.manifest), self.samples(0))
        return self._answers

    @property
    def given(self) -> Iterator[tuple[int, Mapping[str, Any]]]:
        """The steps and answers that can be looked at."""
        return ((step, a) for step, a in enumerate(self.answers) if isinstance(a, Mapping))


def play(controller: ControllerProtocol, samples: list[SampleView]) -> list[Any]:
    """The controller's answers to all samples of an episode but the last; an exception in place of an answer."""
    begin(controller, samples[0])
    return [_answer(controller, sample) for sample in samples[:-1]]


def begin(controller: ControllerProtocol, sample: SampleView) -> None:
    """Tells a controller that an episode begins, if it wants to know."""
    if hasattr(controller, "begin"):
        controller.begin(sample)


def _answer(controller: ControllerProtocol, sample: SampleView) -> Any:
    try:
        answer = controller.act(sample)
    except Exception as error:
        return error
    # What is kept must not change when the controller changes its own later.
    return dict(answer) if isinstance(answer, Mapping) else answer


def _is_made(stage: _Stage) -> Iterator[str]:
    try:
        controller = stage.make(stage.manifest)
    except Exception as error:
        yield raised(error, f"making it from the manifest of node {stage.manifest.node!r}")
        return
    if not callable(getattr(controller, "act", None)):
        yield f"{name_of(controller)} has no method act(sample)"


def _answers(stage: _Stage) -> Iterator[str]:
    errors = [(step, answer) for step, answer in enumerate(stage.answers) if isinstance(answer, Exception)]
    if errors:
        step, error = errors[0]
        yield f"{raised(error, 'act')} (at sample {step}; at {len(errors)} of {len(stage.answers)} samples)"
    for step, answer in enumerate(stage.answers):
        if not isinstance(answer, Mapping | Exception):
            yield f"act gave {answer!r} at sample {step}; a dictionary of actuators and values expected"
            return


def _known(stage: _Stage) -> Iterator[str]:
    names = {a.name for a in stage.manifest.actuators}
    for _, answer in stage.given:
        for name in answer:
            if name not in names:
                yield f"the node has no actuator {name!r}"


def _finite(stage: _Stage) -> Iterator[str]:
    seen = set()
    for step, answer in stage.given:
        for name, value in answer.items():
            if value is not None and not _is_number(value) and name not in seen:
                seen.add(name)
                yield f"{name} = {value!r} at sample {step}; a finite number, or None to release it, expected"


def _is_number(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)


def _bounded(stage: _Stage) -> Iterator[str]:
    bounds = {a.name: (a.low, a.high) for a in stage.manifest.actuators}
    seen = set()
    for step, answer in stage.given:
        for name, value in answer.items():
            low, high = bounds.get(name, (None, None))
            if not _is_number(value) or name in seen:
                continue
            if (low is not None and value < low) or (high is not None and value > high):
                seen.add(name)
                yield f"{name} = {float(value):g} at sample {step}; its bounds are {low} to {high}"


def _uncrossed(stage: _Stage) -> Iterator[str]:
    thermostats = [a for a in stage.manifest.actuators if a.component_type.casefold() == _THERMOSTAT]
    kinds = ("heating setpoint", "cooling setpoint")
    by_kind = [{a.key: a.name for a in thermostats if a.control_type.casefold() == kind} for kind in kinds]
    pairs = [(by_kind[0][key], by_kind[1][key]) for key in by_kind[0] if key in by_kind[1]]
    held: dict[str, Any] = {}
    for step, answer in stage.given:
        held |= answer
        for heating, cooling in pairs:
            low, high = held.get(heating, math.nan), held.get(cooling, math.nan)
            if _is_number(low) and _is_number(high) and low > high:
                yield (
                    f"{heating} = {float(low):g} lies above {cooling} = {float(high):g} at sample {step}; "
                    "EnergyPlus ends a run on that"
                )
                return


def _harmless(stage: _Stage) -> Iterator[str]:
    samples = stage.samples(0)
    wires = [sample.message.model_dump() for sample in samples]
    play(stage.make(stage.manifest), samples)
    if stage.manifest.model_dump() != stage.before:
        yield "it changed the manifest"
    for sample, wire in zip(samples, wires, strict=True):
        if sample.message.model_dump() != wire:
            yield f"it changed sample {sample.step}"
            return


def _repeatable(stage: _Stage) -> Iterator[str]:
    again = play(stage.make(stage.manifest), stage.samples(0))
    yield from _difference(stage.answers, again, "a second one, made alike, answered the same samples differently")


def _forgets(stage: _Stage) -> Iterator[str]:
    used = stage.make(stage.manifest)
    play(used, stage.samples(1))
    after = play(used, stage.samples(0))
    lack = "" if hasattr(used, "begin") else "; it has no begin(sample) that could forget"
    yield from _difference(stage.answers, after, f"after another episode it answered differently{lack}")


def _separate(stage: _Stage) -> Iterator[str]:
    one, other = stage.make(stage.manifest), stage.make(stage.manifest)
    mine, theirs = stage.samples(0), stage.samples(1)
    begin(one, mine[0])
    begin(other, theirs[0])
    answers = []
    for sample, another in zip(mine[:-1], theirs[:-1], strict=True):
        answers.append(_answer(one, sample))
        _answer(other, another)
    yield from _difference(
        stage.answers, answers, "beside another one that controls another node it answered differently"
    )


def _difference(these: list[Any], those: list[Any], what: str) -> Iterator[str]:
    for step, (this, that) in enumerate(zip(these, those, strict=True)):
        # An exception is equal to itself only; its text tells.
        if repr(this) != repr(that):
            yield f"{what}: at sample {step} {_short(this)} and {_short(that)}"
            return


def _short(answer: Any) -> str:
    text = repr(answer)
    return text if len(text) <= 120 else text[:119] + "…"


def _joins(stage: _Stage) -> Iterator[str]:
    late = stage.samples(0)[_SAMPLES // 2 :]
    controller = stage.make(stage.manifest)
    try:
        begin(controller, late[0])
        controller.act(late[0])
    except Exception as error:
        if not isinstance(stage.answers[_SAMPLES // 2], Exception):
            yield raised(error, f"joining at sample {late[0].step}")


def _leaves_random_alone(stage: _Stage) -> Iterator[str]:
    python, numpy = random.getstate(), repr(np.random.get_state())
    play(stage.make(stage.manifest), stage.samples(0))
    if random.getstate() != python:
        yield "it draws from Python's global generator; draw from a random.Random of its own"
    if repr(np.random.get_state()) != numpy:
        yield "it draws from NumPy's global generator; draw from a numpy.random.default_rng of its own"


def _controls(stage: _Stage) -> Iterator[str]:
    link = FakeLink(FakeBuilding(begin="07-02", end="07-03"))
    controller = stage.make(link.manifest)
    sample = link.reset(seed=0)
    begin(controller, sample)
    while not sample.truncated:
        try:
            link.send(controller.act(sample))
            sample = link.receive()
        except ZenostatError as error:
            yield raised(error, f"the episode ended at sample {sample.step}: it")
            return


CONTROLLER_CHECKS: dict[str, Check[_Stage]] = {
    "is made from a manifest": _is_made,
    "answers each sample": _answers,
    "names only actuators of the node": _known,
    "values are finite": _finite,
    "values are within bounds": _bounded,
    "heating stays below cooling": _uncrossed,
    "changes neither sample nor manifest": _harmless,
    "the same samples get the same answers": _repeatable,
    "forgets at an episode's begin": _forgets,
    "shares nothing with others of its kind": _separate,
    "can join amid an episode": _joins,
    "leaves the global random generators alone": _leaves_random_alone,
    "controls a fake building to the episode's end": _controls,
}
"""In the order in which `check_controller` runs them."""
