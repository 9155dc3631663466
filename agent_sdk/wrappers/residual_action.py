"""Wrapper whose actions are offsets to what a rule-based controller does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray
from typing_extensions import override

from zenostat.agent_sdk.controllers.agent import Agent
from zenostat.agent_sdk.controllers.fixed import FixedSetpoints
from zenostat.agent_sdk.controllers.incremental import IncrementalRules
from zenostat.agent_sdk.controllers.parameters import make_controller
from zenostat.agent_sdk.controllers.pid import PIDController
from zenostat.agent_sdk.controllers.rule_based import RuleBasedController
from zenostat.agent_sdk.controllers.setback import ScheduledSetback
from zenostat.agent_sdk.controllers.setpoint_offsets import SetpointOffsets
from zenostat.agent_sdk.wrappers.adapters import BuildingWrapper
from zenostat.agent_sdk.wrappers.base import EnvView, ResetBatch, StepBatch, Values, WrapperLogic, append
from zenostat.agent_sdk.wrappers.incremental import NOT_IN_UNITS
from zenostat.agent_sdk.wrappers.names import reject_wrappers, require_mapping
from zenostat.bridge.client.sample import SampleView
from zenostat.topics.errors import InvalidAction, InvalidConfig, UnknownName, did_you_mean

RULES: dict[str, Any] = {
    "fixed": FixedSetpoints,
    "setback": ScheduledSetback,
    "offsets": SetpointOffsets,
    "rbc": RuleBasedController,
    "incremental": IncrementalRules,
    "pid": PIDController,
}
"""Controllers that `ResidualAction` knows, by name: data, such as a scenario file, never names code of its own."""


class _ResidualLogic(WrapperLogic):
    def __init__(
        self,
        view: EnvView,
        controller: str = "rbc",
        offset: float | Mapping[str, float] = 2.0,
        parameters: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(view)
        own = view.wrapper_name
        not_values = (*NOT_IN_UNITS, "ResidualAction")
        reject_wrappers(view.env, not_values, own + " adds to actions in their units; apply it before {}")
        if not isinstance(controller, str):
            raise InvalidConfig(
                f"{own}: controller: the name of a rule ({', '.join(RULES)}) expected, got {controller!r}"
            )
        require_mapping({} if parameters is None else parameters, f"{own}: parameters", "{name: value}")
        if controller not in RULES:
            raise UnknownName(f"{own}: there is no rule {controller!r}; {did_you_mean(controller, RULES)}")
        if not isinstance(view.action_space, Box) or view.action_space.shape != (len(view.action_names),):
            raise InvalidConfig(f"{own} needs continuous actions, not {view.action_space}")
        self._inner = view.action_space
        limit = _limits(offset, view.action_names, own)
        # An action without an offset has bounds all the same: learners scale actions by the width of their bounds.
        self._has_offset = limit > 0.0
        limit = np.where(self._has_offset, limit, np.float32(1.0))
        self._space = self.action_space = Box(-limit, limit, dtype=np.float32)
        self.action_names = view.action_names
        manifest = view.manifest
        rules = [make_controller(RULES[controller], manifest, parameters or {}) for _ in range(view.slots)]
        self._agents = [Agent(rule) for rule in rules]
        self._rule = np.zeros((view.slots, len(limit)), np.float32)
        self.extend([f"{controller}_{name}" for name in view.action_names], self._inner.low, self._inner.high)

    @override
    def start(self, start: ResetBatch) -> Values:
        self._update(start.slots)
        return append(start.observations, self._rule[start.slots])

    @override
    def step(self, step: StepBatch) -> tuple[Values, Values]:
        # A slot that has reset itself is at its next episode: its last observation keeps the rule's last action.
        live = [slot for slot, is_end in zip(step.slots, step.ends, strict=True) if not is_end]
        self._update(live)
        return append(step.observations, self._rule[step.slots]), step.rewards

    @override
    def act(self, slots: list[int], actions: Values) -> NDArray[np.float32]:
        offsets = np.asarray(actions, np.float32)
        low, high = self._space.low, self._space.high
        if offsets.shape[1:] != low.shape or not ((offsets >= low) & (offsets <= high)).all():
            shown = np.asarray(actions if self.view.vector else actions[0]).tolist()
            raise InvalidAction(f"{self.view.wrapper_name}: action {shown} is not in {self._space}")
        clipped: NDArray[np.float32] = np.clip(
            self._rule[slots] + np.where(self._has_offset, offsets, np.float32(0.0)), self._inner.low, self._inner.high
        )
        return clipped

    def _update(self, slots: Sequence[int]) -> None:
        """Let the rule of each slot act on the slot's sample."""
        for slot in slots:
            self._rule[slot] = self._agents[slot].action(self._sample(slot))

    def _sample(self, slot: int) -> SampleView:
        base = self.view.env.unwrapped
        if self.view.vector and not hasattr(base, "envs"):
            raise InvalidConfig(
                f"{self.view.wrapper_name} cannot read samples of slots in other processes; "
                "wrap each environment instead, in the function that creates it"
            )
        sample: SampleView = (base.envs[slot].unwrapped if self.view.vector else base).sample
        return sample


def _limits(offset: Any, names: Sequence[str], own: str) -> NDArray[np.float32]:
    """Return the largest offset of each action, above 0."""
    by_name = dict(offset) if isinstance(offset, Mapping) else dict.fromkeys(names, offset)
    for name in by_name:
        if name not in names:
            raise UnknownName(f"{own}: there is no action {name!r}; {did_you_mean(name, names)}")
    for name, value in by_name.items():
        is_number = isinstance(value, Real) and not isinstance(value, bool)
        if not is_number or not 0.0 < value < np.inf:
            raise InvalidConfig(f"{own}: offset of {name}: {value!r}; expected a number above 0")
    return np.array([by_name.get(name, 0.0) for name in names], np.float32)


class ResidualAction(BuildingWrapper):
    """Take actions as offsets, in the action's unit, to what a rule-based controller does; 0 is the rule itself.

    Learning the residual of a good rule begins at the rule's reward instead of that of random actions. The rule's
    action for the coming timestep is appended to the observation, as `rbc_heating_setpoint`. The sum of both is
    clipped to the action's bounds.

    Sources: Silver, Allen, Tenenbaum and Kaelbling, "Residual Policy Learning", 2018; Johannink et al., "Residual
    Reinforcement Learning for Robot Control", ICRA 2019.

    After a reset to a snapshot the rule continues with the state that it has, such as observed arrival times.

    Args:
        controller: name of the rule: `rbc`, `fixed`, `setback`, `offsets`, `incremental` or `pid`.
        offset: largest offset to both sides, above 0, for all actions or by action; actions that a mapping does not
            name follow the rule, and their offset, -1 to 1, has no effect.
        parameters: parameters of the rule, such as those that `zenostat tune` has found.

    Raises:
        UnknownName: there is no such rule or action.
        InvalidConfig: the task's actions are discrete, an inner wrapper changes their units, a parameter is invalid, or
            slots run in other processes. `InvalidAction` at a step: the action is not in the space, or the rule
            leaves an absolute action to the building's own control; nothing was simulated.
    """

    logic = _ResidualLogic
