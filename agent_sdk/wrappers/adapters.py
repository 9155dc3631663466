"""Wrappers that run a `WrapperLogic` around a single environment or a vector environment."""

from __future__ import annotations

import copy
import functools
import inspect
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Space
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from gymnasium.wrappers.utils import create_zero_array
from numpy.typing import ArrayLike, NDArray
from typing_extensions import override

from zenostat.agent_sdk.envs.episode_state import ContextProgram
from zenostat.agent_sdk.envs.snapshot import Snapshot
from zenostat.agent_sdk.envs.space_names import SpaceNames, by_name
from zenostat.agent_sdk.envs.wrapper_set import WrapperSet
from zenostat.agent_sdk.wrappers.base import EnvView, Infos, ResetBatch, StepBatch, Values, WrapperLogic
from zenostat.agent_sdk.wrappers.names import (
    action_names_of,
    inside,
    layers,
    names_of,
    reject_wrappers,
    unknown_arguments,
)
from zenostat.topics.errors import InvalidConfig

if TYPE_CHECKING:
    _VectorWrapper = VectorWrapper[Any, Any, Any, Any, Any]
    _EnvOrVectorEnv = Any
else:
    _VectorWrapper = VectorWrapper  # generic only since Gymnasium 1.4
    _EnvOrVectorEnv = object


class BuildingWrapper(RecordConstructorArgs, _EnvOrVectorEnv):  # type: ignore[misc]  # for type checkers it is either
    """Base of the wrappers: a `gymnasium.Wrapper`, or a `gymnasium.vector.VectorWrapper` around a vector environment.

    A subclass names its logic: `class MyWrapper(BuildingWrapper): logic = MyLogic`. Its arguments are `env` and those
    of the logic after `view`.

    Args:
        env: the environment to wrap, single or vector.
        *args: arguments of the logic.
        **kwargs: arguments of the logic.
    """

    logic: ClassVar[type[WrapperLogic]]
    env: Any
    _logic: WrapperLogic
    _last: Values

    def __new__(cls, env: Any = None, *_args: Any, **_kwargs: Any) -> Any:
        """Choose the adapter by the environment; a copy, which has no argument, keeps its own."""
        if issubclass(cls, _SingleAdapter | _VectorAdapter):
            return object.__new__(cls)
        adapter = _VectorAdapter if isinstance(env, VectorEnv) else _SingleAdapter
        return object.__new__(_adapted(cls, adapter))  # type: ignore[arg-type]  # a class is hashable

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if "logic" in cls.__dict__:
            parameters = [*inspect.signature(cls.logic.__init__).parameters.values()][2:]
            env = inspect.Parameter("env", inspect.Parameter.POSITIONAL_OR_KEYWORD)
            cls.__signature__ = inspect.Signature([env, *parameters])  # for help()

    def _build_logic(self, env: Any, args: tuple[Any, ...], kwargs: dict[str, Any]) -> None:
        own, signature = type(self).__name__, inspect.signature(type(self))
        try:
            bound = signature.bind(env, *args, **kwargs)
        except TypeError as error:
            unknown = unknown_arguments(kwargs, [*signature.parameters][1:], own)
            raise InvalidConfig("\n".join(unknown) or f"{own}: {error}") from None
        arguments = {name: value for name, value in bound.arguments.items() if name != "env"}
        RecordConstructorArgs.__init__(self, _disable_deepcopy=True, **arguments)
        reject_wrappers(env, ["NumericInfos"], f"{own} needs infos that NumericInfos leaves out; apply it before {{}}")
        self._logic = self.logic(EnvView(env, own), **arguments)
        if self._logic.reward_space is not None:
            self.reward_space = self._logic.reward_space
            self.reward_dim = self._logic.reward_space.shape[0]
        if self._logic.observation_names is not None:
            for base in (env.unwrapped, *(slot_env.unwrapped for slot_env in inside(env.unwrapped))):
                if isinstance(base, SpaceNames):
                    base.add_layer(self)
        wrappers = getattr(env.unwrapped, "wrappers", None)
        if self._logic.snapshot_aware and isinstance(wrappers, WrapperSet):
            wrappers.add(self)

    @property
    def observation_names(self) -> tuple[str, ...]:
        """Names of the observation's values, as this wrapper returns them."""
        return self._logic.observation_names or names_of(self.env)

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the action's dimensions, as this wrapper takes them."""
        return self._logic.action_names or action_names_of(self.env)

    def observation_dict(self, observation: ArrayLike) -> dict[str, float]:
        """Return the values of one observation of this wrapper by name.

        Raises:
            InvalidConfig: the observation has another shape, such as that of another layer.
        """
        return by_name(self.observation_names, observation, f"{type(self).__name__}.observation_dict")

    @property
    def depth(self) -> int:
        """Number of layers from this one to the unwrapped environment."""
        return sum(1 for _ in layers(self))

    def context_program(self) -> ContextProgram | None:
        """Return what sets the context of a branch in place of this wrapper; None if it does not set any."""
        return self._logic.context_program()

    def release(self) -> None:
        """Close the wrapper but not the environment. Idempotent."""
        self._logic.close()

    def snapshot_state(self) -> tuple[list[dict[str, Any]], Values]:
        """Return what a snapshot keeps of this wrapper: the state of its logic and its last observations."""
        return copy.deepcopy(self._logic.get_state()), self._last.copy()

    def _restore_snapshot(self, options: Mapping[str, Any] | None) -> None:
        """Restore this wrapper's state from the snapshot in `options`, if it was taken with this wrapper."""
        snapshot = (options or {}).get("snapshot")
        if isinstance(snapshot, Snapshot) and self in snapshot.wrapper_states:
            state, observations = snapshot.wrapper_states[self]
            self._logic.set_state(state)
            self._last = observations.copy()

    def get_state(self) -> dict[str, Any]:
        """Return the wrapper's state as plain values: `{"slots": [...]}`."""
        return {"slots": self._logic.get_state()}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Restore a state that `get_state` returned.

        A state of another number of slots is ignored: it concerns running episodes only.

        Raises:
            InvalidConfig: not a state of this wrapper.
        """
        try:
            if len(state["slots"]) == self._logic.view.slots:
                self._logic.set_state(state["slots"])
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise InvalidConfig(f"not a state of {type(self).__name__}: {type(error).__name__} {error}") from None


@functools.cache
def _adapted(wrapper: type[BuildingWrapper], adapter: type[BuildingWrapper]) -> type[BuildingWrapper]:
    """Return a subclass of both under the wrapper's name."""
    attributes = {"__module__": wrapper.__module__, "__qualname__": wrapper.__qualname__, "__doc__": wrapper.__doc__}
    return type(wrapper.__name__, (wrapper, adapter), attributes)


class _SingleAdapter(gym.Wrapper[Any, Any, Any, Any], BuildingWrapper):
    """The logic around a single environment."""

    def __init__(self, env: gym.Env[Any, Any], *args: Any, **kwargs: Any) -> None:
        self._build_logic(env, args, kwargs)
        gym.Wrapper.__init__(self, env)
        logic = self._logic
        if logic.observation_space is not None:
            self.observation_space = logic.observation_space
        if logic.action_space is not None:
            self.action_space = logic.action_space
        self._last = np.zeros((1, *_shape(self.observation_space)), np.float32)

    @override
    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        observation, info = self.env.reset(seed=seed, options=options)
        row = np.asarray(observation)[None]
        seeds = None if seed is None else [seed]
        self._last = self._logic.start(ResetBatch([0], row, Infos(info), seeds))
        self._restore_snapshot(options)
        return self._last[0].copy(), self._logic.convert_infos(self._with_added(info))

    @override
    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        actions = np.asarray(action)[None]
        inner = self._logic.act([0], actions)
        observation, reward, terminated, truncated, info = self.env.step(action if inner is actions else inner[0])
        ends = np.array([terminated or truncated])
        row, rewards = np.asarray(observation)[None], np.array([reward])
        observations, rewards = self._logic.step(StepBatch([0], row, rewards, ends, Infos(info), actions))
        self._last = observations
        # The environment's own reward keeps its type.
        outer_reward = reward if self._logic.reward_space is None else rewards[0]
        infos = self._logic.convert_infos(self._with_added(info))
        return observations[0].copy(), outer_reward, terminated, truncated, infos

    def _with_added(self, info: dict[str, Any]) -> dict[str, Any]:
        if not self._logic.added:
            return info
        added = {key: {n: v.item(0) for n, v in rows.items()} for key, rows in self._logic.added.items()}
        return {**info, **{key: {**info.get(key, {}), **rows} for key, rows in added.items()}}

    @override
    def close(self) -> None:
        try:
            self._logic.close()
        finally:
            self.env.close()


class _VectorAdapter(_VectorWrapper, BuildingWrapper):
    """The logic around a vector environment, in any autoreset mode."""

    def __init__(self, env: VectorEnv[Any, Any, Any], *args: Any, **kwargs: Any) -> None:
        self._build_logic(env, args, kwargs)
        VectorWrapper.__init__(self, env)
        logic = self._logic
        if logic.observation_space is not None:
            self.single_observation_space = logic.observation_space
            self.observation_space = batch_space(logic.observation_space, self.num_envs)
        if logic.action_space is not None:
            self.single_action_space = logic.action_space
            self.action_space = batch_space(logic.action_space, self.num_envs)
        self.autoreset_mode = AutoresetMode(env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP))
        self._done = np.zeros(self.num_envs, np.bool_)
        self._last = np.zeros((self.num_envs, *_shape(self.single_observation_space)), np.float32)

    @override
    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        mask = np.ones(self.num_envs, np.bool_)
        if options and "reset_mask" in options:
            mask, options = np.array(options["reset_mask"], np.bool_), dict(options)  # the environment removes it
        seeds = [seed + i for i in range(self.num_envs)] if isinstance(seed, int | np.integer) else seed
        observations, infos = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]  # as Gymnasium's own
        slots = np.flatnonzero(mask).tolist()
        self._done = self._done & ~mask
        _, infos = self._start(slots, observations, infos, None if seeds is None else [seeds[i] for i in slots])
        self._restore_snapshot(options)
        return self._last.copy(), self._logic.convert_infos(infos)

    def _start(
        self, slots: list[int], observations: Values, infos: dict[str, Any], seeds: Sequence[int | None] | None
    ) -> tuple[Values, dict[str, Any]]:
        present = _present(slots, infos)
        if seeds is not None:
            seeds = [seed for slot, seed in zip(slots, seeds, strict=True) if slot in present]
        if slots := present:
            start = ResetBatch(slots, np.asarray(observations)[slots], Infos(infos, slots), seeds)
            self._store(slots, self._logic.start(start))
            infos = self._with_added(slots, infos)
        return self._last.copy(), infos

    def _store(self, slots: list[int], rows: Values) -> None:
        if self._last.dtype != rows.dtype:
            self._last = self._last.astype(rows.dtype)
        self._last[slots] = rows

    @override
    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        outer = np.asarray(actions)
        resetting = self._done if self.autoreset_mode is AutoresetMode.NEXT_STEP else np.zeros_like(self._done)
        live = np.flatnonzero(~resetting).tolist()
        inner = self._inner_actions(live, outer)
        observations, rewards, terminated, truncated, infos = self.env.step(inner)
        ends = np.asarray(terminated) | np.asarray(truncated)
        rewards = self._step_logic(live, np.array(observations), np.asarray(rewards), ends, infos, outer)
        self._done = ends
        started = np.flatnonzero(ends if self.autoreset_mode is AutoresetMode.SAME_STEP else resetting).tolist()
        last, infos = self._start(started, observations, infos, None)
        return last, rewards, terminated, truncated, self._logic.convert_infos(infos)

    def _inner_actions(self, live: list[int], actions: Values) -> Values:
        """Return the actions for the wrapped environment; slots that reset get zeros, which nobody reads."""
        acted = self._logic.act(live, actions[live])
        inner = np.empty((self.num_envs, *acted.shape[1:]), acted.dtype)
        inner[:] = create_zero_array(self.env.single_action_space)
        inner[live] = acted
        return inner

    def _step_logic(
        self,
        live: list[int],
        observations: Values,
        rewards: Values,
        ends: NDArray[np.bool_],
        infos: dict[str, Any],
        actions: Values,
    ) -> Values:
        """Pass the timestep to the logic: running slots first, then those whose last sample is in the infos.

        A slot whose node is lost keeps its last observation.
        """
        final = np.flatnonzero(ends).tolist() if self.autoreset_mode is AutoresetMode.SAME_STEP else []
        width = rewards.shape[1:] if self._logic.reward_space is None else self._logic.reward_space.shape
        outer_rewards = np.zeros((self.num_envs, *width), np.float64)
        for is_final, all_slots in ((False, [i for i in live if i not in final]), (True, final)):
            step_infos = infos["final_info"] if is_final and all_slots else infos
            slots = _present(all_slots, step_infos)
            for slot in all_slots if is_final else ():
                if slot not in slots:
                    infos["final_obs"][slot] = self._last[slot].copy()
            if not slots:
                continue
            rows = np.array([infos["final_obs"][i] for i in slots]) if is_final else observations[slots]
            step = StepBatch(slots, rows, rewards[slots], ends[slots], Infos(step_infos, slots), actions[slots])
            outer_rows, outer_rewards[slots] = self._logic.step(step)
            if is_final:
                for slot, row in zip(slots, outer_rows, strict=True):
                    infos["final_obs"][slot] = row
                infos["final_info"] = self._with_added(slots, step_infos)
            else:
                self._store(slots, outer_rows)
                infos.update(self._with_added(slots, infos))
        return outer_rewards

    def _with_added(self, slots: list[int], infos: dict[str, Any]) -> dict[str, Any]:
        """Return the infos with the logic's added values for these slots, in Gymnasium's form."""
        merged = dict(infos)
        for key, rows in self._logic.added.items():
            before = merged.get(key, {})
            columns = merged[key] = dict(before)
            mask = merged[f"_{key}"] = _mask(merged.get(f"_{key}"), slots, self.num_envs)
            for name, values in rows.items():
                filled = np.array(before[name]) if name in before else np.zeros(self.num_envs, values.dtype)
                filled[slots] = values
                columns[name], columns[f"_{name}"] = filled, mask.copy()
        return merged

    @override
    def close(self, **kwargs: Any) -> None:
        try:
            self._logic.close()
        finally:
            self.env.close(**kwargs)


def _present(slots: Sequence[int], infos: Mapping[str, Any]) -> list[int]:
    """Return the slots that have a sample: not those of a fleet whose node is lost, whose infos are an error alone."""
    if "error" not in infos:
        return list(slots)
    return [slot for slot in slots if Infos(infos, [slot]).get(0, "error") is None]


def _mask(before: Any, slots: list[int], count: int) -> NDArray[np.bool_]:
    mask = np.zeros(count, np.bool_) if before is None else np.array(before, np.bool_)
    mask[slots] = True
    return mask


def _shape(space: Space[Any]) -> tuple[int, ...]:
    return space.shape or ()
