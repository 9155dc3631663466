"""Checks for rewards."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent_sdk.rewards import AnyReward, BoundReward, Outcome, Reward, read_reward
from agent_sdk.testing import synthetic_samples
from agent_sdk.testing.fake_building import FakeBuilding
from agent_sdk.testing.report import Check, Report, name_of, raised, run
from topics.errors import InvalidConfig
from topics.messages import Manifest

Floats = NDArray[np.float64]

_STEPS = 120
_SLOTS = 3
_SHIFT_H = 24.0 * 61.0
_ROUNDING = 1e-9


def check_reward(reward: AnyReward, manifest: Manifest | None = None, *, skip: Iterable[str] = ()) -> Report:
    """Checks a reward on invented values, of three seasons: `check_reward(MyReward(weight=0.3))`.

    Args:
        reward: whatever `read_reward` takes: an object that can be bound, a kind, a function.
        manifest: of the node that it is for; without one a fake building's.
        skip: names of checks to leave out.

    Returns:
        What was checked.

    Raises:
        ConformanceError: all that is wrong, each with the name of its check.
    """
    made = read_reward(reward)
    about = _Stage(made, FakeBuilding(2).manifest if manifest is None else manifest)
    return run(name_of(made), REWARD_CHECKS, about, skip).require()


class _Stage:
    """A reward and episodes of values: `values` has shape (steps, slots, points), `begins` a list for each step."""

    def __init__(self, reward: Reward, manifest: Manifest) -> None:
        self.reward, self.manifest, self.before = reward, manifest, manifest.model_dump()
        self.values = np.stack([synthetic_samples.values(manifest, _STEPS, seed) for seed in range(_SLOTS)], axis=1)
        times = [synthetic_samples.episode_starts(manifest, _STEPS, slot * _SHIFT_H) for slot in range(_SLOTS)]
        self.begins = [list(step) for step in zip(*times, strict=True)]

    def bind(self) -> BoundReward:
        """A new one, at an episode's begin."""
        bound = self.reward.bind(self.manifest)
        bound.reset()
        return bound

    def one(self, bound: BoundReward, slot: int = 0, steps: range = range(_STEPS)) -> list[Any]:
        """Its outcomes over an episode of one building."""
        return [bound(self.values[step, slot].copy(), self.begins[step][slot]) for step in steps]

    def all(self, bound: BoundReward, steps: range = range(_STEPS)) -> list[Any]:
        """Its outcomes over an episode of several buildings at once."""
        return [bound(self.values[step].copy(), self.begins[step]) for step in steps]


def _binds(stage: _Stage) -> Iterator[str]:
    try:
        bound = stage.reward.bind(stage.manifest)
    except Exception as error:
        yield raised(error, f"binding it to node {stage.manifest.node!r}")
        return
    if not callable(bound):
        yield f"bind gave {bound!r}; a BoundReward expected"
        return
    for method in ("reset", "state", "restore"):
        if not callable(getattr(bound, method, None)):
            yield f"what bind gave has no {method}(); derive it from BoundReward"


def _outcomes(stage: _Stage) -> Iterator[str]:
    outcome = stage.one(stage.bind())[0]
    if not isinstance(outcome, Outcome):
        yield f"it gave a {type(outcome).__name__}; an Outcome(reward, terms, measures) expected"
        return
    for what, value in (("reward", outcome.reward), *outcome.terms.items(), *outcome.metrics.items()):
        if np.shape(value) != ():
            yield f"{what} has shape {np.shape(value)} for one building; a float expected"


def _sums(stage: _Stage) -> Iterator[str]:
    for step, (reward, terms, _) in enumerate(stage.one(stage.bind())):
        total = sum(terms.values())
        if not np.allclose(reward, total, rtol=_ROUNDING, atol=_ROUNDING):
            yield f"at timestep {step} the reward is {float(reward):g}, and its terms add up to {float(total):g}"
            return


def _finite(stage: _Stage) -> Iterator[str]:
    for step, (reward, terms, measures) in enumerate(stage.one(stage.bind())):
        named = {"reward": reward, **terms, **measures}
        bad = [f"{name} = {value}" for name, value in named.items() if not np.all(np.isfinite(value))]
        if bad:
            yield f"at timestep {step} {', '.join(bad)}; finite numbers expected"
            return


def _repeatable(stage: _Stage) -> Iterator[str]:
    yield from _difference(stage.one(stage.bind()), stage.one(stage.bind()), "bound a second time it gave")


def _forgets(stage: _Stage) -> Iterator[str]:
    used = stage.bind()
    stage.one(used, slot=1)
    used.reset()
    yield from _difference(stage.one(stage.bind()), stage.one(used), "after another episode and reset() it gave")


def _harmless(stage: _Stage) -> Iterator[str]:
    bound = stage.bind()
    for step in range(_STEPS):
        values = stage.values[step, 0].copy()
        values.flags.writeable = False  # as a sample's are
        try:
            bound(values, stage.begins[step][0])
        except ValueError as error:
            yield f"it writes into the values that it is given: {error}"
            return
    if stage.manifest.model_dump() != stage.before:
        yield "it changed the manifest"


def _shapes(stage: _Stage) -> Iterator[str]:
    together = stage.all(stage.bind())
    for slot in range(_SLOTS):
        alone = stage.one(stage.bind(), slot)
        for step, (batch, single) in enumerate(zip(together, alone, strict=True)):
            if np.shape(batch[0]) != (_SLOTS,):
                yield f"for {_SLOTS} buildings the reward has shape {np.shape(batch[0])}; ({_SLOTS},) expected"
                return
            if not np.allclose(batch[0][slot], single[0], rtol=_ROUNDING, atol=_ROUNDING):
                yield (
                    f"at timestep {step} building {slot} of {_SLOTS} gets {float(batch[0][slot]):g}, "
                    f"and {float(single[0]):g} by itself"
                )
                return
    same = [datetime.fromisoformat(stage.manifest.begin)] * _SLOTS
    listed = stage.bind()(stage.values[0].copy(), same)[0]
    if not np.allclose(stage.bind()(stage.values[0].copy(), same[0])[0], listed, rtol=_ROUNDING, atol=_ROUNDING):
        yield "one time for all buildings gives another reward than the same time for each"


def _resets_slots(stage: _Stage) -> Iterator[str]:
    half = _STEPS // 2
    plain, partly = stage.bind(), stage.bind()
    stage.all(plain, range(half))
    stage.all(partly, range(half))
    partly.reset([1])
    after, through = stage.all(partly, range(half, _STEPS)), stage.all(plain, range(half, _STEPS))
    fresh = stage.one(stage.bind(), 1, range(half, _STEPS))
    for step in range(len(fresh)):
        kept = [slot for slot in range(_SLOTS) if slot != 1]
        if not np.allclose(np.asarray(after[step][0])[kept], np.asarray(through[step][0])[kept]):
            yield "reset([1]) changed the reward of other buildings than 1"
            return
        if not np.allclose(after[step][0][1], fresh[step][0]):
            yield "after reset([1]) building 1 does not get what it gets at an episode's begin"
            return


def _restores(stage: _Stage) -> Iterator[str]:
    half = _STEPS // 2
    first, second = stage.bind(), stage.bind()
    stage.one(first, steps=range(half))
    state = first.state()
    try:
        state = json.loads(json.dumps(state))
    except TypeError as error:
        yield f"state() has other than plain values (texts, numbers, lists, dictionaries): {error}"
    second.restore(state)
    rest = range(half, _STEPS)
    went_on = stage.one(first, steps=rest)
    yield from _difference(went_on, stage.one(second, steps=rest), "restored from its state it gave")


def _missing(stage: _Stage) -> Iterator[str]:
    manifest = stage.manifest
    for name in manifest.names:
        less = manifest.model_copy(
            update={
                "sensors": tuple(s for s in manifest.sensors if s.name != name),
                "meters": tuple(m for m in manifest.meters if m.name != name),
            }
        )
        yield from _bound_to(stage, less, f"without the point {name!r}")
    bare = manifest.model_copy(update={"sensors": (), "meters": ()})
    yield from _bound_to(stage, bare, "without any point")


def _bound_to(stage: _Stage, manifest: Manifest, where: str) -> Iterator[str]:
    """It says that it cannot be, or it works."""
    try:
        bound = stage.reward.bind(manifest)
    except InvalidConfig:
        return
    except Exception as error:
        yield f"{raised(error, f'binding it {where}')}; InvalidConfig expected"
        return
    try:
        bound.reset()
        bound(synthetic_samples.values(manifest, 1, 0)[0], stage.begins[0][0])
    except Exception as error:
        yield f"{where} it was bound, and {raised(error)}; an InvalidConfig of bind expected"


def _difference(these: Sequence[Any], those: Sequence[Any], what: str) -> Iterator[str]:
    for step, (this, that) in enumerate(zip(these, those, strict=True)):
        if not np.array_equal(this[0], that[0], equal_nan=True):
            yield f"{what} another reward: at timestep {step} {that[0]} in place of {this[0]}"
            return


REWARD_CHECKS: dict[str, Check[_Stage]] = {
    "binds to a manifest": _binds,
    "gives an Outcome of floats": _outcomes,
    "the terms add up to the reward": _sums,
    "all is finite": _finite,
    "the same values get the same reward": _repeatable,
    "forgets at reset": _forgets,
    "changes neither values nor manifest": _harmless,
    "several buildings at once get what each gets alone": _shapes,
    "resets single buildings": _resets_slots,
    "goes on from its state": _restores,
    "a missing point is an InvalidConfig": _missing,
}
"""In the order in which `check_reward` runs them."""
