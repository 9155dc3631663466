"""Actuators that the agent does not have, set by a schedule."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from typing import Any

import numpy as np

from agent_sdk.wrappers.adapters import BuildingWrapper
from agent_sdk.wrappers.base import EnvView, ResetBatch, StepBatch, Values, WrapperLogic
from agent_sdk.wrappers.rng import SlotRandomStreams
from agent_sdk.wrappers.time_table import Table

Context = Mapping[str, float | None]
Schedule = Callable[[datetime, np.random.Generator], Context]


class _Logic(WrapperLogic):
    def __init__(self, view: EnvView, schedule: Mapping[str, Context] | Schedule) -> None:
        super().__init__(view)
        self._table = None if callable(schedule) else Table(schedule, view.who)
        self._schedule = schedule if callable(schedule) else None
        self._randoms = SlotRandomStreams(view.env, view.who, view.slots)
        self._now: dict[int, datetime] = {}
        self._set: list[dict[str, float | None]] = [{} for _ in range(view.slots)]

    def start(self, start: ResetBatch) -> Values:
        """See `WrapperLogic`."""
        self._randoms.seed(start.slots, start.seeds)
        for row, slot in enumerate(start.slots):
            self._now[slot], self._set[slot] = start.infos.time(row), {}
        return start.observations

    def act(self, slots: list[int], actions: Values) -> Values:
        """Says what changes before the timestep is simulated."""
        wanted = [self._wanted(slot) for slot in slots]
        news = [
            {
                name: value
                for name, value in values.items()
                if name not in self._set[slot] or self._set[slot][name] != value
            }
            for slot, values in zip(slots, wanted, strict=True)
        ]
        if any(news):
            self.view.tell(slots, "set_context", news)
        for slot, values in zip(slots, news, strict=True):
            self._set[slot] |= values
        return actions

    def _wanted(self, slot: int) -> Context:
        if self._table is not None:
            return self._table.at(self._now[slot])
        assert self._schedule is not None
        return self._schedule(self._now[slot], self._randoms[slot])

    def step(self, step: StepBatch) -> tuple[Values, Values]:
        """See `WrapperLogic`."""
        for row, slot in enumerate(step.slots):
            self._now[slot] = step.infos.time(row)
        return step.observations, step.rewards

    def get_state(self) -> list[dict[str, Any]]:
        """The random generators; what is set begins anew with an episode."""
        return self._randoms.get_state()

    def set_state(self, slots: Sequence[Mapping[str, Any]]) -> None:
        """See `WrapperLogic`."""
        self._randoms.set_state(slots)


class ChangingContext(BuildingWrapper):
    """Sets actuators that are in no action, each timestep, by the time at which the timestep begins.

    Args:
        schedule: a table of times (`{"07:00": {"occupants": 1.0}, "18:00": {"occupants": 0.0}}`, or with days,
            `"07-01 07:00"`), each entry holding until the next; or a function of the time and of a random generator
            that `reset(seed=)` rules. None for a value releases an actuator. What is not named keeps what it has.

    Raises:
        InvalidConfig: a table that cannot be. `InvalidAction` at a step: an actuator that the node does not have or
            that an action sets, or a value out of bounds.
    """

    logic = _Logic
