"""Values of an observation by name, at any layer of wrappers."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import DtypeObservation, FrameStackObservation, TimeAwareObservation, TimeLimit

from zenostat import wrappers as w
from zenostat.agent_sdk.testing import FakeEnv
from zenostat.agent_sdk.testing.fake_vector_env import FakeVectorEnv
from zenostat.topics.errors import InvalidConfig

TWO = ["outdoor_temperature", "zone_1_air_temperature"]


def test_named_values__are_right_at_every_layer() -> None:
    base = FakeEnv(zones=1)
    plain = base.reset(seed=0)[0]
    reduced = w.ReducedObservation(base, TWO[::-1])
    observation, _ = reduced.reset(seed=0)
    expected = {name: plain[base.observation_names.index(name)] for name in TWO}
    assert base.observation_dict(observation) == reduced.observation_dict(observation) == expected
    assert base.observation_dict(plain) == dict(zip(base.observation_names, plain.tolist(), strict=True))
    assert w.observation_dict(TimeLimit(reduced, 9), observation) == expected
    stacked = DtypeObservation(FrameStackObservation(reduced, 3), np.float32)
    named = w.observation_dict(stacked, stacked.reset(seed=0)[0])
    assert named[TWO[0]].shape == (3,)
    assert named[TWO[0]][-1] == expected[TWO[0]]


def test_wrappers__vector_names_all_slots_or_one() -> None:
    many = w.ReducedObservation(FakeVectorEnv(2, zones=1), TWO[::-1])
    rows, _ = many.reset(seed=0)
    assert w.observation_dict(many, rows)[TWO[0]].tolist() == rows[:, 1].tolist()
    assert w.observation_dict(many, rows[1])[TWO[0]] == rows[1, 1]
    assert many.unwrapped.observation_dict(rows[1]) == w.observation_dict(many, rows[1])  # type: ignore[attr-defined]


def test_wrappers__order_that_an_array_does_not_tell_is_refused() -> None:
    base = FakeEnv(zones=1)
    plain = base.reset(seed=0)[0]
    turned = w.ReducedObservation(base, base.observation_names[::-1])
    value = turned.observation_dict(turned.reset(seed=0)[0])[TWO[0]]
    assert value == plain[base.observation_names.index(TWO[0])]
    with pytest.raises(
        InvalidConfig, match=r"2 layers of wrappers have .* in different order, .*wrappers\.observation"
    ):
        base.observation_dict(plain)
    assert w.observation_dict(base, plain) == dict(zip(base.observation_names, plain.tolist(), strict=True))


def test_wrappers__observation_of_another_layer_is_refused() -> None:
    later = TimeAwareObservation(TimeLimit(FakeEnv(zones=1), 9))
    observation, _ = later.reset(seed=0)
    with pytest.raises(InvalidConfig, match=r"shape \(\d+,\) expected, got .*wrappers\.observation_dict"):
        later.get_wrapper_attr("observation_dict")(observation)
    assert list(w.observation_dict(later, observation))[-1] == "time"
    with pytest.raises(InvalidConfig, match="has the shape"):
        w.observation_dict(later, observation[:-1])


def test_wrappers__wrapper_without_names_is_refused() -> None:
    class Strange(gym.ObservationWrapper[Any, Any, Any]):
        def observation(self, observation: Any) -> Any:
            return observation[::-1]

    env = Strange(FakeEnv(zones=1))
    with pytest.raises(InvalidConfig, match="after Strange values have no names; give its class `observation_names`"):
        w.observation_dict(env, env.reset(seed=0)[0])
