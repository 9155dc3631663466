"""Nodes that run elsewhere, one per slot, as a Gymnasium vector environment."""

from __future__ import annotations

import time
import warnings
import weakref
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Literal

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from zenostat.agent_sdk.envs import arguments
from zenostat.agent_sdk.envs.action_values import Actions
from zenostat.agent_sdk.envs.building_env import BuildingEnv, Observation
from zenostat.agent_sdk.envs.connection import BUSY, NOT_STARTED
from zenostat.agent_sdk.envs.fleet_nodes import (
    NODE_ERRORS,
    all_results,
    attempt_all,
    check_compatible,
    combined_error,
    connect_all,
    node_addresses,
)
from zenostat.agent_sdk.envs.slot_access import Seeds, SlotAccess, seeds_of, slots_of
from zenostat.agent_sdk.envs.space_names import SpaceNames
from zenostat.agent_sdk.envs.vector_env import Observations, StepResult, check_mode, check_restart
from zenostat.agent_sdk.envs.vector_infos import Infos
from zenostat.agent_sdk.rewards import AnyReward
from zenostat.bridge.client.connection import build
from zenostat.bridge.client.thread_guard import one_thread
from zenostat.topics.errors import EpisodeChanged, InvalidConfig, ZenostatError
from zenostat.topics.messages import Claim

Result = tuple[Observation, float, bool, bool, Infos]
OnError = Literal["truncate", "raise"]

_ON_ERROR = ("truncate", "raise")
_RETRY_S = 1.0
"""Time between two attempts to start an episode on a node that is lost."""


class FleetVectorEnv(SlotAccess, SpaceNames, VectorEnv[Observations, Any, NDArray[Any]]):
    """Nodes that run elsewhere, one per slot; `gym.make_vec("zenostat/Building-v1", 2, connect=[…], node="office")`.

    A step sends the commands of all slots before it waits for the first sample, so that all nodes simulate at the same
    time; resets also run at the same time. Observations, rewards, episode ends and infos are those of Gymnasium's
    `SyncVectorEnv` over a `BuildingEnv` for each node. Nodes behind the same endpoint, such as a router, share one
    connection.

    If a node is lost, or its simulation fails, its slot is `truncated` with reward 0.0, its latest observation and
    `infos["error"]`, and a warning names the node. The other slots are not affected. With automatic resets the slot
    continues as soon as its node is back on the bus; until then each of its steps is truncated in the same way.

    Args:
        connect: Endpoint of each node, or one endpoint for all.
        node: Name of each node, or one name for all.
        num_envs: Number of nodes, which `gym.make_vec` passes; None: as many as there are.
        autoreset_mode: See `BuildingVectorEnv`.
        on_error: With `truncate`, an error of a node truncates its slot, and an error is raised only if no node is
            left; with `raise`, the error is raised, and names the slots.
        reward, priority, keys: See `BuildingEnv`; the same for all nodes. A reward of your own is called for
            each slot.
        render_mode: None or `rgb_array`.
        node_arguments: None; the nodes have their own settings.

    Attributes:
        manifest: The manifest of the first node.
        addresses: Endpoint and name of each slot's node.
        envs: The environment of each slot, a `BuildingEnv`.

    Raises:
        InvalidConfig: Endpoints and names do not match, a node has several slots, or the nodes' observations or actions
            differ; the text lists all errors.
        NodeNotFound: Nodes that cannot be reached; the text lists all of them.
        RequestRejected: Another controller holds a node's actuators.
    """

    envs: Sequence[BuildingEnv]
    closed = True  # until construction ends, because Gymnasium before 1.4 closes an environment when it is deleted

    def __init__(
        self,
        connect: str | Sequence[str] | None,
        node: str | Sequence[str] | None = None,
        *,
        num_envs: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        on_error: OnError = "truncate",
        reward: AnyReward | None = arguments.FROM_SCENARIO,
        priority: int = 10,
        render_mode: str | None = None,
        keys: str | Path | None = None,
        **node_arguments: Any,
    ) -> None:
        self.addresses = node_addresses(connect, node, num_envs)
        self.num_envs, self.autoreset_mode = len(self.addresses), check_mode(autoreset_mode)
        _check_arguments(node_arguments, on_error, render_mode)
        build(Claim, controller="env", priority=priority)
        self._raises, self.render_mode = on_error == "raise", render_mode
        self._close = ExitStack()
        weakref.finalize(self, self._close.close).atexit = False  # for an environment that is not closed
        with ExitStack() as undo:
            undo.callback(self._close.close)
            connected = connect_all(self.addresses, None if keys is None else Path(keys), self._close)
            self.manifest = connected[0][1]
            check_compatible(self.addresses, [manifest for _, manifest in connected])  # before the first claim

            def make(slot: int) -> BuildingEnv:
                link = connected[slot][0].controller(self.addresses[slot].node, name="env", priority=priority)
                self._close.callback(link.close)
                return BuildingEnv(link=link, reward=reward, render_mode=render_mode)

            self.envs = all_results(make, self.addresses)
            self.manifest = self.envs[0].manifest
            undo.pop_all()
        self._actions = Actions(self.manifest)
        self.metadata = {**BuildingEnv.metadata, "autoreset_mode": self.autoreset_mode}
        self.single_observation_space = self.envs[0].observation_space
        self.single_action_space = self.envs[0].action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._observations = np.zeros(self.observation_space.shape or (), np.float32)
        self._done, self._lost = np.zeros(self.num_envs, np.bool_), np.zeros(self.num_envs, np.bool_)
        self._errors: dict[int, ZenostatError] = {}
        self._failed: set[int] = set()
        self._retry_s = [0.0] * self.num_envs
        self._started = self._busy = False
        self.closed = False

    # Episodes

    @one_thread(BUSY)
    def reset(self, *, seed: Seeds = None, options: dict[str, Any] | None = None) -> tuple[Observations, Infos]:
        """Start an episode in each slot, or in those of `options={"reset_mask": …}`, a bool array of shape (slots,).

        An int seeds slot i with `seed + i`, a list each slot with its own seed. If a node is lost, its slot keeps its
        latest observation, and `infos["error"]` has the reason.

        Raises:
            InvalidConfig: Unknown option, invalid mask or seeds.
            NodeNotFound, NodeLost, SimulatorError: No node is left; at the first reset, or with `on_error="raise"`,
                any node is lost.
            UsageError: Another thread is in `step` or `reset`.
        """
        self._begin_call()
        options = dict(options or {})
        slots = slots_of(options, self.num_envs)
        options.pop("reset_mask", None)
        seeds = seeds_of(seed, slots, self.num_envs) or [None] * len(slots)
        if not self._started and len(slots) < self.num_envs:
            raise EpisodeChanged("call reset() for all slots first")
        if isinstance(seed, int):
            super().reset(seed=seed)
        started = self._start_episodes(slots, dict(zip(slots, seeds, strict=True)), options)
        self._raise_errors()
        self._started = True
        infos: Infos = {}
        for slot in slots:
            infos = self._add_info(infos, started[slot], slot)
        return self._observations.copy(), infos

    def _start_episodes(
        self, slots: Sequence[int], seeds: Mapping[int, int | None] | None = None, options: Infos | None = None
    ) -> dict[int, Infos]:
        """Start episodes in these slots at the same time; update the observations, and return the info of each."""

        def start(slot: int) -> tuple[Observation, Infos]:
            return self.envs[slot].reset(seed=(seeds or {}).get(slot), options=options or None)

        infos = {}
        for slot, result in zip(slots, attempt_all(start, slots), strict=True):
            self._lost[slot] = isinstance(result, ZenostatError)
            if isinstance(result, ZenostatError):
                infos[slot] = self._fail(slot, result)
                self._retry_s[slot] = time.monotonic() + _RETRY_S
            else:
                self._observations[slot], infos[slot] = result
                self._done[slot] = False
                self._errors.pop(slot, None)
        return infos

    def _restart_episodes(self, slots: Sequence[int]) -> dict[int, Infos]:
        """Start episodes as `_start_episodes`, on a lost node only once per `_RETRY_S`."""
        now = time.monotonic()
        due = [slot for slot in slots if not self._lost[slot] or now >= self._retry_s[slot]]
        infos = self._start_episodes(due)
        return infos | {slot: self._error_info(slot) for slot in slots if slot not in infos}

    # Errors

    def _fail(self, slot: int, error: ZenostatError) -> Infos:
        """Note that a slot has no episode any more; return its info."""
        if slot not in self._errors and not self._raises:
            warnings.warn(
                f"{self.addresses[slot].describe(slot)}: {error}; its steps are truncated until an episode starts",
                stacklevel=6,
            )
        self._done[slot], self._errors[slot] = True, error
        self._failed.add(slot)
        return self._error_info(slot)

    def _error_info(self, slot: int) -> Infos:
        return {"error": f"{type(self._errors[slot]).__name__}: {self._errors[slot]}"}

    def _raise_errors(self) -> None:
        """Raise the errors of this call if they cannot be returned as truncations, or if no node is left."""
        raised = self._failed if self._raises or not self._started else set()
        if slots := set(range(self.num_envs)) if self._lost.all() else raised:
            raise combined_error({slot: self._errors[slot] for slot in slots}, self.addresses)

    # Timesteps

    @one_thread(BUSY)
    def step(self, actions: ArrayLike) -> StepResult:
        """Simulate one timestep of each slot; with `NextStep`, slots whose episode has ended start a new one instead.

        Raises:
            InvalidAction: Wrong shape, out of bounds, not finite, or no such choice; nothing was simulated.
            NodeLost, SimulatorError, RequestRejected, EpisodeChanged: With `on_error="raise"`, a node failed; the
                other slots have simulated the timestep. Otherwise no node is left.
            UsageError: Another thread is in `step` or `reset`.
        """
        self._begin_call()
        idle = self._idle_slots()
        self._actions.rows(actions, self.num_envs, idle)  # rejects an invalid action before a command is sent
        results = self._simulate(np.asarray(actions), idle)
        rewards, restarted = np.zeros(self.num_envs), dict[int, Infos]()
        terminated, truncated = np.zeros(self.num_envs, np.bool_), np.zeros(self.num_envs, np.bool_)
        for slot, result in results.items():
            self._observations[slot], rewards[slot], terminated[slot], truncated[slot], _ = result
        self._done = terminated | truncated
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self._done.any():
            restarted = self._restart_episodes(np.flatnonzero(self._done).tolist())
        self._raise_errors()
        infos: Infos = {}
        for slot in range(self.num_envs):
            observation, *_, info = results[slot]
            if slot in restarted:
                infos = self._add_info(infos, {"final_obs": observation, "final_info": info}, slot)
            infos = self._add_info(infos, restarted.get(slot, info), slot)
        return self._observations.copy(), rewards, terminated, truncated, infos

    def _idle_slots(self) -> list[int]:
        """Return the slots that get no command in this step: their episode has ended, or their node is lost."""
        if not self._started:
            raise EpisodeChanged(NOT_STARTED)
        idle: list[int] = np.flatnonzero(self._done).tolist()
        check_restart(self.autoreset_mode, [slot for slot in idle if not self._lost[slot]])
        return idle

    def _simulate(self, actions: NDArray[Any], idle: Sequence[int]) -> dict[int, Result]:
        """Send the commands of all slots but the idle ones, and then wait for the samples; return all results."""
        self._started = False  # if this is interrupted, the slots are at different timesteps: only a reset helps
        errors, sent = dict[int, ZenostatError](), list[int]()
        for slot in range(self.num_envs):
            if slot not in idle:
                try:
                    self.envs[slot].step_async(actions[slot])
                    sent.append(slot)
                except NODE_ERRORS as error:
                    errors[slot] = error
        if self.autoreset_mode is AutoresetMode.NEXT_STEP:  # while the other nodes simulate
            results = {slot: self._idle_result(slot, info) for slot, info in self._restart_episodes(idle).items()}
        else:
            results = {slot: self._idle_result(slot, self._error_info(slot)) for slot in idle}
        for slot in sent:
            try:
                results[slot] = self.envs[slot].step_wait()
            except NODE_ERRORS as error:
                errors[slot] = error
        self._started = True
        return results | {slot: self._idle_result(slot, self._fail(slot, error)) for slot, error in errors.items()}

    def _idle_result(self, slot: int, info: Infos) -> Result:
        return self._observations[slot].copy(), 0.0, False, slot in self._errors, info

    def _begin_call(self) -> None:
        if self.closed:
            raise EpisodeChanged("the environment is closed; make another one")
        self._failed.clear()

    # Access to slots

    def set_context(self, values: Mapping[str, float | None]) -> None:
        """Set actuators that belong to no action in all slots; see `BuildingEnv.set_context`."""
        for env in self.envs:
            env.set_context(values)

    def render(self) -> tuple[Any, ...]:
        """Return the result of `BuildingEnv.render` for each slot."""
        return tuple(env.render() for env in self.envs)

    def close_extras(self, **_: Any) -> None:
        """Disconnect from all nodes, which continue to run."""
        self._close.close()


def _check_arguments(node_arguments: Mapping[str, Any], on_error: str, render_mode: str | None) -> None:
    arguments.check_arguments(node_arguments, BuildingEnv)
    if settings := [name for name, value in node_arguments.items() if value is not None]:
        raise InvalidConfig(f"{', '.join(settings)}: nodes that run elsewhere have their own settings; leave these out")
    if on_error not in _ON_ERROR:
        raise InvalidConfig(f"on_error {on_error!r}; there are: {', '.join(_ON_ERROR)}")
    if render_mode not in (None, "rgb_array"):
        raise InvalidConfig(
            f"render_mode {render_mode!r}; several nodes have 'rgb_array' only. A live view of one node: "
            "zenostat monitor --connect ENDPOINT"
        )
