"""Wrappers that run a `WrapperLogic` around a single environment or a vector environment."""

from __future__ import annotations

import copy
import functools
import inspect
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar
from weakref import WeakSet

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Space
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from gymnasium.wrappers.utils import create_zero_array
from numpy.typing import ArrayLike, NDArray

from agent_sdk.bus.snapshot import Snapshot
from agent_sdk.envs.space_names import SpaceNames, by_name
from agent_sdk.wrappers.base import EnvView, Infos, ResetBatch, StepBatch, Values, WrapperLogic
from agent_sdk.wrappers.names import action_names_of, inside, names_of
from topics.errors import InvalidConfig

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
    _seen: Values

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
        bound = inspect.signature(type(self)).bind(env, *args, **kwargs)
        arguments = {name: value for name, value in bound.arguments.items() if name != "env"}
        RecordConstructorArgs.__init__(self, _disable_deepcopy=True, **arguments)
        self._logic = self.logic(EnvView(env, type(self).__name__), **arguments)
        if self._logic.reward_space is not None:
            self.reward_space = self._logic.reward_space
            self.reward_dim = self._logic.reward_space.shape[0]
        if self._logic.observation_names is not None:
            for base in (env.unwrapped, *(one.unwrapped for one in inside(env.unwrapped))):
                if isinstance(base, SpaceNames):
                    base.add_layer(self)
        wrappers = getattr(env.unwrapped, "wrappers", None)
        if self._logic.snapshot_aware and isinstance(wrappers, WeakSet):
            wrappers.add(self)

    @property
    def observation_names(self) -> tuple[str, ...]:
        """Names of the observation's values, as they come out of this wrapper."""
        return self._logic.observation_names or names_of(self.env)

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the action's dimensions, as this wrapper takes it."""
        return self._logic.action_names or action_names_of(self.env)

    def observation_dict(self, observation: ArrayLike) -> dict[str, float]:
        """The values of one observation of this wrapper by name.

        Raises:
            InvalidConfig: an observation of another shape, as another layer gives it.
        """
        return by_name(self.observation_names, observation, f"{type(self).__name__}.observation_dict")

    def let_go(self) -> None:
        """Closes the wrapper alone; twice is fine."""
        self._logic.close()

    def remembered(self) -> tuple[list[dict[str, Any]], Values]:
        """What a snapshot keeps of it: what its core remembers, and the observations that it gave last."""
        return copy.deepcopy(self._logic.get_state()), self._seen.copy()

    def _go_back(self, options: Mapping[str, Any] | None) -> None:
        """At a snapshot that was taken with this wrapper around it remembers and gives what it did there."""
        snapshot = (options or {}).get("snapshot")
        if isinstance(snapshot, Snapshot) and self in snapshot.wrapper_states:
            state, seen = snapshot.wrapper_states[self]
            self._logic.set_state(state)
            self._seen = seen.copy()

    def get_state(self) -> dict[str, Any]:
        """What the wrapper remembers, as plain values: `{"slots": [...]}`."""
        return {"slots": self._logic.get_state()}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Goes on from a `get_state`.

        With another number of slots nothing is taken over: all that ours remember begins anew with an episode.

        Raises:
            InvalidConfig: not a state of this wrapper.
        """
        try:
            if len(state["slots"]) == self._logic.view.slots:
                self._logic.set_state(state["slots"])
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise InvalidConfig(f"no state of {type(self).__name__}: {type(error).__name__} {error}") from None


@functools.cache
def _adapted(wrapper: type[BuildingWrapper], adapter: type[BuildingWrapper]) -> type[BuildingWrapper]:
    """A subclass of both, under the name of the wrapper."""
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
        self._seen = np.zeros((1, *_shape(self.observation_space)), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """See `gymnasium.Env.reset`."""
        observation, info = self.env.reset(seed=seed, options=options)
        row = np.asarray(observation)[None]
        seeds = None if seed is None else [seed]
        self._seen = self._logic.start(ResetBatch([0], row, Infos(info), seeds))
        self._go_back(options)
        return self._seen[0].copy(), self._told(info)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """See `gymnasium.Env.step`."""
        given = np.asarray(action)[None]
        inner = self._logic.act([0], given)
        observation, reward, terminated, truncated, info = self.env.step(action if inner is given else inner[0])
        ends = np.array([terminated or truncated])
        row, rewards = np.asarray(observation)[None], np.array([reward])
        seen, rewards = self._logic.step(StepBatch([0], row, rewards, ends, Infos(info), given))
        self._seen = seen
        told = reward if self._logic.reward_space is None else rewards[0]
        return seen[0].copy(), told, terminated, truncated, self._told(info)

    def _told(self, info: dict[str, Any]) -> dict[str, Any]:
        if not self._logic.added:
            return info
        added = {key: {n: v.item(0) for n, v in rows.items()} for key, rows in self._logic.added.items()}
        return {**info, **{key: {**info.get(key, {}), **rows} for key, rows in added.items()}}

    def close(self) -> None:
        """Closes the wrapper and what it wraps; twice is fine."""
        self._logic.close()
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
        self._mode = AutoresetMode(env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP))
        self._over = np.zeros(self.num_envs, np.bool_)
        self._seen = np.zeros((self.num_envs, *_shape(self.single_observation_space)), np.float32)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """See `gymnasium.vector.VectorEnv.reset`; `options={"reset_mask": …}` resets some slots."""
        mask = np.ones(self.num_envs, np.bool_)
        if options and "reset_mask" in options:
            mask, options = np.array(options["reset_mask"], np.bool_), dict(options)  # the environment takes it out
        every = [seed + i for i in range(self.num_envs)] if isinstance(seed, int | np.integer) else seed
        observations, infos = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]  # as Gymnasium's own
        slots = np.flatnonzero(mask).tolist()
        self._over = self._over & ~mask
        _, infos = self._start(slots, observations, infos, None if every is None else [every[i] for i in slots])
        self._go_back(options)
        return self._seen.copy(), infos

    def _start(
        self, slots: list[int], observations: Values, infos: dict[str, Any], seeds: Sequence[int | None] | None
    ) -> tuple[Values, dict[str, Any]]:
        if slots:
            start = ResetBatch(slots, np.asarray(observations)[slots], Infos(infos, slots), seeds)
            self._put(slots, self._logic.start(start))
            infos = self._told(slots, infos)
        return self._seen.copy(), infos

    def _put(self, slots: list[int], rows: Values) -> None:
        if self._seen.dtype != rows.dtype:
            self._seen = self._seen.astype(rows.dtype)
        self._seen[slots] = rows

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """See `gymnasium.vector.VectorEnv.step`."""
        given = np.asarray(actions)
        begins = self._over if self._mode is AutoresetMode.NEXT_STEP else np.zeros_like(self._over)
        live = np.flatnonzero(~begins).tolist()
        inner = self._inner(live, given)
        observations, rewards, terminated, truncated, infos = self.env.step(inner)
        ends = np.asarray(terminated) | np.asarray(truncated)
        rewards = self._stepped(live, np.array(observations), np.asarray(rewards), ends, infos, given)
        self._over = ends
        again = np.flatnonzero(ends if self._mode is AutoresetMode.SAME_STEP else begins).tolist()
        seen, infos = self._start(again, observations, infos, None)
        return seen, rewards, terminated, truncated, infos

    def _inner(self, live: list[int], given: Values) -> Values:
        """Actions for the wrapped environment; of slots that begin anew, one that nobody reads."""
        acted = self._logic.act(live, given[live])
        inner = np.empty((self.num_envs, *acted.shape[1:]), acted.dtype)
        inner[:] = create_zero_array(self.env.single_action_space)
        inner[live] = acted
        return inner

    def _stepped(
        self,
        live: list[int],
        observations: Values,
        rewards: Values,
        ends: NDArray[np.bool_],
        infos: dict[str, Any],
        given: Values,
    ) -> Values:
        """Hands the timestep to the core: those that go on, then those whose last sample stands in the infos."""
        last = np.flatnonzero(ends).tolist() if self._mode is AutoresetMode.SAME_STEP else []
        width = () if self._logic.reward_space is None else self._logic.reward_space.shape
        told = np.zeros((self.num_envs, *width), np.float64)
        for slots in ([i for i in live if i not in last], last):
            if not slots:
                continue
            at_end = slots is last
            rows = np.array([infos["final_obs"][i] for i in slots]) if at_end else observations[slots]
            said = infos["final_info"] if at_end else infos
            step = StepBatch(slots, rows, rewards[slots], ends[slots], Infos(said, slots), given[slots])
            seen, told[slots] = self._logic.step(step)
            if at_end:
                for slot, row in zip(slots, seen, strict=True):
                    infos["final_obs"][slot] = row
                infos["final_info"] = self._told(slots, said)
            else:
                self._put(slots, seen)
                infos.update(self._told(slots, infos))
        return told

    def _told(self, slots: list[int], infos: dict[str, Any]) -> dict[str, Any]:
        """The infos with what the core added for these slots, in Gymnasium's form."""
        told = dict(infos)
        for key, rows in self._logic.added.items():
            before = told.get(key, {})
            held = told[key] = dict(before)
            mask = told[f"_{key}"] = _mask(told.get(f"_{key}"), slots, self.num_envs)
            for name, values in rows.items():
                filled = np.array(before[name]) if name in before else np.zeros(self.num_envs, values.dtype)
                filled[slots] = values
                held[name], held[f"_{name}"] = filled, mask.copy()
        return told

    def close(self, **more: Any) -> None:
        """Closes the wrapper and what it wraps; twice is fine."""
        self._logic.close()
        self.env.close(**more)


def _mask(before: Any, slots: list[int], count: int) -> NDArray[np.bool_]:
    mask = np.zeros(count, np.bool_) if before is None else np.array(before, np.bool_)
    mask[slots] = True
    return mask


def _shape(space: Space[Any]) -> tuple[int, ...]:
    return space.shape or ()
