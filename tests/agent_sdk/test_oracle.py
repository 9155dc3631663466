"""The oracle and its search, on a toy building whose rewards are a formula."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.builders import actuator, manifest, sensor, view
from support.examples import examples

from zenostat.agent_sdk.controllers import Agent, OracleController, action_of, load_controller
from zenostat.agent_sdk.controllers.action_roles import setpoint_pairs
from zenostat.agent_sdk.controllers.agent import values_of
from zenostat.agent_sdk.controllers.base import Controller, Values
from zenostat.agent_sdk.controllers.parameters import ControllerMismatch
from zenostat.agent_sdk.controllers.sequence_search import (
    CategoricalSearch,
    GaussianSearch,
    elite_weights,
    path_integral_weights,
)
from zenostat.topics.errors import InvalidConfig, SimulatorError
from zenostat.topics.messages import DiscreteAction, Manifest, Task

HEAT, COOL = actuator("heating_setpoint", 15.0, 25.0), actuator("cooling_setpoint", 20.0, 30.0)
NODE = manifest(sensors=[sensor("air", key="ROOM")], actuators=[HEAT, COOL])
ROWS = ((15.0, 30.0), (18.0, 28.0), (20.0, 26.0), (22.0, 24.0))
CHOICES = NODE.model_copy(
    update={
        "task": Task(
            actions=NODE.task.actions,
            discrete_actions=(DiscreteAction(actions=("heating_setpoint", "cooling_setpoint"), values=ROWS),),
        )
    }
)


class Middle(Controller):
    """The rule: 20 and 26 degC."""

    def act(self, sample: Any) -> Values:
        return {"heating_setpoint": 20.0, "cooling_setpoint": 26.0}


class Toy:
    """Rewards of each timestep are random coefficients of the setpoints, and depend on nothing else."""

    def __init__(self, node: Manifest, seed: int, fails: bool = False) -> None:
        self.node, self.fails, self.step_number = node, fails, 0
        self.coefficients = np.random.default_rng(seed).normal(size=(node.steps, 2))
        self.action_space = (
            gym.spaces.Discrete(len(ROWS))
            if node.task.discrete_actions
            else gym.spaces.Box(np.float32([15, 20]), np.float32([25, 30]))
        )
        self.plans: list[tuple[Any, Any]] = []
        self.errors: list[list[float]] = []

    def numbers(self, actions: Any) -> Any:
        return np.array(ROWS)[actions] if self.node.task.discrete_actions else np.asarray(actions, float)

    def returns(self, actions: Any) -> Any:
        count = np.asarray(actions).shape[1]
        return (self.numbers(actions) * self.coefficients[self.step_number : self.step_number + count]).sum(axis=2)

    def plan(self, actions: Any, *, forecast_error: Any = ()) -> Any:
        if self.fails:
            raise SimulatorError("it stopped")
        self.errors.append([*forecast_error])
        self.plans.append((np.array(actions), self.returns(actions)))
        return self.plans[-1][1]

    @contextmanager
    def branch(self, *, forecast_error: Any = ()) -> Iterator[Any]:
        self.errors.append([*forecast_error])
        toy = self

        class Branch:
            sample = view(toy.node, step=toy.step_number)

            def step(self, action: Any) -> Any:
                return None, 0.0, False, False, {}

        yield Branch()


def episode(toy: Toy, steps: int, **parameters: Any) -> list[float]:
    """Act for some timesteps; return their rewards."""
    agent = Agent(OracleController(toy.node, rule=Middle, **parameters), toy)
    rewards = []
    for step in range(steps):
        toy.step_number = step
        action = agent.action(view(toy.node, step=step))
        rewards.append(float(toy.returns([[action]])[0, 0]))
    return rewards


@settings(max_examples=examples(30), deadline=None)
@given(
    seed=st.integers(0, 10_000),
    method=st.sampled_from(["mppi", "cem"]),
    node=st.sampled_from([NODE, CHOICES]),
    samples=st.integers(4, 12),
    iterations=st.integers(1, 3),
)
def test_plan__is_never_worse_than_the_rule(
    seed: int, method: str, node: Manifest, samples: int, iterations: int
) -> None:
    """With blocks as long as the horizon, the rewards obtained are those of the chosen plan."""
    toy = Toy(node, seed)
    options = {"horizon": 3.0, "block": 3.0, "samples": samples, "iterations": iterations, "method": method}
    obtained = sum(episode(toy, 12, seed=seed, **options))
    rule = 2 if node is CHOICES else [20.0, 26.0]
    toy.step_number = 0
    expected = float(toy.returns([[rule] * 12]).sum())
    assert obtained >= expected - 1e-9
    assert len(toy.plans) == iterations
    assert all(len(actions) == samples for actions, _ in toy.plans)
    assert obtained == pytest.approx(max(returns.sum(axis=1).max() for _, returns in toy.plans))


def test_search__finds_the_optimum_of_a_linear_reward() -> None:
    """With one block the optimum is at a corner of the bounds."""
    toy = Toy(NODE, 1)
    toy.coefficients[:] = [-1.0, 2.0]
    for method in ("mppi", "cem"):
        obtained = sum(episode(toy, 4, horizon=1.0, method=method, samples=64, iterations=6, spread=0.4))
        assert obtained == pytest.approx(4 * (-15.0 + 2.0 * 30.0), rel=0.02)


@pytest.mark.parametrize(
    ("coefficients", "plan"),
    [
        # Heating and cooling cost in the first hour and pay later: setback, then the rule (optimum start).
        ([[-1.0, 1.0]] * 4 + [[1.0, -1.0]] * 12, [[15.0, 30.0]] * 4 + [[20.0, 26.0]] * 12),
        ([[-1.0, 1.0]] * 8 + [[1.0, -1.0]] * 8, [[15.0, 30.0]] * 8 + [[20.0, 26.0]] * 8),
        ([[-1.0, 1.0]] * 12 + [[1.0, -1.0]] * 4, [[15.0, 30.0]] * 12 + [[20.0, 26.0]] * 4),
        # They pay in the first hour: preheating and precooling.
        ([[1.0, -1.0]] * 4 + [[0.0, 0.0]] * 12, [[21.4, 24.6]] * 4 + [[20.0, 26.0]] * 12),
        # Setpoints a little wider are the optimum: load shedding.
        (None, [[19.3, 26.7]] * 16),
    ],
)
def test_first_iteration__has_setback_optimum_start_preheating_and_load_shedding(
    coefficients: Any, plan: list[list[float]]
) -> None:
    toy = Toy(NODE, 1)
    if coefficients is None:
        toy.numbers = lambda actions: -np.abs(np.asarray(actions, float) - [19.3, 26.7])  # type: ignore[method-assign]
        toy.coefficients[:] = 1.0
    else:
        toy.coefficients[:16] = coefficients
    episode(toy, 1, horizon=4.0, iterations=1, samples=8, spread=0.0)
    actions, returns = toy.plans[0]
    assert len(actions) == 8
    assert np.allclose(actions[returns.sum(axis=1).argmax()], plan)


def relative_node() -> Manifest:
    """The node with offsets of up to 4 K to setpoints of 18 and 28 degC."""
    sensors = (*NODE.sensors, sensor("heating_next"), sensor("cooling_next"))
    actuators = tuple(
        of.model_copy(update={"baseline_sensor": name})
        for of, name in zip(NODE.actuators, ("heating_next", "cooling_next"), strict=True)
    )
    actions = tuple(
        action.model_copy(update={"relative": True, "low": -4.0, "high": 4.0, "unit": "K"})
        for action in NODE.task.actions
    )
    return NODE.model_copy(update={"sensors": sensors, "actuators": actuators, "task": Task(actions=actions)})


def test_first_iteration__has_the_baseline_control_where_actions_are_relative() -> None:
    """Each offset costs, so the baseline control is the best plan, and the rule is not."""
    toy = Toy(relative_node(), 1)
    toy.action_space = gym.spaces.Box(-4.0, 4.0, (2,), np.float32)
    toy.numbers = lambda actions: -np.abs(np.asarray(actions, float))  # type: ignore[method-assign]
    toy.coefficients[:] = 1.0
    for rule in (Middle, "baseline"):
        agent = Agent(OracleController(toy.node, rule=rule, iterations=1, samples=8, horizon=4.0), toy)
        action = agent.action(view(toy.node, heating_next=18.0, cooling_next=28.0))
        actions, _ = toy.plans[-1]
        assert len(actions) == 8
        assert actions[0, 0].tolist() == ([2.0, -2.0] if rule is Middle else [0.0, 0.0])
        assert action.tolist() == [0.0, 0.0]


@pytest.mark.parametrize("count", [1, 2])
def test_first_iteration__has_the_baseline_control_where_a_choice_has_no_offset(count: int) -> None:
    node = relative_node()
    names = [action.name for action in node.task.actions]
    rows: Any = [((-4.0, 4.0), (0.0, 0.0), (4.0, -4.0))] if count == 1 else [((-4.0,), (4.0,), (0.0,))] * 2
    chosen = [names] if count == 1 else [[name] for name in names]
    discrete = tuple(DiscreteAction(actions=tuple(of), values=values) for of, values in zip(chosen, rows, strict=True))
    task = node.task.model_copy(update={"discrete_actions": discrete})
    toy = Toy(node.model_copy(update={"task": task}), 1)
    toy.action_space = gym.spaces.Discrete(3) if count == 1 else gym.spaces.MultiDiscrete([3, 3])  # type: ignore[assignment]
    zero = 1 if count == 1 else [2, 2]
    cost = lambda actions: (np.asarray(actions) != zero).astype(float).reshape(*np.shape(actions)[:2], -1)  # noqa: E731
    toy.numbers = lambda actions: -cost(actions) * np.ones(2)  # type: ignore[method-assign]
    toy.coefficients[:] = 1.0
    for rule in (Middle, "baseline"):
        agent = Agent(OracleController(toy.node, rule=rule, iterations=1, samples=4, horizon=4.0), toy)
        action = agent.action(view(toy.node, heating_next=18.0, cooling_next=28.0))
        assert np.asarray(action).tolist() == zero
    without = task.model_copy(
        update={"discrete_actions": (DiscreteAction(actions=tuple(names), values=((1.0, 1.0),)),)}
    )
    with pytest.raises(InvalidConfig, match="a controller that sets every action"):
        OracleController(node.model_copy(update={"task": without}), rule="baseline")


def test_setpoint_pairs__are_those_that_can_cross() -> None:
    assert setpoint_pairs(NODE) == [(0, 1)]
    apart = manifest(
        sensors=[sensor("air", key="ROOM")],
        actuators=[actuator("heating_setpoint", 15.0, 22.5), actuator("cooling_setpoint", 22.5, 30.0)],
    )
    assert setpoint_pairs(apart) == []


def test_setpoints__never_cross() -> None:
    toy = Toy(NODE, 2)
    toy.coefficients[:] = [5.0, -5.0]
    episode(toy, 8, spread=1.0, samples=32)
    actions = np.concatenate([actions for actions, _ in toy.plans])
    assert (actions[..., 0] <= actions[..., 1]).all()
    assert (actions[..., 0] == actions[..., 1]).any()  # where they would have crossed


def test_forecast_errors__are_the_same_in_all_branches_of_a_plan_and_grow() -> None:
    toy = Toy(NODE, 3)
    episode(toy, 1, horizon=12.0, iterations=2, forecast_error=2.0, seed=5)
    assert len(toy.errors) == 3
    assert toy.errors[0] == toy.errors[1] == toy.errors[2]
    assert len(toy.errors[0]) == 48
    oracle = OracleController(NODE, forecast_error=2.0, seed=1)
    drawn = np.array([oracle._forecast_errors(96) for _ in range(4000)])
    assert drawn[:, -1].std() == pytest.approx(2.0, rel=0.06)  # 24 h ahead
    # An Ornstein-Uhlenbeck process from 0: variance proportional to 1 - exp(-2 t / 12 h).
    ratio = np.sqrt((1.0 - np.exp(-2.0 * 1.0 / 12.0)) / (1.0 - np.exp(-2.0 * 24.0 / 12.0)))
    assert drawn[:, 3].std() == pytest.approx(2.0 * ratio, rel=0.06)
    assert OracleController(NODE)._forecast_errors(96) == []


def test_failed_plan__leaves_the_rule() -> None:
    toy = Toy(NODE, 4, fails=True)
    with pytest.warns(UserWarning, match="follows its rule: it stopped"):
        obtained = episode(toy, 2)
    toy.step_number = 0
    assert obtained == pytest.approx(toy.returns([[[20.0, 26.0]] * 2])[0].tolist())


def test_oracle__needs_a_reward() -> None:
    toy = Toy(NODE, 4)
    toy.reward = None  # type: ignore[attr-defined]
    with pytest.raises(ControllerMismatch, match="the oracle needs a reward"):
        Agent(OracleController(NODE, rule=Middle), toy)


def test_oracle__weights() -> None:
    """MPPI by hand: exp(-1), exp(0) with a temperature of one standard deviation; CEM: the best two of four."""
    weights = path_integral_weights(np.array([0.0, 2.0]), 2.0)  # the standard deviation is 1
    np.testing.assert_allclose(weights, np.array([np.exp(-1.0), 1.0]) / (1.0 + np.exp(-1.0)))
    assert path_integral_weights(np.array([3.0, 3.0]), 0.1).tolist() == [0.5, 0.5]
    assert elite_weights(np.array([1.0, 4.0, 2.0, 3.0]), 0.5).tolist() == [0.0, 0.5, 0.0, 0.5]


def test_gaussian_search__blocks_and_bounds() -> None:
    space = gym.spaces.Box(np.float32([15, 20]), np.float32([25, 30]))
    center = np.tile([20.0, 26.0], (7, 1))
    search = GaussianSearch(
        space, center, block=3, sigma=0.5, adapt=True, repair=lambda _: None, random=np.random.default_rng(0)
    )
    drawn = search.sample(200)
    assert drawn.shape == (200, 7, 2)
    assert drawn.dtype == np.float32
    assert (drawn >= space.low).all()
    assert (drawn <= space.high).all()
    assert (drawn[:, [0, 0, 3, 3]] == drawn[:, [1, 2, 4, 5]]).all()
    assert (drawn[:, 2] != drawn[:, 3]).any()
    np.testing.assert_array_equal(search.center()[0], center.astype(np.float32))
    weights = np.zeros(200)
    weights[3] = 1.0
    search.update(drawn, weights)
    np.testing.assert_allclose(search.center()[0], drawn[3])
    assert np.ptp(search.sample(50), axis=0).max() < 1.0  # the deviation is that of one sample: its least, 1 % of 10 K


def test_oracle__categorical_search() -> None:
    """Without spread only the center is drawn; updates move the probabilities halfway to the samples."""
    center = np.array([[0, 2]] * 4)
    exact = CategoricalSearch([3, 3], center, block=2, spread=0.0, random=np.random.default_rng(0))
    assert (exact.sample(10) == center).all()
    other = np.array([[[1, 2]] * 4])
    for _ in range(2):
        exact.update(other, np.ones(1))
    assert exact.center()[0].tolist() == [[1, 2]] * 4
    drawn = exact.sample(4000)
    assert (drawn[:, 0, 0] == 1).mean() == pytest.approx(0.75, abs=0.03)
    assert (drawn[:, 0] == drawn[:, 1]).all()
    assert (drawn[:, 1] != drawn[:, 2]).any()


def test_values_of__is_the_inverse_of_action_of() -> None:
    assert values_of(NODE, np.float32([18.5, 27.0])) == {"heating_setpoint": 18.5, "cooling_setpoint": 27.0}
    assert values_of(CHOICES, 3) == {"heating_setpoint": 22.0, "cooling_setpoint": 24.0}
    assert action_of(CHOICES, values_of(CHOICES, 3)) == 3


def test_oracle__is_refused_without_an_environment_or_with_wrong_parameters() -> None:
    assert load_controller("oracle") is OracleController
    with pytest.raises(InvalidConfig, match="zenostat evaluate"):
        Agent(OracleController(NODE, rule=Middle))
    for parameters, text in (
        ({"method": "mpc"}, "method = 'mpc'; "),
        ({"rule": "oracle"}, "a controller that sets every action"),
        ({"rule": "baseline"}, "a controller that sets every action"),
        ({"method": 3}, "method = 3; "),
        ({"samples": 3}, "samples = 3"),
        ({"samples": 8.9}, "samples = 8.9; expected a whole number"),
        ({"iterations": 1.5}, "iterations = 1.5; expected a whole number"),
        ({"seed": "x"}, "seed = 'x'"),
        ({"seed": -1}, "seed = -1"),
        ({"seed": 1.5}, "seed = 1.5"),
        ({"horizon": 0.0}, "horizon = 0"),
        ({"forecast_error": -1.0}, "forecast_error = -1"),
    ):
        with pytest.raises(InvalidConfig, match=text):
            OracleController(NODE, **parameters)
    with pytest.raises(InvalidConfig, match="the oracle plans in an environment"):
        OracleController(NODE, rule=Middle).act(view(NODE))
