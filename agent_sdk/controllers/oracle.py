"""Model predictive controller whose model is the building itself."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from zenostat.agent_sdk.controllers.action_roles import Role, bind_actions, setpoint_pairs
from zenostat.agent_sdk.controllers.agent import Agent, values_of
from zenostat.agent_sdk.controllers.base import BaselineController, Controller, ControllerProtocol, Planner, Values
from zenostat.agent_sdk.controllers.loader import load_controller
from zenostat.agent_sdk.controllers.parameters import ControllerMismatch, integer, make_controller, number
from zenostat.agent_sdk.controllers.sequence_search import (
    Actions,
    CategoricalSearch,
    GaussianSearch,
    SequenceSearch,
    elite_weights,
    path_integral_weights,
)
from zenostat.bridge.client.sample import SampleView
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig, SimulatorError, did_you_mean
from zenostat.topics.messages import Manifest
from zenostat.topics.seed_validation import check_seed

METHODS = ("mppi", "cem")
SHIFT_K = 0.7
"""Shift of the rule's setpoints in a plan, K: the default margin of 1 K of `rbc` becomes 0.3 K."""
_LEAD_H = 24.0
"""Lead time of the forecast error's standard deviation."""
_CORRELATION_H = 12.0
"""Time constant with which forecast errors decorrelate."""


class OracleController(Controller):
    """Simulate plans in branches of the running building, and apply the best one until the next plan.

    The reward of a plan is that of the environment, with its state: a demand charge counts from the peak so far. One of
    the plans is what the rule would do, so the chosen plan is never worse than the rule in its horizon. Where actions
    are relative to the baseline control, another one is the baseline control itself; of discrete ones, if each has a
    choice of offsets 0. The branches have the weather and occupancy that follow, so the foresight is perfect, unless
    `forecast_error` disturbs their outdoor temperature.

    For zone setpoints among continuous actions, the first iteration also has the plans that building control knows: the
    widest setpoints for a time, then the rule (setback with optimum start and stop), and the rule with its setpoints
    `SHIFT_K` further apart (load shedding), or twice that closer together in the first block (preheating and
    precooling). The others are drawn at random.

    Args:
        manifest: manifest of the node.
        horizon: prediction horizon, h.
        samples: plans per iteration, at least 4.
        iterations: number of times that the search moves to the best plans so far and draws others.
        method: `mppi` (model predictive path integral) or `cem` (cross-entropy method).
        block: time for which the change of an action is constant, and after which a new plan is made, h.
        spread: initial standard deviation of an action, as a share of its range; for discrete actions the probability
            of another choice.
        temperature: of `mppi`: how much worse plans count, in standard deviations of the returns.
        elite: of `cem`: share of the plans from which the next ones are drawn.
        rule: short name of the controller that the search begins with, or a class.
        forecast_error: standard deviation of the outdoor temperature's error after 24 h, K; it grows from 0 with the
            square root of the lead time at first. 0: perfect foresight.
        seed: seed of the samples and the forecast errors.

    Raises:
        InvalidConfig: an invalid parameter, or an action without bounds.
    """

    def __init__(
        self,
        manifest: Manifest,
        *,
        horizon: float = 6.0,
        samples: int = 16,
        iterations: int = 2,
        method: str = "mppi",
        block: float = 1.0,
        spread: float = 0.2,
        temperature: float = 0.3,
        elite: float = 0.25,
        rule: str | Callable[..., ControllerProtocol] = "rbc",
        forecast_error: float = 0.0,
        seed: int | None = 0,
    ) -> None:
        super().__init__(manifest)
        step_h = manifest.step_h
        self._timesteps = max(1, round(number("horizon", horizon, minimum=step_h) / step_h))
        self._block = max(1, round(number("block", block, minimum=step_h) / step_h))
        self._samples = integer("samples", samples, minimum=4, maximum=256)
        self._iterations = integer("iterations", iterations, minimum=1, maximum=100)
        if method not in METHODS:
            raise InvalidConfig(f"method = {method!r}; {did_you_mean(str(method), METHODS)}")
        self._method = method
        self._spread = number("spread", spread, minimum=0.0, maximum=1.0)
        self._temperature = number("temperature", temperature, minimum=1e-3)
        self._elite = number("elite", elite, minimum=0.0, maximum=1.0)
        self._error_k = number("forecast_error", forecast_error, minimum=0.0)
        self._step_h = step_h
        self._baseline = _baseline_action(manifest)
        self._rule = Agent(self._seed_rule(rule))
        self._pairs = setpoint_pairs(manifest)
        self._directions = _directions(manifest)
        self._seed = None if seed is None else check_seed(seed)
        self._planner: Planner | None = None
        self._begin()

    def _seed_rule(self, rule: str | Callable[..., ControllerProtocol]) -> ControllerProtocol:
        factory = load_controller(rule) if isinstance(rule, str) else rule
        if factory is OracleController or (factory is BaselineController and self._baseline is None):
            raise InvalidConfig(f"rule = {rule!r}; a controller that sets every action is needed, such as 'rbc'")
        return make_controller(factory, self.manifest, {})

    def attach(self, planner: Planner) -> None:
        """Plan in branches of this environment."""
        if not isinstance(planner.action_space, gym.spaces.Box | gym.spaces.Discrete | gym.spaces.MultiDiscrete):
            raise ControllerMismatch(f"the oracle cannot draw actions of {planner.action_space}")
        if getattr(planner, "reward", True) is None:
            raise ControllerMismatch("the oracle needs a reward to compare plans, and the environment has none")
        self._planner = planner

    def begin(self, sample: SampleView) -> None:  # noqa: ARG002
        """Forget the plan of the previous episode, and restart the sequence of samples."""
        self._begin()

    def _begin(self) -> None:
        self._random = np.random.default_rng(self._seed)
        self._plan: Actions | None = None
        self._planned_at = 0

    def act(self, sample: SampleView) -> Values:
        """Return the plan's action for the timestep that begins at `sample.time`; make a new plan if it is due."""
        if self._planner is None:
            raise InvalidConfig("the oracle plans in an environment: use Agent(oracle, env.unwrapped)")
        rule_action = self._rule.action(sample)  # at each sample, since the rule may have a state
        age = sample.step - self._planned_at
        if self._plan is None or not 0 <= age < min(self._block, len(self._plan)):
            timesteps = min(self._timesteps, self.manifest.steps - sample.step)
            self._plan, age = self._make_plan(self._planner, rule_action, timesteps, age), 0
            self._planned_at = sample.step
        return values_of(self.manifest, self._plan[age], sample)

    def _make_plan(self, planner: Planner, rule_action: Any, timesteps: int, age: int) -> Actions:
        """Return the best sequence of actions that was simulated, shape (timesteps, *action shape)."""
        errors = self._forecast_errors(timesteps)
        rule = self._rule_plan(planner, rule_action, timesteps, errors)
        candidates = [rule[None]]
        if self._plan is not None and 0 <= age < len(self._plan):
            continued = np.concatenate([self._plan[age:], rule[len(self._plan) - age :]])
            candidates.append(continued[:timesteps][None])
        center = candidates[-1][0]
        if self._baseline is not None:
            candidates.append(np.broadcast_to(self._baseline.astype(rule.dtype), rule.shape)[None])
        candidates.append(self._known_plans(planner.action_space, rule)[: self._samples - len(candidates)])
        search = self._search(planner.action_space, center)
        best, best_return = rule, -np.inf
        for iteration in range(self._iterations):
            known = candidates if iteration == 0 else [search.center()]
            count = self._samples - sum(map(len, known))
            drawn = [*known, search.sample(count)]
            actions = np.concatenate([part.reshape(len(part), *rule.shape) for part in drawn])
            try:
                returns = planner.plan(actions, forecast_error=errors).sum(axis=1)
            except SimulatorError as error:
                warnings.warn(f"a plan of the oracle failed, and it follows its rule: {error}", stacklevel=2)
                break
            first = int(returns.argmax())  # the rule is the first of equals
            if returns[first] > best_return:
                best, best_return = actions[first], float(returns[first])
            search.update(actions.reshape(*actions.shape[:2], -1), self._weights(returns))
        return best

    def _known_plans(self, space: gym.Space[Any], rule: Actions) -> Actions:
        """Return variants of the rule's plan, shape (variants, timesteps, *action shape); none without setpoints."""
        if not isinstance(space, gym.spaces.Box) or not self._directions.any():
            return np.empty((0, *rule.shape), rule.dtype)
        apart = SHIFT_K * self._directions
        low, high = space.low.astype(rule.dtype), space.high.astype(rule.dtype)
        widest = np.where(self._directions > 0.0, high, np.where(self._directions < 0.0, low, rule))
        blocks = -(-len(rule) // self._block)
        plans = [_switched(widest, rule, self._block * count) for count in sorted({1, blocks // 2, blocks - 1} - {0})]
        plans += [_switched(rule - 2.0 * apart, rule, self._block), rule + apart]
        known: Actions = np.clip(np.stack(plans), low, high).astype(rule.dtype)
        self._repair(known)
        return known

    def _weights(self, returns: Floats) -> Floats:
        if self._method == "cem":
            return elite_weights(returns, self._elite)
        return path_integral_weights(returns, self._temperature)

    def _search(self, space: gym.Space[Any], center: Actions) -> SequenceSearch:
        if isinstance(space, gym.spaces.Box):
            return GaussianSearch(
                space, center, block=self._block, sigma=self._spread, adapt=self._method == "cem",
                repair=self._repair, random=self._random,
            )  # fmt: skip
        choices = [int(space.n)] if isinstance(space, gym.spaces.Discrete) else [int(n) for n in space.nvec]  # type: ignore[attr-defined]
        center = center.reshape(len(center), len(choices))
        return CategoricalSearch(choices, center, block=self._block, spread=self._spread, random=self._random)

    def _repair(self, actions: Actions) -> None:
        """Move setpoints of the same zones apart where heating is above cooling, which stops EnergyPlus."""
        for heating, cooling in self._pairs:
            crossed = actions[..., heating] > actions[..., cooling]
            middle = (actions[..., heating] + actions[..., cooling]) / 2.0
            for index in (heating, cooling):
                actions[..., index] = np.where(crossed, middle, actions[..., index])

    def _rule_plan(self, planner: Planner, first: Any, timesteps: int, errors: list[float]) -> Actions:
        """Return the actions of the rule over the horizon, from a branch that it controls."""
        rule = copy.deepcopy(self._rule, {id(self.manifest): self.manifest})
        actions = [first]
        with planner.branch(forecast_error=errors) as branch:
            for _ in range(timesteps - 1):
                _, _, terminated, truncated, _ = branch.step(actions[-1])
                if terminated or truncated:
                    actions += [actions[-1]] * (timesteps - len(actions))
                    break
                actions.append(rule.action(branch.sample))
        return np.stack(actions)

    def _forecast_errors(self, timesteps: int) -> list[float]:
        """Return the error of the outdoor temperature in each timestep, K: an Ornstein-Uhlenbeck process from 0."""
        if not self._error_k:
            return []
        decay = np.exp(-self._step_h / _CORRELATION_H)
        stationary_k = self._error_k / np.sqrt(1.0 - np.exp(-2.0 * _LEAD_H / _CORRELATION_H))
        drawn = self._random.normal(size=timesteps) * stationary_k * np.sqrt(1.0 - decay**2)
        errors = [0.0]
        for shock in drawn.tolist():
            errors.append(float(errors[-1] * decay + shock))
        return errors[1:]


def _switched(first: Actions, then: Actions, timesteps: int) -> Actions:
    """Return a plan that is the first one for some timesteps, and then the other one."""
    return np.concatenate([first[:timesteps], then[timesteps:]])


def _baseline_action(manifest: Manifest) -> NDArray[Any] | None:
    """Return the action that is the baseline control: all offsets are 0; None if there is none."""
    task = manifest.task
    if not task.actions or not all(action.relative for action in task.actions):
        return None
    if not task.discrete_actions:
        return np.zeros(len(task.actions))
    choices = []
    for discrete in task.discrete_actions:
        zero = [index for index, row in enumerate(discrete.values) if not any(row)]
        if not zero:
            return None
        choices.append(zero[0])
    return np.array(choices if len(choices) > 1 else choices[0])


def _directions(manifest: Manifest) -> Floats:
    """Return the direction in which each action saves energy: 1 for cooling setpoints, -1 for heating, else 0."""
    directions = {Role.COOLING: 1.0, Role.HEATING: -1.0}
    return np.array([directions.get(binding.role, 0.0) for binding in bind_actions(manifest)])
