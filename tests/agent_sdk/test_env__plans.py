"""Plans: sequences of actions in branches, equal to the bit to steps one by one."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from support.engine_forks import FOUR, make

from zenostat.agent_sdk.controllers import Agent, OracleController
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.agent_sdk.rewards import from_function
from zenostat.topics.errors import EpisodeChanged, InvalidAction, InvalidConfig, RequestRejected
from zenostat.topics.messages import Claim, SimulatePlan


class RunningMean:
    """A reward with a state of its own, written for one building: the mean of the core zone's air so far."""

    def __init__(self) -> None:
        self.total, self.count = 0.0, 0

    def __call__(self, values: Any, begin: Any) -> float:
        self.total, self.count = self.total + float(values["core_zn_air_temperature"]), self.count + 1
        return self.total / self.count

    def state(self) -> dict[str, float]:
        return {"total": self.total, "count": self.count}

    def restore(self, state: dict[str, float]) -> None:
        self.total, self.count = state["total"], int(state["count"])


REWARDS: dict[str, Any] = {
    "linear": "linear",
    "occupied": "occupied",
    "peak": {"kind": "peak", "lambda_peak": 3.0},
    "class with state": from_function(RunningMean),
}


@pytest.fixture(scope="module")
def office(module_scratch: Path) -> Iterator[BuildingEnv]:
    """The small office at 9 o'clock, with a reward that has a state."""
    env = make(
        reward=REWARDS["peak"],
        terminate=[{"points": ["core_zn_air_temperature"], "high": 60.0, "duration_h": 1}],
        **FOUR,
    )
    env.reset(seed=0)
    for action in sequences(env, 1, 36)[0]:
        env.step(action)
    yield env
    env.close()


def sequences(env: BuildingEnv, count: int, timesteps: int, seed: int = 3) -> NDArray[np.float32]:
    space, random = env.action_space, np.random.default_rng(seed)
    return random.uniform(space.low, space.high, (count, timesteps, *space.shape)).astype(np.float32)


def rewards_one_by_one(env: BuildingEnv, actions: NDArray[np.float32]) -> list[list[float]]:
    rewards = []
    for sequence in actions:
        with env.branch() as branch:
            rewards.append([branch.step(action)[1] for action in sequence])
    return rewards


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("kind", REWARDS)
def test_plan__equals_single_branches(kind: str, scratch: Path) -> None:
    env = make(reward=REWARDS[kind], **FOUR)
    try:
        env.reset(seed=0)
        for action in sequences(env, 1, 38)[0]:
            env.step(action)
        actions = sequences(env, 3, 5)
        planned = env.plan(actions)
        assert planned.shape == (3, 5)
        assert planned.tolist() == rewards_one_by_one(env, actions)
        assert len({tuple(row) for row in planned.tolist()}) == 3
    finally:
        env.close()


@pytest.mark.slow
def test_plan__leaves_the_episode_alone(office: BuildingEnv) -> None:
    before = office.sample
    office.plan(sequences(office, 2, 4))
    assert office.sample is before
    with office.branch() as first:
        expected = [first.step(action)[1] for action in sequences(office, 1, 3)[0]]
    office.plan(sequences(office, 2, 4, seed=9))
    assert office.plan(sequences(office, 1, 3))[0].tolist() == expected


@pytest.mark.slow
def test_branch_with_slots__steps_and_plans_are_equal(office: BuildingEnv) -> None:
    """A plan of 6 timesteps, two of 3, and 6 steps of the vector give the same rewards and observations."""
    actions = sequences(office, 3, 6)
    with office.branch(slots=3) as whole, office.branch(slots=3) as halves, office.branch(slots=3) as steps:
        rollout = whole.rollout(actions)
        parts = [halves.rollout(actions[:, :3]), halves.rollout(actions[:, 3:])]
        rows = [steps.step(actions[:, i]) for i in range(6)]
    np.testing.assert_array_equal(rollout.rewards, np.concatenate([part.rewards for part in parts], axis=1))
    np.testing.assert_array_equal(rollout.rewards, np.stack([row[1] for row in rows], axis=1))
    np.testing.assert_array_equal(rollout.observations, np.stack([row[0] for row in rows], axis=1))
    assert rollout.lengths.tolist() == [6, 6, 6]
    assert not rollout.terminated.any()
    assert not rollout.truncated.any()
    np.testing.assert_array_equal(sum(rollout.terms.values()), rollout.rewards)
    assert set(rollout.metrics) == {"energy_kwh", "peak_kw", "power_w", "degrees_outside"}
    assert (np.diff(rollout.metrics["peak_kw"], axis=1) >= 0.0).all()


@pytest.mark.slow
def test_plan__ends_with_the_episode(office: BuildingEnv) -> None:
    left = office.manifest.steps - office.sample.step
    actions = sequences(office, 2, left + 4)
    with office.branch(slots=2) as branch:
        rollout = branch.rollout(actions)
        with pytest.raises(EpisodeChanged, match="over"):
            branch.plan(actions)
    assert rollout.lengths.tolist() == [left, left]
    assert rollout.truncated.all()
    assert (rollout.rewards[:, :left] != 0.0).all()
    assert not rollout.rewards[:, left:].any()
    with office.branch() as single:
        steps = [single.step(action) for action in actions[0, :left]]
    assert steps[-1][3]
    assert rollout.rewards[0, :left].tolist() == [step[1] for step in steps]


def test_plan__writes_expire_as_between_steps(office: BuildingEnv) -> None:
    """A write at a higher priority rules its actuator in a plan until it expires, 2 timesteps later."""
    actions, bus, rewards = sequences(office, 2, 5), office.link.bus, []
    for plans in (True, False, None):
        with office.branch(slots=2) as branch:
            if plans is not None:
                bus.write(branch.manifest.node, "core_zn_cooling_setpoint", 30.0, priority=4, duration_s=1800.0)
            steps = [branch.step(actions[:, i])[1] for i in range(5)] if plans is False else branch.plan(actions).T
            rewards.append(np.stack([*steps], axis=1).tolist())
    assert rewards[0] == rewards[1] != rewards[2]


def test_plan__has_the_faults_of_the_node(office: BuildingEnv) -> None:
    """Noisy sensors are observed as in single steps, and the reward remains that of the fault-free values."""
    actions, bus = sequences(office, 2, 4), office.link.bus
    with office.branch(slots=2) as branch:
        fault_free = branch.rollout(actions)
    noise = {"name": "noise", "kind": "noise", "points": "core_zn_air_temperature", "sigma": 0.5}
    bus.faults("building", {"seed": 1, "faults": [noise]})
    try:
        with office.branch(slots=2) as branch, office.branch(slots=2) as steps:
            rollout = branch.rollout(actions)
            rows = [steps.step(actions[:, i]) for i in range(4)]
    finally:
        bus.faults("building", None)
    np.testing.assert_array_equal(rollout.observations, np.stack([row[0] for row in rows], axis=1))
    assert not np.array_equal(rollout.observations, fault_free.observations)
    np.testing.assert_array_equal(rollout.rewards, fault_free.rewards)


def test_forecast_error__changes_the_outdoor_temperature_alone(office: BuildingEnv) -> None:
    """An error of 0 changes nothing, to the bit and across midnight; others are added in each timestep."""
    column = office.observation_names.index("outdoor_temperature")
    actions, errors = sequences(office, 1, 6), [0.5, 1.0, -2.0, 3.0]
    with (
        office.branch(slots=1) as exact,
        office.branch(slots=1, forecast_error=[0.0]) as zero,
        office.branch(slots=1, forecast_error=errors) as wrong,
    ):
        outcomes = [branch.rollout(actions) for branch in (exact, zero, wrong)]
    np.testing.assert_array_equal(outcomes[0].observations, outcomes[1].observations)
    difference = outcomes[2].observations[0, :, column] - outcomes[0].observations[0, :, column]
    np.testing.assert_allclose(difference, [*errors, 3.0, 3.0], atol=1e-5)
    assert not np.array_equal(outcomes[2].rewards, outcomes[0].rewards)
    with pytest.raises(InvalidConfig, match="forecast_error"):
        office.plan(actions, forecast_error=[float("nan")])
    for bad in (3.0, "warm", [None]):
        with pytest.raises(InvalidConfig, match="a sequence of numbers in K expected"):
            office.plan(actions, forecast_error=bad)  # type: ignore[arg-type]


@pytest.mark.slow
def test_forecast_error__across_midnight(scratch: Path) -> None:
    """Each of the timesteps around midnight has the weather of its own hour, and so has sample 0."""
    env = make(end="07-04", **FOUR)
    try:
        env.reset(seed=0)
        for steps in (0, 92):
            for action in sequences(env, 1, steps)[0] if steps else ():
                env.step(action)
            actions = sequences(env, 1, 8)
            with env.branch(slots=1) as exact, env.branch(slots=1, forecast_error=[0.0]) as zero:
                np.testing.assert_array_equal(exact.rollout(actions).observations, zero.rollout(actions).observations)
    finally:
        env.close()


def test_plan__refuses_actions_before_it_simulates(office: BuildingEnv) -> None:
    actions = sequences(office, 2, 4)
    actions[1, 2, 1] = 99.0
    with office.branch(slots=2) as branch:
        with pytest.raises(InvalidAction, match=r"timestep 2: slot 1: cooling.* = 99; its bounds"):
            branch.plan(actions)
        for wrong in (actions[:1], actions[:, :0], actions[..., :1], actions[0]):
            with pytest.raises(InvalidAction, match="shape"):
                branch.plan(wrong)
        actions[1, 2, 1] = 25.0
        assert branch.plan(actions).shape == (2, 4)
        with pytest.raises(InvalidConfig, match="cannot be reset"):
            branch.reset()
        with pytest.raises(InvalidConfig, match="no snapshots"):
            branch.snapshot()
    with pytest.raises(InvalidAction, match="shape"):
        office.plan(5.0)
    with pytest.raises(InvalidConfig, match="slots = 0"):
        office.branch(slots=0)


def test_plan_request__is_checked(office: BuildingEnv) -> None:
    """The node refuses what it would refuse as a command, names the timestep, and simulates nothing."""
    bus, values = office.link.bus, np.full((2, len(office.manifest.actuators)), 22.5)
    with office.branch(slots=1) as branch:
        node, link = branch.manifest.node, branch.link
        at = {"episode": bus.latest(node).episode, "step": bus.latest(node).step, "timesteps": 2}

        def refused(text: str, on: str = node, name: str = link.name, **fields: Any) -> None:
            request = {"controller": name, "values": values.tobytes(), **at, **fields}
            with pytest.raises(RequestRejected, match=text):
                bus.plan(on, SimulatePlan(**request))
            assert bus.latest(node).step == at["step"]

        refused("only a branch", on="building")
        refused("no required claim", name="stranger")
        refused("it answers episode", step=[0])
        refused(r"values has \d+ bytes", timesteps=3)
        outside = values.copy()
        outside[1, 0] = 99.0
        refused("timestep 1 of the plan: .* = 99; its bounds", values=outside.tobytes())
        bus.pause(node)
        refused("not paused")
        bus.resume(node)
        bus.claim(node, Claim(controller="other", priority=3))
        refused("other has to answer as well")


@pytest.mark.slow
def test_oracle__foresight_is_perfect(office: BuildingEnv) -> None:
    """The rewards of the plan are those that the building gives afterwards, and not below those of the rule."""
    plans: list[Any] = []

    class Recorder:
        action_space = office.action_space

        def plan(self, actions: Any, **options: Any) -> Any:
            rewards = office.plan(actions, **options)
            plans.append((np.array(actions), rewards))
            return rewards

        def branch(self, **options: Any) -> Any:
            return office.branch(**options)

    oracle = OracleController(office.manifest, horizon=1.0, block=1.0, samples=5, iterations=2, seed=4)
    agent = Agent(oracle, Recorder())
    with office.branch() as rule_branch:
        rule = Agent(OracleController(office.manifest)._rule.controller)
        expected = [rule_branch.step(rule.action(sample))[1] for sample in _samples(rule_branch, 4)]
    obtained = [office.step(agent.action(office.sample))[1] for _ in range(4)]
    assert plans[0][1][0].tolist() == expected  # the first plan is what the rule does
    returns = np.concatenate([rewards.sum(axis=1) for _, rewards in plans])
    assert len(plans) == 2
    assert sum(obtained) == pytest.approx(returns.max(), abs=1e-12)
    assert sum(obtained) >= sum(expected)


def _samples(env: BuildingEnv, count: int) -> Iterator[Any]:
    for _ in range(count):
        yield env.sample
