"""A `WrapperLogic` around one environment, and around a vector of them."""

from __future__ import annotations

import copy
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
else:
    _VectorWrapper = VectorWrapper  # generic only since Gymnasium 1.4


class _Around(RecordConstructorArgs):
    """What both have: the core, names, state."""

    core: ClassVar[type[WrapperLogic]]
    env: Any
    _core: WrapperLogic
    _seen: Values

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        if "core" in cls.__dict__:
            given = [*inspect.signature(cls.core.__init__).parameters.values()][2:]
            env = inspect.Parameter("env", inspect.Parameter.POSITIONAL_OR_KEYWORD)
            cls.__signature__ = inspect.Signature([env, *given])  # type: ignore[attr-defined]  # what help() shows
            cls.__doc__ = cls.core.__doc__

    def _make(self, env: Any, given: tuple[Any, ...], named: dict[str, Any]) -> None:
        bound = inspect.signature(type(self)).bind(env, *given, **named)
        said = {name: value for name, value in bound.arguments.items() if name != "env"}
        RecordConstructorArgs.__init__(self, _disable_deepcopy=True, **said)
        self._core = self.core(EnvView(env, type(self).__name__), **said)
        if self._core.reward_space is not None:
            self.reward_space = self._core.reward_space
            self.reward_dim = self._core.reward_space.shape[0]
        if self._core.observation_names is not None:
            for base in (env.unwrapped, *(one.unwrapped for one in inside(env.unwrapped))):
                if isinstance(base, SpaceNames):
                    base.add_layer(self)
        wrappers = getattr(env.unwrapped, "wrappers", None)
        if self._core.snapshot_aware and isinstance(wrappers, WeakSet):
            wrappers.add(self)

    @property
    def observation_names(self) -> tuple[str, ...]:
        """Names of the observation's values, as they come out of this wrapper."""
        return self._core.observation_names or names_of(self.env)

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the action's dimensions, as this wrapper takes it."""
        return self._core.action_names or action_names_of(self.env)

    def observation_dict(self, observation: ArrayLike) -> dict[str, float]:
        """The values of one observation of this wrapper by name.

        Raises:
            InvalidConfig: an observation of another shape, as another layer gives it.
        """
        return by_name(self.observation_names, observation, f"{type(self).__name__}.observation_dict")

    def let_go(self) -> None:
        """Closes the wrapper alone; twice is fine."""
        self._core.close()

    def remembered(self) -> tuple[list[dict[str, Any]], Values]:
        """What a snapshot keeps of it: what its core remembers, and the observations that it gave last."""
        return copy.deepcopy(self._core.get_state()), self._seen.copy()

    def _go_back(self, options: Mapping[str, Any] | None) -> None:
        """At a snapshot that was taken with this wrapper around it remembers and gives what it did there."""
        snapshot = (options or {}).get("snapshot")
        if isinstance(snapshot, Snapshot) and self in snapshot.wrapper_states:
            state, seen = snapshot.wrapper_states[self]
            self._core.set_state(state)
            self._seen = seen.copy()

    def get_state(self) -> dict[str, Any]:
        """What the wrapper remembers, as plain values: `{"slots": [...]}`."""
        return {"slots": self._core.get_state()}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Goes on from a `get_state`.

        With another number of slots nothing is taken over: all that ours remember begins anew with an episode.

        Raises:
            InvalidConfig: not a state of this wrapper.
        """
        try:
            if len(state["slots"]) == self._core.view.slots:
                self._core.set_state(state["slots"])
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise InvalidConfig(f"no state of {type(self).__name__}: {type(error).__name__} {error}") from None


class Single(gym.Wrapper[Any, Any, Any, Any], _Around):
    """A core around one environment."""

    def __init__(self, env: gym.Env[Any, Any], *given: Any, **named: Any) -> None:
        self._make(env, given, named)
        gym.Wrapper.__init__(self, env)
        core = self._core
        if core.observation_space is not None:
            self.observation_space = core.observation_space
        if core.action_space is not None:
            self.action_space = core.action_space
        self._seen = np.zeros((1, *_shape(self.observation_space)), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """See `gymnasium.Env.reset`."""
        observation, info = self.env.reset(seed=seed, options=options)
        row = np.asarray(observation)[None]
        seeds = None if seed is None else [seed]
        self._seen = self._core.start(ResetBatch([0], row, Infos(info), seeds))
        self._go_back(options)
        return self._seen[0].copy(), self._told(info)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """See `gymnasium.Env.step`."""
        given = np.asarray(action)[None]
        inner = self._core.act([0], given)
        observation, reward, terminated, truncated, info = self.env.step(action if inner is given else inner[0])
        ends = np.array([terminated or truncated])
        row, rewards = np.asarray(observation)[None], np.array([reward])
        seen, rewards = self._core.step(StepBatch([0], row, rewards, ends, Infos(info), given))
        self._seen = seen
        told = reward if self._core.reward_space is None else rewards[0]
        return seen[0].copy(), told, terminated, truncated, self._told(info)

    def _told(self, info: dict[str, Any]) -> dict[str, Any]:
        if not self._core.added:
            return info
        added = {key: {n: v.item(0) for n, v in rows.items()} for key, rows in self._core.added.items()}
        return {**info, **{key: {**info.get(key, {}), **rows} for key, rows in added.items()}}

    def close(self) -> None:
        """Closes the wrapper and what it wraps; twice is fine."""
        self._core.close()
        self.env.close()


class Vector(_VectorWrapper, _Around):
    """A core around a vector environment, whatever its autoreset mode."""

    def __init__(self, env: VectorEnv[Any, Any, Any], *given: Any, **named: Any) -> None:
        self._make(env, given, named)
        VectorWrapper.__init__(self, env)
        core = self._core
        if core.observation_space is not None:
            self.single_observation_space = core.observation_space
            self.observation_space = batch_space(core.observation_space, self.num_envs)
        if core.action_space is not None:
            self.single_action_space = core.action_space
            self.action_space = batch_space(core.action_space, self.num_envs)
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
            self._put(slots, self._core.start(start))
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
        acted = self._core.act(live, given[live])
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
        width = () if self._core.reward_space is None else self._core.reward_space.shape
        told = np.zeros((self.num_envs, *width), np.float64)
        for slots in ([i for i in live if i not in last], last):
            if not slots:
                continue
            at_end = slots is last
            rows = np.array([infos["final_obs"][i] for i in slots]) if at_end else observations[slots]
            said = infos["final_info"] if at_end else infos
            step = StepBatch(slots, rows, rewards[slots], ends[slots], Infos(said, slots), given[slots])
            seen, told[slots] = self._core.step(step)
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
        for key, rows in self._core.added.items():
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
        self._core.close()
        self.env.close(**more)


def _mask(before: Any, slots: list[int], count: int) -> NDArray[np.bool_]:
    mask = np.zeros(count, np.bool_) if before is None else np.array(before, np.bool_)
    mask[slots] = True
    return mask


def _shape(space: Space[Any]) -> tuple[int, ...]:
    return space.shape or ()
