"""The errors of the testing kit: each names what is wrong with a controller, a reward or an environment."""

import itertools
import random
import re
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from support.run_cli import run_python

from zenostat.agent_sdk.controllers import Controller
from zenostat.agent_sdk.rewards import BoundReward, Outcome
from zenostat.agent_sdk.testing import ConformanceError, FakeEnv, check_controller, check_environment, check_reward
from zenostat.agent_sdk.testing.check_controller import CONTROLLER_CHECKS
from zenostat.agent_sdk.testing.check_environment import ENVIRONMENT_CHECKS
from zenostat.agent_sdk.testing.check_reward import REWARD_CHECKS
from zenostat.topics.errors import EpisodeChanged, InvalidConfig

HEAT, COOL = "zone_1_heating_setpoint", "zone_1_cooling_setpoint"


class Good(Controller):
    """Counts its samples, and forgets them when an episode begins."""

    def begin(self, sample: Any) -> None:
        self.count = 0

    def act(self, sample: Any) -> Any:
        self.count += 1
        return {HEAT: 18.0 + 0.1 * (self.count % 10), COOL: None if self.count % 7 else 26.0}


class Remembers(Good):
    def __init__(self, manifest: Any) -> None:
        super().__init__(manifest)
        self.count = 0

    def begin(self, sample: Any) -> None:
        pass


class SharesItsCount(Good):
    counts: list[int] = []  # noqa: RUF012

    def begin(self, sample: Any) -> None:
        self.counts.clear()

    def act(self, sample: Any) -> Any:
        self.counts.append(1)
        return {HEAT: 18.0 + 0.1 * (len(self.counts) % 10)}


class Answers(Good):
    """Answers with what a function of the sample gives."""

    answer: Callable[[Any], Any]

    def act(self, sample: Any) -> Any:
        return type(self).answer(sample)


def answering(function: Callable[[Any], Any]) -> type:
    return type("Answering", (Answers,), {"answer": staticmethod(function)})


def lengthens(sample: Any) -> Any:
    sample.message.sources.append("me")
    return {}


class ChangesTheManifest(Good):
    def __init__(self, manifest: Any) -> None:
        super().__init__(manifest)
        manifest.task.reward["weight"] = len(manifest.task.reward) / 100


class OnlyFromTheStart(Good):
    def begin(self, sample: Any) -> None:
        super().begin(sample)
        assert sample.step == 0, "an episode begins at sample 0"


numbers = itertools.count()
REFUSED = "controls a fake building to the end of the episode"

CONTROLLER_MUTANTS: dict[str, tuple[Any, dict[str, Any]]] = {
    "no act": (lambda manifest: object(), {"is created from a manifest": "has no method act"}),
    "cannot be made": (lambda: None, {"is created from a manifest": "raised TypeError"}),
    "raises": (answering(lambda s: {HEAT: [20.0, 20.0, 20.0][s.step]}),
        {"answers each sample": r"act raised IndexError: .*at sample 3; at 196 of 199", REFUSED: None}),
    "no dictionary": (answering(lambda s: [20.0, 25.0]),
        {"answers each sample": r"act returned \[20.0, 25.0\] at sample 0", REFUSED: None}),
    "unknown": (answering(lambda s: {"heating": 20.0}),
        {"names only actuators of the node": "no actuator 'heating'", REFUSED: "InvalidAction"}),
    "not finite": (answering(lambda s: {HEAT: float("nan"), COOL: 25.0}),
        {"values are finite": f"{HEAT} = nan at sample 0", REFUSED: "InvalidAction"}),
    "out of bounds": (
        answering(lambda s: {COOL: 31.0 if s.step == 9 else 24.0}),
        {
            "values are within bounds": f"{COOL} = 31 at sample 9; its bounds are 22.5 to 30 degC",
            REFUSED: "RequestRejected",
        },
    ),
    "crossing": (
        answering(lambda s: {HEAT: 24.0} if s.step == 5 else {COOL: 23.0} if s.step == 2 else {}),
        {
            "heating stays below cooling": f"{HEAT} = 24 is above {COOL} = 23 at sample 5",
            "values are within bounds": f"{HEAT} = 24",
            REFUSED: "RequestRejected",
        },
    ),
    "changes the sample": (answering(lengthens), {"changes neither sample nor manifest": "changed sample 0"}),
    "changes the manifest": (ChangesTheManifest, {"changes neither sample nor manifest": "changed the manifest"}),
    "remembers": (Remembers, {"resets at the start of an episode": "after another episode it answered differently"}),
    "shares": (SharesItsCount, {"shares no state between instances": "answered differently: at sample"}),
    "draws unseeded": (
        answering(lambda s: {HEAT: 15.0 + next(numbers) % 7}),
        {
            "the same samples get the same answers": "a second instance answered",
            "resets at the start of an episode": None,
            "shares no state between instances": None,
        },
    ),
    "joins not": (OnlyFromTheStart, {"can join during an episode": "joining at sample 100 raised AssertionError"}),
    "global generators": (answering(lambda s: {HEAT: 20.0} if random.random() + np.random.rand() >= 0.0 else {}),
        {"leaves the global random generators alone": "Python's global generator"}),
}  # fmt: skip


def test_testing_kit__mutants_are_all_that_is_wrong_and_no_check_is_without_one() -> None:
    assert not check_controller(Good).failed
    assert not check_controller(answering(lambda sample: None)).failed, "it keeps all values"
    assert not check_reward(OfMine()).failed
    assert not check_environment(Changed(FakeEnv(1), with_())).failed
    for checks, mutants in (
        (CONTROLLER_CHECKS, CONTROLLER_MUTANTS),
        (REWARD_CHECKS, REWARD_MUTANTS),
        (ENVIRONMENT_CHECKS, ENVIRONMENT_MUTANTS),
    ):
        named = {name for _, faults in mutants.values() for name in faults}
        assert named == set(checks)


@pytest.mark.parametrize("mutant", CONTROLLER_MUTANTS)
def test_testing_kit__bad_controllers_faults_are_named(mutant: str) -> None:
    make, faults = CONTROLLER_MUTANTS[mutant]
    with pytest.raises(ConformanceError) as error:
        check_controller(make)
    report = error.value.report
    errors = {result.name: " ".join(result.errors) for result in report.results if result.errors}
    assert set(errors) == set(faults)
    for name, words in faults.items():
        assert words is None or re.search(words, errors[name]), errors[name]
    if "is created from a manifest" in faults:
        assert len(report.skipped) == len(CONTROLLER_CHECKS) - 1


def test_testing_kit__all_failures_are_one_error_in_plain_words() -> None:
    with pytest.raises(AssertionError) as error:
        check_controller(answering(lambda s: {"heating": 20.0, HEAT: float("inf"), COOL: 40.0}))
    lines = str(error.value).splitlines()
    assert lines[0] == "Answering fails 4 of 13 checks"
    assert "FAILED   names only actuators of the node" in lines
    hint = "for another node than the fake building, pass its manifest"
    assert f"         the node has no actuator 'heating'; {hint}" in lines
    assert f"         {COOL} = 40 at sample 0; its bounds are 22.5 to 30 degC" in lines
    with pytest.raises(InvalidConfig, match="no check 'finite'; did you mean 'values are finite'"):
        check_controller(Good, skip="finite")


class Bound(BoundReward):
    """A good one that remembers: the mean of the power so far, and the degrees above 24."""

    def __init__(self, power: int, zone: int) -> None:
        self.power, self.zone = power, zone
        self.sums: Any = None

    def reset(self, slots: Any = None) -> None:
        if slots is None or self.sums is None:
            self.sums = None
        else:
            self.sums[:, list(slots)] = 0.0

    def __call__(self, values: Any, begin: Any) -> Outcome:
        shape = values.shape[:-1]
        if self.sums is None:
            self.sums = np.zeros((2, *shape))
        self.sums = self.sums + np.stack([values[..., self.power], np.ones(shape)])
        energy = -1e-4 * self.sums[0] / self.sums[1]
        comfort = -np.maximum(values[..., self.zone] - 24.0, 0.0)
        terms = {"energy": self.as_said(energy), "comfort": self.as_said(comfort)}
        return Outcome(self.as_said(energy + comfort), terms, {})

    def as_said(self, value: Any) -> Any:
        return float(value) if np.ndim(value) == 0 else value

    def state(self) -> dict[str, Any]:
        return {} if self.sums is None else {"sums": self.sums.tolist()}

    def restore(self, state: dict[str, Any]) -> None:
        self.sums = np.array(state["sums"]) if state else None


class OfMine:
    """Binds it, or a mutant of it."""

    def __init__(self, kind: type[Bound] = Bound) -> None:
        self.kind = kind

    def bind(self, manifest: Any) -> Any:
        names = manifest.names
        if not {"hvac_and_plant_power", "zone_1_air_temperature"} <= set(names):
            raise InvalidConfig("the power or the first zone is missing")
        return self.kind(names.index("hvac_and_plant_power"), names.index("zone_1_air_temperature"))


class LooksAway(OfMine):
    def bind(self, manifest: Any) -> Any:
        return self.kind(1, 2)


class Trips(OfMine):
    def bind(self, manifest: Any) -> Any:
        return self.kind(manifest.names.index("hvac_and_plant_power"), 2)


def mutant(**methods: Any) -> OfMine:
    return OfMine(type("Mutant", (Bound,), methods))


def changed(change: Callable[[Bound, Any, Any, Outcome], Any]) -> OfMine:
    return mutant(__call__=lambda self, values, begin: change(self, values, begin, Bound.__call__(self, values, begin)))


def only_of_one(self: Bound, values: Any, begin: Any, out: Outcome) -> Outcome:
    if values.ndim == 1:
        return out
    reward = np.full(values.shape[:-1], out.reward[0])
    return Outcome(reward, {"all": reward}, {})


def writes(self: Bound, values: Any, begin: Any, out: Outcome) -> Outcome:
    values[self.power] = 0.0
    return out


def first_only(self: Bound, values: Any, begin: Any, out: Outcome) -> Outcome:
    return out._replace(reward=0.0, terms={}) if values.ndim == 1 and self.sums[1] > 50 else out


SHAPES = "several buildings at once get the same rewards as alone"
ALL_THE_SAME = (
    "resets completely", "the terms add up to the reward", "resets single buildings",
    "continues from a restored state", SHAPES,
)  # fmt: skip
REWARD_MUTANTS: dict[str, tuple[Any, dict[str, Any]]] = {
    "no bind of this node": (mutant(__init__=lambda self, a: None), {"binds to a manifest": "raised TypeError"}),
    "no Outcome": (changed(lambda s, v, b, out: (out.reward, out.terms, {})),
        {"returns an Outcome of floats": "a tuple"}),
    "not the sum": (changed(lambda s, v, b, out: out._replace(terms={"energy": out.reward, "comfort": out.reward})),
        {"the terms add up to the reward": r"at timestep 0 the reward is -[\d.]+, and its terms add up to -"}),
    "not finite": (changed(lambda s, v, b, out: out._replace(metrics={"share": np.float64("nan")})),
        {"all values are finite": "share = nan"}),
    "another each time": (
        changed(lambda s, v, b, out: Outcome(*(2 * (next(numbers),)), {})._replace(terms={})),
        {
            "the same values get the same reward": "bound a second time it returned another reward",
            **dict.fromkeys(ALL_THE_SAME),
        },
    ),
    "never forgets": (
        mutant(reset=lambda self, slots=None: None),
        {
            "resets completely": "after another episode and reset",
            "resets single buildings": "does not get the reward of a new episode",
        },
    ),
    "forgets all": (mutant(reset=lambda self, slots=None: Bound.reset(self)),
        {"resets single buildings": "changed the reward of other buildings"}),
    "writes": (changed(writes), {"changes neither values nor manifest": "modifies its argument values"}),
    "one for all": (changed(only_of_one), {SHAPES: "building 1 of 3 gets", "resets single buildings": None}),
    "other in the end": (
        changed(first_only),
        {SHAPES: "at timestep 50 building 0 of 3 gets .*, but 0 alone", "resets single buildings": None},
    ),
    "no state": (mutant(state=lambda self: {}), {"continues from a restored state": "restored from its state"}),
    "odd state": (mutant(state=lambda self: {"sums": self.sums}),
        {"continues from a restored state": "values other than strings, numbers, lists and dictionaries"}),
    "looks away": (LooksAway(), {"a missing point is an InvalidConfig": "without any point it was bound, but"}),
    "trips": (Trips(), {"a missing point is an InvalidConfig": "ValueError: .*; expected InvalidConfig"}),
}  # fmt: skip


@pytest.mark.parametrize("name", REWARD_MUTANTS)
def test_testing_kit__bad_rewards_faults_are_named(name: str) -> None:
    reward, faults = REWARD_MUTANTS[name]
    with pytest.raises(ConformanceError) as error:
        check_reward(reward)
    errors = {result.name: " ".join(result.errors) for result in error.value.report.results if result.errors}
    assert set(errors) == set(faults), errors
    for check, words in faults.items():
        assert words is None or re.search(words, errors[check]), errors[check]


class Changed(gym.Wrapper[Any, Any, Any, Any]):
    """An environment with a fault."""

    def __init__(self, env: Any, change: Callable[..., Any]) -> None:
        super().__init__(env)
        self.change = change
        self.steps, self.episodes, self.left_at = 0, 0, 0

    def reset(self, *, seed: Any = None, options: Any = None) -> Any:
        self.left_at = self.steps
        self.steps, self.episodes = 0, self.episodes + 1
        observation, info = super().reset(seed=seed, options=options)
        return self.change(self, observation, 0.0, False, False, info)[::4]

    def step(self, action: Any) -> Any:
        self.steps += 1
        return self.change(self, *super().step(action))


def with_(**parts: Callable[..., Any]) -> Callable[..., Any]:
    names = ("observation", "reward", "terminated", "truncated", "info")

    def change(env: Any, *step: Any) -> Any:
        return tuple(parts[n](env, x) if n in parts else x for n, x in zip(names, step, strict=True))

    return change


def renamed(env: Any) -> Any:
    env.observation_names = (*env.unwrapped.observation_names[:-1], "outdoor_temperature")
    return env


class Sloppy(Changed):
    """Makes an action out of anything, and goes on after the end."""

    def step(self, action: Any) -> Any:
        try:
            return super().step(np.nan_to_num(action, nan=22.5))
        except EpisodeChanged:
            super().reset()
            return super().step(action)


ENVIRONMENT_MUTANTS: dict[str, tuple[Any, dict[str, Any]]] = {
    "raises": (with_(reward=lambda env, r: 1 / 0), {"can be reset and stepped": "raised ZeroDivisionError"}),
    "ends early": (
        with_(truncated=lambda env, t: env.steps >= 50),
        {
            "an episode has its N timesteps": "truncated after 50 timesteps; expected 96",
            "a step after the end is rejected": None,
        },
    ),
    "out of space": (
        with_(observation=lambda env, o: o if env.steps != 40 else np.where(np.arange(len(o)) == 1, np.float32(-1), o)),
        {
            "observations are in their space": "sample 40 .*: value 1 is -1, bounds 0 to inf",
            "gymnasium's own checks": None,
        },
    ),
    "no float": (with_(reward=lambda env, r: np.float32(r)),
        {"rewards are finite and equal the sum of their terms": "the reward of step 1 is"}),
    "not the sum": (with_(reward=lambda env, r: r - 1.0),
        {"rewards are finite and equal the sum of their terms": "its reward_terms add up to"}),
    "mute": (
        with_(info=lambda env, i: {k: v for k, v in i.items() if k not in ("effective", "weather")}),
        {
            "info has its keys and counts steps": "the info of reset lacks effective, weather "
            "the info of step lacks effective"
        },
    ),
    "miscounts": (with_(info=lambda env, i: {**i, "step": 2 * i["step"]}),
        {"info has its keys and counts steps": r"counts \[0, 2, 4, 6\]", "an action of NaN is rejected": None}),
    "keeps a trace": (with_(observation=lambda env, o: o + np.float32(env.left_at == 15) * (o > 0)),
        {"a reset during an episode leaves no trace": "affects the next one: the observation of sample 0 differs"}),
    "names": (lambda env, *step: (setattr(env, "observation_names", ("a",)), step)[1],
        {"observations have names": "has 1 names for an observation of shape"}),
    "lax": (with_(),
        {"an action of NaN is rejected": "was accepted", "a step after the end is rejected": "was accepted"}),
    "unseeded": (
        with_(observation=lambda env, o: o + np.float32(1e-3 * env.episodes) * (o > 0)),
        {
            "the same seed results in the same episode": "the observation of sample 0 differs",
            "a reset during an episode leaves no trace": None,
            "gymnasium's own checks": None,
        },
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ENVIRONMENT_MUTANTS)
def test_testing_kit__bad_environments_faults_are_named(name: str) -> None:
    change, faults = ENVIRONMENT_MUTANTS[name]
    with pytest.raises(ConformanceError) as error:
        check_environment((Sloppy if name == "lax" else Changed)(FakeEnv(1), change))
    errors = {result.name: " ".join(result.errors) for result in error.value.report.results if result.errors}
    assert {k for k in faults if faults[k]} <= set(errors) <= set(faults), errors
    for check, words in faults.items():
        assert words is None or re.search(words, errors[check]), errors[check]


def test_testing_kit__name_twice_is_named() -> None:
    with pytest.raises(ConformanceError) as error:
        check_environment(renamed(Changed(FakeEnv(1), with_())))
    assert error.value.report.failed == ("observations have names",)
    assert "observation_names contains a name twice" in str(error.value)


def test_testing_kit__kit_needs_no_pytest() -> None:
    text = "import sys, zenostat.testing as t; t.check_reward('linear'); print('pytest' in sys.modules)"
    done = run_python("-P", "-c", text, check=True)
    assert done.stdout.strip() == "False"
