"""Conformance checks for plants."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from math import isnan
from typing import Any

import numpy as np

from zenostat.agent_sdk.testing.report import Check, Report, name_of, raised, run
from zenostat.bridge.python_plant.api import Plant
from zenostat.bridge.python_plant.description import (
    ClassDescription,
    Point,
    are_texts,
    describe,
    load_class,
    measured_number,
)
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.points import contains, describe_violation

PlantFactory = Callable[..., Plant]
"""A plant's class, or a function that creates a plant."""

Values = dict[str, float]
Commands = Callable[[int], Values]
"""Returns the commands that answer a sample."""

_PARTIAL_STEPS = 50
_MEAN_HOLD = 10
_SEED = 1


def check_plant(
    plant: PlantFactory | str,
    arguments: Mapping[str, Any] | None = None,
    *,
    max_steps: int = 1000,
    skip: Iterable[str] = (),
) -> Report:
    """Check a plant that is a Python class: `check_plant(Tank)`, `check_plant("tank.py:Tank")`.

    The plant runs in this process, with commands within the bounds of its actuators.

    Args:
        plant: the class, a function that creates an instance, or `FILE.py:CLASS` or `MODULE:CLASS`.
        arguments: of the class.
        max_steps: maximum number of timesteps of an episode that the checks simulate.
        skip: names of checks to skip.

    Returns:
        Report of all checks that apply.

    Raises:
        InvalidConfig: there is no such file, module or class, or `plant` is an instance.
        ConformanceError: some checks failed; the text names each with its errors.
    """
    factory: PlantFactory = load_class(plant) if isinstance(plant, str) else plant
    if not callable(factory):
        raise InvalidConfig(f"an instance of {name_of(plant)}; its class expected: check_plant({name_of(plant)})")
    context = _CheckContext(partial(factory, **(arguments or {})), max_steps)
    checks = {name: check for name, check in PLANT_CHECKS.items() if context.applies(check)}
    try:
        return run(name_of(factory), checks, context, skip).require()
    finally:
        context.close()


class _CheckContext:
    """Factory of a plant, with its description and an episode of it."""

    def __init__(self, make: Callable[[], Any], max_steps: int) -> None:
        self._create, self._max_steps = make, max_steps
        self._open: list[Any] = []
        self._description: ClassDescription | None = None
        self._episode: list[Values] | None = None

    def make(self) -> Any:
        """Create an instance, which `close` closes unless a check has closed it."""
        plant = self._create()
        if callable(getattr(plant, "close", None)):
            self._open.append(plant)
        return plant

    def close_instance(self, plant: Any) -> None:
        """Close an instance; raises what its `close` raises."""
        self._open = [other for other in self._open if other is not plant]
        plant.close()

    def close(self) -> None:
        """Close all instances that are open."""
        for plant in [*self._open]:
            with suppress(Exception, SystemExit):  # a check of its own reports it
                self.close_instance(plant)

    @property
    def description(self) -> ClassDescription:
        """Declarations of the class."""
        if self._description is None:
            self._description = describe(self.make())
        return self._description

    @property
    def points(self) -> tuple[Point, ...]:
        """Sensors and meters."""
        return (*self.description.sensors, *self.description.meters)

    @property
    def steps(self) -> int:
        """Number of timesteps of an episode that is checked."""
        return min(self.description.steps, self._max_steps)

    @property
    def few(self) -> int:
        """Number of timesteps of a part of an episode."""
        return min(self.steps, _PARTIAL_STEPS)

    @property
    def episode(self) -> list[Values]:
        """Values of each sample of an episode of a new instance, with random commands."""
        if self._episode is None:
            self._episode = self.play(self.make(), _SEED, self.steps)
        return self._episode

    def applies(self, check: Check[_CheckContext]) -> bool:
        """Whether a check concerns this plant."""
        try:
            description = self.description
        except (Exception, SystemExit):
            return True  # the first check reports it, and the others are skipped
        if check is _saves:
            return description.has_state
        if check is _closes:
            return description.has_close
        if check is _warns:
            return description.has_warnings
        if check is _begins_alike:
            return description.begins_alike
        return check is not _has_no_threads or description.forkable

    def play(self, plant: Any, seed: int, steps: int, commands: Commands | None = None) -> list[Values]:
        """Return the values of samples 0 to `steps`; by default with random commands, which the seed determines."""
        commands = self.random_commands(seed) if commands is None else commands
        episode = [dict(plant.reset(seed))]
        episode += (dict(plant.step(commands(step))) for step in range(steps))
        return episode

    def random_commands(self, seed: int, missing: float = 0.0) -> Commands:
        """Commands that are each held for some timesteps: a bound, a value within, or with a probability none."""
        random, held = np.random.default_rng([seed, 2]), Values()

        def commands(step: int) -> Values:
            for point in self.description.actuators:
                if step and random.random() > 1.0 / _MEAN_HOLD:
                    continue
                held.pop(point.name, None)
                if random.random() >= missing:
                    held[point.name] = _draw(point, random)
            return self.with_defaults(held)

        return commands

    def constant(self, share: float, without: Iterable[str] = ()) -> Commands:
        """Commands at a share of each actuator's range, but for some actuators."""
        held = {p.name: _at(p, share) for p in self.description.actuators if p.name not in without}
        return lambda _: self.with_defaults(held)

    def with_defaults(self, commands: Values) -> Values:
        """Add the defaults of missing commands, as a node does."""
        defaults = {p.name: p.default for p in self.description.actuators if p.default is not None}
        return {**defaults, **commands}


def _at(point: Point, share: float) -> float:
    low, high = point.low, point.high
    if low is None:
        low = -1.0 if high is None else high - 1.0
    return low + share * ((low + 1.0 if high is None else high) - low)


def _draw(point: Point, random: np.random.Generator) -> float:
    return _at(point, float(random.choice([0.0, 1.0, random.random(), random.random()])))


def _is_stepped(context: _CheckContext) -> Iterator[str]:
    try:
        plant = context.make()
        commands = context.constant(0.5)(0)
        values = [("reset", plant.reset(_SEED)), ("step", plant.step(commands))]
    except (Exception, SystemExit) as error:
        yield raised(error, "creating, describing, resetting or stepping it")
        return
    for method, value in values:
        if not isinstance(value, Mapping):
            yield f"{method} returned {value!r}; expected a dictionary of sensors and meters and their values"


def _names(context: _CheckContext) -> Iterator[str]:
    expected = [point.name for point in context.points]
    for step, values in enumerate(context.episode):
        if missing := [name for name in expected if name not in values]:
            yield f"there is no value of {', '.join(map(repr, missing))} at sample {step}"
        if unknown := [name for name in values if name not in expected]:
            yield f"{', '.join(map(repr, unknown))} at sample {step} is neither a sensor nor a meter"
        if missing or unknown:
            return


def _finite(context: _CheckContext) -> Iterator[str]:
    reported = set()
    for step, values in enumerate(context.episode):
        for name, value in values.items():
            if name not in reported and isnan(measured_number(value)):
                reported.add(name)
                yield f"{name} = {value!r} at sample {step}; expected a finite number"


def _bounded(context: _CheckContext) -> Iterator[str]:
    reported = set()
    for kind, commands in (
        ("random commands", None),
        ("all commands at their lower bounds", context.constant(0.0)),
        ("all commands at their upper bounds", context.constant(1.0)),
    ):
        episode = context.play(context.make(), _SEED, context.steps, commands) if commands else context.episode
        for step, values in enumerate(episode):
            for point in context.points:
                value = measured_number(values.get(point.name))
                if point.name not in reported and not isnan(value) and not contains(point, value):
                    reported.add(point.name)
                    yield f"{describe_violation(point, value)} (at sample {step}, {kind})"


def _relinquished(context: _CheckContext) -> Iterator[str]:
    names = [point.name for point in context.description.actuators]
    tries = [(name, context.constant(0.5, without=[name])) for name in names]
    tries.append(("some actuators in some steps", context.random_commands(_SEED, missing=0.5)))
    for missing, commands in tries:
        try:
            context.play(context.make(), _SEED, context.few, commands)
        except Exception as error:
            yield raised(error, f"without commands for {missing}, step")


def _repeatable(context: _CheckContext) -> Iterator[str]:
    again = context.play(context.make(), _SEED, context.steps)
    yield from _difference(context.episode, again, "the same seed and commands resulted in another episode")


def _begins_alike(context: _CheckContext) -> Iterator[str]:
    first, second = (
        context.play(context.make(), _SEED + k, context.few, context.random_commands(_SEED)) for k in range(2)
    )
    yield from _difference(first, second, "begins_alike is True, but another seed resulted in another episode")


def _anew(context: _CheckContext) -> Iterator[str]:
    used = context.make()
    context.play(used, _SEED + 1, context.few)
    after = context.play(used, _SEED, context.steps)
    yield from _difference(context.episode, after, "an episode that was not finished affects the next one")


def _separate(context: _CheckContext) -> Iterator[str]:
    plant, companion = context.make(), context.make()
    commands, other_commands = context.random_commands(_SEED), context.random_commands(_SEED + 1)
    episode = [dict(plant.reset(_SEED))]
    companion.reset(_SEED + 1)
    for step in range(context.few):
        episode.append(dict(plant.step(commands(step))))
        companion.step(other_commands(step))
    yield from _difference(context.episode, episode, "next to another instance it continued differently")


def _saves(context: _CheckContext) -> Iterator[str]:
    plant, half = context.make(), context.few // 2
    commands = context.random_commands(_SEED)
    episode = [dict(plant.reset(_SEED))]
    episode += (dict(plant.step(commands(step))) for step in range(half))
    try:
        state = pickle.dumps(plant.save())
        copy = context.make()
        copy.restore(pickle.loads(state))  # noqa: S301  # of the line before
    except Exception as error:
        yield raised(error, "save, pickling its state, or restore in a new instance")
        return
    rest = [commands(step) for step in range(half, context.few)]
    copied = [*episode, *(dict(copy.step(dict(values))) for values in rest)]
    yield from _difference(context.episode, copied, "a new instance with the saved state continued differently")
    continued = [*episode, *(dict(plant.step(dict(values))) for values in rest)]
    yield from _difference(context.episode, continued, "after save() it continued differently")
    try:
        plant.restore(pickle.loads(state))  # noqa: S301  # as above
    except Exception as error:
        yield raised(error, "restore in an instance that has gone on")
        return
    returned = [*episode, *(dict(plant.step(dict(values))) for values in rest)]
    yield from _difference(
        context.episode, returned, "after restore() in an instance that had gone on, it continued differently"
    )
    # Trials restore the present state, in each step, in one instance that is kept.
    kept, present, commands = context.make(), context.make(), context.random_commands(_SEED)
    tried = [dict(present.reset(_SEED))]
    for step in range(context.few):
        kept.restore(pickle.loads(pickle.dumps(present.save())))  # noqa: S301  # of the same line
        values = commands(step)
        tried.append(dict(kept.step(dict(values))))
        present.step(dict(values))
    yield from _difference(
        context.episode, tried, "after restore() in each step in one instance, it stepped differently"
    )


def _warns(context: _CheckContext) -> Iterator[str]:
    plant, commands = context.make(), context.random_commands(_SEED)
    plant.reset(_SEED)
    for step in range(context.steps + 1):
        if step:
            plant.step(commands(step - 1))
        try:
            texts = plant.drain_warnings()
        except (Exception, SystemExit) as error:
            yield raised(error, f"drain_warnings() at sample {step}")
            return
        if not are_texts(texts):
            yield f"drain_warnings() returned {texts!r} at sample {step}; expected a list of texts"
            return


def _has_no_threads(context: _CheckContext) -> Iterator[str]:
    before = set(threading.enumerate())
    plant = context.make()
    context.play(plant, _SEED, 1)
    if started := [thread.name for thread in threading.enumerate() if thread not in before]:
        yield f"it started {', '.join(started)}, which a fork loses; use save() and restore(state) instead"


def _closes(context: _CheckContext) -> Iterator[str]:
    plant = context.make()
    tries = [("a new instance", context.make()), ("an instance within an episode", plant)]
    context.play(plant, _SEED, context.few)
    for what, instance in tries:
        try:
            context.close_instance(instance)
        except (Exception, SystemExit) as error:
            yield raised(error, f"close() of {what}")


def _difference(expected: list[Values], actual: list[Values], description: str) -> Iterator[str]:
    """Compare samples up to the end of the shorter episode, to the bit."""
    for step, (first, second) in enumerate(zip(expected, actual, strict=False)):
        for name, value in first.items():
            if repr(value) != repr(second.get(name)):  # NaN differs from itself
                yield f"{description}: {name} is {value!r} and {second.get(name)!r} at sample {step}"
                return


PLANT_CHECKS: dict[str, Check[_CheckContext]] = {
    "can be created, reset and stepped": _is_stepped,
    "returns a value of each sensor and meter": _names,
    "values are finite": _finite,
    "values are within bounds": _bounded,
    "warnings are texts": _warns,
    "commands may be missing": _relinquished,
    "the same seed results in the same episode": _repeatable,
    "all episodes begin alike if it says so": _begins_alike,
    "a reset during an episode leaves no trace": _anew,
    "shares no state between instances": _separate,
    "continues from a saved state": _saves,
    "starts no threads if it is forkable": _has_no_threads,
    "can be closed": _closes,
}
"""Checks by name, in the order in which `check_plant` runs them."""
