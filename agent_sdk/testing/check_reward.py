"""Conformance checks for rewards."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from zenostat.agent_sdk.rewards import AnyReward, BoundReward, Outcome, Reward, read_reward
from zenostat.agent_sdk.rewards.custom import ATTRIBUTES, is_custom
from zenostat.agent_sdk.testing import synthetic_samples
from zenostat.agent_sdk.testing.fake_building import FakeBuilding
from zenostat.agent_sdk.testing.report import Check, Report, name_of, raised, run
from zenostat.topics.errors import InvalidConfig, UnknownName
from zenostat.topics.messages import Manifest

_STEPS = 120
_SLOTS = 3
_SHIFT_H = 24.0 * 61.0
_ROUNDING = 1e-9


def check_reward(reward: AnyReward, manifest: Manifest | None = None, *, skip: Iterable[str] = ()) -> Report:
    """Check a reward on synthetic values of three seasons: `check_reward(MyReward(weight=0.3))`.

    Args:
        reward: a reward as for `read_reward`: an object with `bind`, a kind, or a function.
        manifest: manifest of the node that the reward is for; default: that of a fake building.
        skip: names of checks to skip.

    Returns:
        Report of all checks.

    Raises:
        ConformanceError: some checks failed; the text names each with its errors.
    """
    checked = read_reward(reward)
    context = _CheckContext(checked, FakeBuilding(2).manifest if manifest is None else manifest)
    return run(name_of(checked), REWARD_CHECKS, context, skip).require()


class _NotForVectors(Exception):
    """A function of the user's cannot compute the rewards of several buildings."""


class _CheckContext:
    """A reward with synthetic episodes: `values`, shape (steps, slots, points), `begins`, a list for each step."""

    def __init__(self, reward: Reward, manifest: Manifest) -> None:
        self.reward, self.manifest, self.manifest_before = reward, manifest, manifest.model_dump()
        self.values = np.stack([synthetic_samples.values(manifest, _STEPS, seed) for seed in range(_SLOTS)], axis=1)
        times = [synthetic_samples.episode_starts(manifest, _STEPS, slot * _SHIFT_H) for slot in range(_SLOTS)]
        self.begins = [list(step) for step in zip(*times, strict=True)]

    def bind(self) -> BoundReward:
        """Bind the reward and reset it."""
        bound = self.reward.bind(self.manifest)
        bound.reset()
        return bound

    def single_outcomes(self, bound: BoundReward, slot: int = 0, steps: range = range(_STEPS)) -> list[Any]:
        """Return the outcomes over an episode of one building."""
        return [bound(self.values[step, slot].copy(), self.begins[step][slot]) for step in steps]

    def batch_outcomes(self, bound: BoundReward, steps: range = range(_STEPS)) -> list[Any]:
        """Return the outcomes over an episode of all buildings at once."""
        try:
            return [bound(self.values[step].copy(), self.begins[step]) for step in steps]
        except Exception as error:
            if not is_custom(self.reward):
                raise
            raise _NotForVectors(
                f"{raised(error)}; vector environments call it with an array for each point and a list of times. Skip "
                "this check if the reward is for single environments only"
            ) from error


def _binds(context: _CheckContext) -> Iterator[str]:
    try:
        bound = context.reward.bind(context.manifest)
    except Exception as error:
        yield raised(error, f"binding it to node {context.manifest.node!r}")
        return
    if not callable(bound):
        yield f"bind returned {bound!r}; expected a BoundReward"
        return
    for method in ("reset", "state", "restore"):
        if not callable(getattr(bound, method, None)):
            yield f"the bound reward has no {method}(); derive it from BoundReward"


def _outcomes(context: _CheckContext) -> Iterator[str]:
    outcome = context.single_outcomes(context.bind())[0]
    if not isinstance(outcome, Outcome):
        yield f"it returned a {type(outcome).__name__}; expected an Outcome(reward, terms, metrics)"
        return
    for name, value in (("reward", outcome.reward), *outcome.terms.items(), *outcome.metrics.items()):
        if np.shape(value) != ():
            yield f"{name} has shape {np.shape(value)} for one building; expected a float"


def _sums(context: _CheckContext) -> Iterator[str]:
    for step, (reward, terms, _) in enumerate(context.single_outcomes(context.bind())):
        total = sum(terms.values())
        if not np.allclose(reward, total, rtol=_ROUNDING, atol=_ROUNDING):
            yield f"at timestep {step} the reward is {float(reward):g}, and its terms add up to {float(total):g}"
            return


def _finite(context: _CheckContext) -> Iterator[str]:
    for step, (reward, terms, metrics) in enumerate(context.single_outcomes(context.bind())):
        values = {"reward": reward, **terms, **metrics}
        bad = [f"{name} = {value}" for name, value in values.items() if not np.all(np.isfinite(value))]
        if bad:
            yield f"at timestep {step} {', '.join(bad)}; expected finite numbers"
            return


def _repeatable(context: _CheckContext) -> Iterator[str]:
    yield from _difference(
        context.single_outcomes(context.bind()),
        context.single_outcomes(context.bind()),
        "bound a second time it returned",
    )


def _resets(context: _CheckContext) -> Iterator[str]:
    used = context.bind()
    context.single_outcomes(used, slot=1)
    used.reset()
    yield from _difference(
        context.single_outcomes(context.bind()),
        context.single_outcomes(used),
        "after another episode and reset() it returned",
    )


def _harmless(context: _CheckContext) -> Iterator[str]:
    bound = context.bind()
    for step in range(_STEPS):
        values = context.values[step, 0].copy()
        values.flags.writeable = False  # as in a sample
        try:
            bound(values, context.begins[step][0])
        except ValueError as error:
            yield f"it modifies its argument values: {error}"
            return
    if context.manifest.model_dump() != context.manifest_before:
        yield "it changed the manifest"


def _shapes(context: _CheckContext) -> Iterator[str]:
    together = context.batch_outcomes(context.bind())
    for slot in range(_SLOTS):
        alone = context.single_outcomes(context.bind(), slot)
        for step, (batch, single) in enumerate(zip(together, alone, strict=True)):
            if np.shape(batch[0]) != (_SLOTS,):
                yield f"for {_SLOTS} buildings the reward has shape {np.shape(batch[0])}; expected ({_SLOTS},)"
                return
            if not np.allclose(batch[0][slot], single[0], rtol=_ROUNDING, atol=_ROUNDING):
                yield (
                    f"at timestep {step} building {slot} of {_SLOTS} gets {float(batch[0][slot]):g}, "
                    f"but {float(single[0]):g} alone"
                )
                return
    same = [context.manifest.time_at(0)] * _SLOTS
    with_list = context.bind()(context.values[0].copy(), same)[0]
    if not np.allclose(context.bind()(context.values[0].copy(), same[0])[0], with_list, rtol=_ROUNDING, atol=_ROUNDING):
        yield "one time for all buildings results in another reward than a list of equal times"


def _resets_slots(context: _CheckContext) -> Iterator[str]:
    half = _STEPS // 2
    plain, partly = context.bind(), context.bind()
    context.batch_outcomes(plain, range(half))
    context.batch_outcomes(partly, range(half))
    partly.reset([1])
    after_reset, without_reset = (
        context.batch_outcomes(partly, range(half, _STEPS)),
        context.batch_outcomes(plain, range(half, _STEPS)),
    )
    fresh = context.single_outcomes(context.bind(), 1, range(half, _STEPS))
    for step in range(len(fresh)):
        kept = [slot for slot in range(_SLOTS) if slot != 1]
        if not np.allclose(np.asarray(after_reset[step][0])[kept], np.asarray(without_reset[step][0])[kept]):
            yield "reset([1]) changed the reward of other buildings than 1"
            return
        if not np.allclose(after_reset[step][0][1], fresh[step][0]):
            yield "after reset([1]) building 1 does not get the reward of a new episode"
            return


def _restores(context: _CheckContext) -> Iterator[str]:
    half = _STEPS // 2
    first, second = context.bind(), context.bind()
    context.single_outcomes(first, steps=range(half))
    state = first.state()
    try:
        if ATTRIBUTES not in state:  # those of an object without state() may be of any type
            state = json.loads(json.dumps(state))
    except TypeError as error:
        yield f"state() contains values other than strings, numbers, lists and dictionaries: {error}"
    second.restore(state)
    rest = range(half, _STEPS)
    continued = context.single_outcomes(first, steps=rest)
    yield from _difference(
        continued, context.single_outcomes(second, steps=rest), "restored from its state it returned"
    )


def _missing(context: _CheckContext) -> Iterator[str]:
    manifest = context.manifest
    for name in manifest.names:
        reduced = manifest.model_copy(
            update={
                "sensors": tuple(s for s in manifest.sensors if s.name != name),
                "meters": tuple(m for m in manifest.meters if m.name != name),
            }
        )
        yield from _bind_to(context, reduced, f"without the point {name!r}")
    empty = manifest.model_copy(update={"sensors": (), "meters": ()})
    yield from _bind_to(context, empty, "without any point")


def _bind_to(context: _CheckContext, manifest: Manifest, condition: str) -> Iterator[str]:
    """Check that binding raises `InvalidConfig`, or that the bound reward works.

    A function's points are not known before it is called: its first call may raise `UnknownName`.
    """
    try:
        bound = context.reward.bind(manifest)
    except InvalidConfig:
        return
    except Exception as error:
        yield f"{raised(error, f'binding it {condition}')}; expected InvalidConfig"
        return
    try:
        bound.reset()
        bound(synthetic_samples.values(manifest, 1, 0)[0], context.begins[0][0])
    except Exception as error:
        if is_custom(context.reward) and isinstance(error, UnknownName):
            return
        yield f"{condition} it was bound, but {raised(error)}; expected an InvalidConfig from bind"


def _difference(expected: Sequence[Any], actual: Sequence[Any], description: str) -> Iterator[str]:
    for step, (first, second) in enumerate(zip(expected, actual, strict=True)):
        if not np.array_equal(first[0], second[0], equal_nan=True):
            yield f"{description} another reward: at timestep {step} {second[0]} instead of {first[0]}"
            return


REWARD_CHECKS: dict[str, Check[_CheckContext]] = {
    "binds to a manifest": _binds,
    "returns an Outcome of floats": _outcomes,
    "the terms add up to the reward": _sums,
    "all values are finite": _finite,
    "the same values get the same reward": _repeatable,
    "resets completely": _resets,
    "changes neither values nor manifest": _harmless,
    "several buildings at once get the same rewards as alone": _shapes,
    "resets single buildings": _resets_slots,
    "continues from a restored state": _restores,
    "a missing point is an InvalidConfig": _missing,
}
"""Checks by name, in the order in which `check_reward` runs them."""
