"""A wrapper that returns the terms of the reward as a vector."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from gymnasium.spaces import Box

from zenostat.agent_sdk.wrappers.adapters import BuildingWrapper
from zenostat.agent_sdk.wrappers.base import EnvView, StepBatch, Values, WrapperLogic
from zenostat.agent_sdk.wrappers.names import indices_of, reject_wrappers, require_each_timestep
from zenostat.topics.errors import InvalidConfig


class _Logic(WrapperLogic):
    def __init__(self, view: EnvView, terms: Sequence[str]) -> None:
        super().__init__(view)
        reject_wrappers(view.env, ["RewardVector"], "the chain already has a {}; it can have only one")
        require_each_timestep(view.env, view.wrapper_name, "remove one of them")
        indices_of(terms, terms, view.wrapper_name, "term")
        if not terms:
            raise InvalidConfig(f"{view.wrapper_name}: terms should be a list of names, such as ['energy', 'comfort']")
        self._terms = list(terms)
        self.reward_space = Box(-np.inf, np.inf, (len(self._terms),), np.float64)

    def step(self, step: StepBatch) -> tuple[Values, Values]:
        rows = [self._row(step.infos.get(row, "reward_terms")) for row in range(len(step.slots))]
        return step.observations, np.array(rows, np.float64)

    def _row(self, terms: dict[str, float] | None) -> list[float]:
        values = terms or {}
        indices_of(self._terms, list(values), self.view.wrapper_name, "reward term")
        return [values[name] for name in self._terms]


class RewardVector(BuildingWrapper):
    """Return the named terms of the reward as a float64 vector, in the given order, instead of their sum.

    `reward_space` and `reward_dim` are as in MO-Gymnasium. The rewards of a vector environment have the shape (slots,
    terms), with zeros where a slot starts an episode. Apply wrappers that need a scalar reward before this one.

    Args:
        terms: names in `info["reward_terms"]`.

    Raises:
        InvalidConfig: there are no terms, one is listed twice, an inner wrapper repeats actions, or (at a step) the
            reward does not have one of them.
    """

    logic = _Logic
