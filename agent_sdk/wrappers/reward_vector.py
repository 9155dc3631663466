"""A reward of several objectives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from gymnasium.spaces import Box

from agent_sdk.wrappers.adapters import BuildingWrapper
from agent_sdk.wrappers.base import EnvView, StepBatch, Values, WrapperLogic
from agent_sdk.wrappers.names import places, refuse_inside
from topics.errors import InvalidConfig


class _Logic(WrapperLogic):
    def __init__(self, view: EnvView, terms: Sequence[str]) -> None:
        super().__init__(view)
        refuse_inside(view.env, ["RewardVector"], "{} stands in the chain already; once is enough")
        if not terms or isinstance(terms, str):
            raise InvalidConfig(f"{view.who}: name the terms, as ['energy', 'comfort']")
        places(terms, terms, view.who, "term")
        self._terms = list(terms)
        self.reward_space = Box(-np.inf, np.inf, (len(self._terms),), np.float64)

    def step(self, step: StepBatch) -> tuple[Values, Values]:
        """See `WrapperLogic`."""
        rows = [self._row(step.infos.get(row, "reward_terms")) for row in range(len(step.slots))]
        return step.observations, np.array(rows, np.float64)

    def _row(self, terms: dict[str, float] | None) -> list[float]:
        found = terms or {}
        places(self._terms, list(found), self.view.who, "reward term")
        return [found[name] for name in self._terms]


class RewardVector(BuildingWrapper):
    """The named terms of the reward as a vector, float64, in the order asked, in place of their sum.

    `reward_space` and `reward_dim` are as MO-Gymnasium has them. A vector environment gives shape (slots, terms),
    zeros where a slot begins an episode. Wrappers that need a number as reward go within.

    Args:
        terms: names in `info["reward_terms"]`.

    Raises:
        InvalidConfig: no terms, one twice, or (at a step) a term that the reward does not have.
    """

    logic = _Logic
