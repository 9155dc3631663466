"""A vector environment as a `VecEnv` of stable-baselines3."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper

from zenostat.agent_sdk.envs.connection import BUSY
from zenostat.agent_sdk.envs.vector_infos import unbatch
from zenostat.agent_sdk.wrappers.names import chain, inside, layers
from zenostat.topics.errors import EpisodeChanged, InvalidConfig, UsageError
from zenostat.topics.extras import requires_extra

with requires_extra("train", "as_sb3", "stable-baselines3"):
    from stable_baselines3.common.vec_env import VecEnv
    from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

_STATISTICS = "episode"


def as_sb3(env: VectorEnv[Any, Any, Any]) -> SlotsVecEnv:
    """Convert a vector environment for the algorithms of stable-baselines3, such as `PPO("MlpPolicy", …)`.

    Args:
        env: Made with `autoreset_mode="SameStep"`, within any vector wrappers.

    Raises:
        InvalidConfig: Another autoreset mode.
    """
    return SlotsVecEnv(env)


class SlotsVecEnv(VecEnv):  # type: ignore[misc,unused-ignore]  # without types where it is not installed
    """Adapter from Gymnasium's vector environments to stable-baselines3's; it behaves like `DummyVecEnv`.

    The info of a slot whose episode has ended has `terminal_observation` and `TimeLimit.truncated`; the info of the
    reset that followed is in `reset_infos`.

    Args:
        env: See `as_sb3`.

    Attributes:
        env: The vector environment.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any]) -> None:
        mode = env.metadata.get("autoreset_mode")
        if mode is not AutoresetMode.SAME_STEP:
            raise InvalidConfig(
                f"stable-baselines3 starts a new episode in the same step, but this environment's autoreset_mode is "
                f"{mode}: make it with autoreset_mode='SameStep'"
            )
        self.env = env
        self._actions: Any = None
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self.metadata = env.metadata

    def reset(self) -> Any:
        """Start an episode in each slot with the seeds of `seed()` and the options of `set_options()`, once."""
        options = self._options[0]
        if any(slot_options != options for slot_options in self._options):
            raise InvalidConfig("options differ between slots; set the same for all")
        seeds = None if all(seed is None for seed in self._seeds) else list(self._seeds)
        self._actions = None
        observations, infos = self.env.reset(seed=seeds, options=options or None)  # type: ignore[arg-type]
        self.reset_infos = self._each(infos)
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: Any) -> None:
        """Store the actions, shape (slots, …); `step_wait` simulates the timestep.

        Raises:
            UsageError: Earlier actions, perhaps of another thread, still wait for `step_wait`.
        """
        if self._actions is not None:
            raise UsageError(f"step_async() was called already, call step_wait() next; or {BUSY}")
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Simulate a timestep; return observations, rewards (float32), dones, and an info for each slot."""
        if self._actions is None:
            raise EpisodeChanged("call step_async() before step_wait()")
        actions, self._actions = self._actions, None
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        slot_infos, dones = self._each(infos), terminated | truncated
        for slot in np.flatnonzero(dones).tolist():
            reset_info = {key: value for key, value in slot_infos[slot].items() if not key.startswith("final_")}
            final_info = unbatch(infos["final_info"], slot)
            if reset_info.pop(_STATISTICS, None) is not None:
                # Gymnasium's vector wrapper puts them beside the final info, in a form of their own.
                final_info[_STATISTICS] = {name: values[slot].item() for name, values in infos[_STATISTICS].items()}
            final_info["terminal_observation"] = infos["final_obs"][slot]
            self.reset_infos[slot], slot_infos[slot] = reset_info, final_info
        for slot, is_truncated in enumerate((truncated & ~terminated).tolist()):
            slot_infos[slot]["TimeLimit.truncated"] = is_truncated
        return observations, np.asarray(rewards, np.float32), dones, slot_infos

    def _each(self, infos: dict[str, Any]) -> list[dict[str, Any]]:
        return [unbatch(infos, slot) for slot in range(self.num_envs)]

    def close(self) -> None:
        """Close the vector environment; idempotent."""
        self.env.close()

    def get_images(self) -> Sequence[Any]:
        """Return a picture of each slot; None without `render_mode="rgb_array"`."""
        return self.env.render() or [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of the outermost wrapper that has it, else of each slot."""
        if attr_name in ("observation_space", "action_space"):
            return [getattr(self, attr_name) for _ in self._get_indices(indices)]
        if attr_name == "get_wrapper_attr":  # Gymnasium's, which wrappers around a vector do not have
            return [lambda name, slot=slot: self.get_attr(name, slot)[0] for slot in self._get_indices(indices)]
        if attr_name == "has_wrapper_attr":
            return [self.has_attr for _ in self._get_indices(indices)]
        if attr_name == "set_wrapper_attr":
            return [partial(self._set_wrapper_attr, indices) for _ in self._get_indices(indices)]
        return [getattr(owner, attr_name) for owner in self._owners(attr_name, indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute where `get_attr` reads it: of a wrapper around the vector, else of each slot.

        Raises:
            InvalidConfig: The attribute of a wrapper around the vector, for some of the slots.
        """
        owners = self._owners(attr_name, indices)
        if len(owners) < self.num_envs and any(isinstance(owner, VectorWrapper) for owner in owners):
            raise InvalidConfig(
                f"{attr_name!r} belongs to {type(owners[0]).__name__}, which is around all slots; set it for all"
            )
        for owner in owners:
            setattr(owner, attr_name, value)

    def _set_wrapper_attr(self, indices: VecEnvIndices, name: str, value: Any, *, force: bool = True) -> bool:
        """Set an attribute as Gymnasium's `set_wrapper_attr`; return whether it was set."""
        can_set = force or self.has_attr(name)
        if can_set:
            self.set_attr(name, value, indices)
        return can_set

    def _owners(self, name: str, indices: VecEnvIndices) -> list[Any]:
        """Return the outermost layer with an attribute, for each slot; the innermost if none has it."""
        for wrapper in chain(self.env):
            if hasattr(wrapper, name) and not hasattr(VectorWrapper, name):
                return [wrapper for _ in self._get_indices(indices)]
        slots = [inside(self.env.unwrapped)[slot] for slot in self._get_indices(indices)]
        return [next((layer for layer in chain(slot) if hasattr(layer, name)), slot.unwrapped) for slot in slots]

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:
        """Call a method of slots and return the results."""
        return [method(*args, **kwargs) for method in self.get_attr(method_name, indices)]

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        """Return whether slots are within such a wrapper; all or none are, because wrappers are around the vector."""
        wrapped = any(isinstance(layer, wrapper_class) for layer in layers(self.env))
        return [wrapped for _ in self._get_indices(indices)]
