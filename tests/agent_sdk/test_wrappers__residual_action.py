"""Actions as offsets to what a rule does: zero is the rule, to the bit."""

from __future__ import annotations

import re
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from support.nodes import SMALL

from zenostat import wrappers as w
from zenostat.agent_sdk.controllers import Agent, RuleBasedController
from zenostat.agent_sdk.controllers.fixed import FixedSetpoints
from zenostat.agent_sdk.testing import FakeEnv
from zenostat.topics.errors import InvalidAction, InvalidConfig, UnknownName

STEPS = 40
MARGIN = {"margin": 0.5}
HEATING, COOLING = "zone_1_heating_setpoint", "zone_1_cooling_setpoint"


def rule_rewards(env: gym.Env[Any, Any], seed: int) -> list[float]:
    """Rewards of the rule alone."""
    agent = Agent(RuleBasedController(env.unwrapped.manifest, **MARGIN))
    env.reset(seed=seed)
    return [float(env.step(agent.action(env.unwrapped.sample))[1]) for _ in range(STEPS)]


def test_residual_action__zero_is_the_rule() -> None:
    with FakeEnv() as env:
        expected = rule_rewards(env, 3)
        wrapped = w.ResidualAction(env, "rbc", 1.5, MARGIN)
        wrapped.reset(seed=3)
        zero = np.zeros(wrapped.action_space.shape, np.float32)
        assert [float(wrapped.step(zero)[1]) for _ in range(STEPS)] == expected


def test_residual_action__offsets_are_added_to_the_observed_rule_and_clipped() -> None:
    with FakeEnv() as env:
        low, high = env.action_space.low, env.action_space.high
        wrapped = w.ResidualAction(env, "rbc", 50.0)
        observation, _ = wrapped.reset(seed=0)
        names = [f"rbc_{name}" for name in w.action_names_of(env)]
        assert wrapped.observation_names[-len(names) :] == tuple(names)
        for offset in (0.75, -50.0, 50.0):
            rule = observation[-len(names) :]
            observation, *_ = wrapped.step(np.full(len(names), offset, np.float32))
            effective = env.unwrapped.sample.effective
            index = {a.name: i for i, a in enumerate(env.unwrapped.manifest.actuators)}
            sent = [effective[index[action.actuators[0]]] for action in env.unwrapped.manifest.task.actions]
            np.testing.assert_allclose(sent, np.clip(rule + np.float32(offset), low, high), rtol=1e-6)


def test_residual_action__only_named_actions_have_offsets() -> None:
    with FakeEnv() as env:
        first, *others = w.action_names_of(env)
        wrapped = w.ResidualAction(env, "rbc", {first: 2.0})
        assert wrapped.action_space.high.tolist() == [2.0, *(1.0 for _ in others)]
        wrapped.reset(seed=0)
        *_, first_info = wrapped.step(np.zeros(len(others) + 1, np.float32))
        wrapped.reset(seed=0)
        *_, info = wrapped.step(np.array([0.0, *(1.0 for _ in others)], np.float32))
        assert np.array_equal(info["action"], first_info["action"])


@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        ({"controller": "rcb"}, UnknownName, "there is no rule 'rcb'; did you mean 'rbc'"),
        ({"controller": FixedSetpoints}, InvalidConfig, "controller: the name of a rule (fixed, setback,"),
        ({"parameters": [1.0]}, InvalidConfig, "parameters: {name: value} expected, got [1.0]"),
        ({"controller": "plant.py:Mine"}, UnknownName, "there is no rule 'plant.py:Mine'"),
        ({"offset": 0.0}, InvalidConfig, "expected a number above 0"),
        ({"offset": {"nothing": 1.0}}, UnknownName, "there is no action 'nothing'"),
        ({"parameters": {"marign": 1.0}}, InvalidConfig, "no parameter 'marign'"),
    ],
)
def test_residual_action__bad_arguments_are_refused(
    arguments: dict[str, Any], error: type[Exception], text: str
) -> None:
    with FakeEnv() as env, pytest.raises(error, match=re.escape(text)):
        w.ResidualAction(env, **arguments)


def test_residual_action__action_outside_its_space_is_refused() -> None:
    with FakeEnv() as env:
        wrapped = w.ResidualAction(env, offset=1.0)
        wrapped.reset(seed=0)
        with pytest.raises(InvalidAction, match="ResidualAction: action"):
            wrapped.step(np.full(wrapped.action_space.shape, 1.5, np.float32))


@pytest.mark.parametrize(
    "inner",
    [
        {"wrapper": "RescaleAction", "min_action": -1.0, "max_action": 1.0},
        {"wrapper": "IncrementalAction", "increments": {COOLING: 1.0}, "initial": {COOLING: 26.0}},
        {"wrapper": "DiscreteIncrementalAction", "steps": {COOLING: 1.0}, "initial": {COOLING: 26.0, HEATING: 20.0}},
        {"wrapper": "ResidualAction", "controller": "setback"},
    ],
    ids=lambda inner: inner["wrapper"],
)
def test_residual_action__is_applied_before_wrappers_that_change_units(inner: dict[str, Any]) -> None:
    with FakeEnv(zones=1) as env:
        wrapped = w.apply_wrappers(env, [inner])
        with pytest.raises(InvalidConfig, match=f"ResidualAction .*; apply it before {inner['wrapper']}"):
            w.ResidualAction(wrapped)


@pytest.mark.slow
@pytest.mark.process
def test_residual_action__slots_of_a_vector_equal_single_environments() -> None:
    """Beyond the end of an episode, which the slots reset themselves."""
    entries = [{"wrapper": "ResidualAction", "controller": "rbc", "offset": 1.0, "parameters": MARGIN}]
    arguments = SMALL | {"end": SMALL["begin"]}
    generator = np.random.default_rng(0)
    with gym.make("zenostat/Building-v1", **arguments) as single:
        env = w.apply_wrappers(single, entries)
        steps = env.unwrapped.manifest.steps
        actions = generator.uniform(-1.0, 1.0, (steps + 3, 2, *env.action_space.shape)).astype(np.float32)
        expected = []
        for slot in range(2):
            observations = [env.reset(seed=7 + slot)[0]]
            for row in actions[:steps, slot]:
                observation, _, _, truncated, _ = env.step(row)
                observations.append(observation)
            assert truncated
            expected.append(observations)
    vector = gym.make_vec("zenostat/Building-v1", num_envs=2, autoreset_mode="SameStep", **arguments)
    try:
        envs = w.apply_wrappers(vector, entries)
        observations, _ = envs.reset(seed=7)
        for step in range(steps):
            for slot in range(2):
                np.testing.assert_array_equal(observations[slot], expected[slot][step])
            observations, _, _, _, infos = envs.step(actions[step])
        for slot in range(2):
            np.testing.assert_array_equal(infos["final_obs"][slot], expected[slot][steps])
    finally:
        vector.close()
