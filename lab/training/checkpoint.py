"""Checkpoints: all that a training needs to continue in a new process as if it had not been interrupted."""

from __future__ import annotations

import io
import os
import pickle
import random
import shutil
import warnings
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from zipfile import ZipFile

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.save_util import load_from_zip_file

from zenostat.agent_sdk.rewards import BoundReward
from zenostat.agent_sdk.wrappers import restore_wrappers, save_wrappers
from zenostat.agent_sdk.wrappers.names import inside, layers
from zenostat.lab.training.environments import TrainingEnv, simulated_state
from zenostat.lab.training.episode_recorder import RunningEpisodes, repeat
from zenostat.topics.errors import InvalidConfig

MODEL, NORMALIZATION, WRAPPERS, STATE, REPLAY = (
    "model.zip", "model.vecnormalize.pkl", "model.wrappers.yaml", "state.pkl", "replay.npz",
)  # fmt: skip
_PREFIX = "step-"
_KEPT = 2
_ATTRIBUTES = (
    "num_timesteps", "_current_progress_remaining", "_episode_num", "_last_episode_starts", "_last_lstm_states",
    "_last_obs", "_last_original_obs", "_n_calls", "_n_updates", "action_noise", "ep_info_buffer",
    "ep_success_buffer", "exploration_rate",
)  # fmt: skip
"""Attributes of the algorithms that change during a training, beside weights and optimizers."""
_ROWS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


@dataclass
class Checkpoint:
    """The state of a training between two rollouts.

    Attributes:
        step: number of training steps.
        model: the model's file as `model.save` writes it: weights and optimizers.
        normalization: the pickled `VecNormalize`; b"" without one.
        wrappers: what the wrappers have learnt, as `save_wrappers` writes it; "" without any.
        state: attributes of the algorithm, random states, running episodes, and counters of callbacks.
        replay: arrays of the replay buffer; empty without one.
    """

    step: int
    model: bytes
    normalization: bytes
    wrappers: str
    state: dict[str, Any]
    replay: dict[str, NDArray[Any]] = field(default_factory=dict)

    def write(self, folder: Path) -> Path:
        """Write the checkpoint as a folder below `folder`, atomically, and remove all but the last two.

        Returns:
            The path.
        """
        folder.mkdir(parents=True, exist_ok=True)
        path, temporary = folder / f"{_PREFIX}{self.step:012d}", folder / ".new"
        shutil.rmtree(temporary, ignore_errors=True)  # of a process that was killed
        temporary.mkdir()
        try:
            (temporary / MODEL).write_bytes(self.model)
            if self.normalization:
                (temporary / NORMALIZATION).write_bytes(self.normalization)
            if self.wrappers:
                (temporary / WRAPPERS).write_text(self.wrappers, encoding="utf-8")
            (temporary / STATE).write_bytes(pickle.dumps(self.state))
            if self.replay:
                np.savez(temporary / REPLAY, **self.replay)  # type: ignore[arg-type]
            for written in (*temporary.iterdir(), temporary):
                _sync(written)
            shutil.rmtree(path, ignore_errors=True)  # of the same step: a training that was resumed at its end
            temporary.rename(path)
            _sync(folder)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
        for old in checkpoints(folder)[:-_KEPT]:
            shutil.rmtree(old, ignore_errors=True)
        return path


def _sync(path: Path) -> None:
    """Wait until a file or the names in a folder are on the disk, so that a power failure leaves no part of them."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def checkpoints(folder: Path) -> list[Path]:
    """Return the checkpoints in a folder, oldest first."""
    return sorted(path for path in folder.glob(f"{_PREFIX}*") if path.is_dir())


def last_checkpoint(folder: Path) -> Checkpoint | None:
    """Return the last checkpoint in a folder that can be read, and remove damaged ones after it, with a warning.

    Returns:
        None if there is none.

    Raises:
        InvalidConfig: none of them can be read.
    """
    damaged: list[tuple[Path, InvalidConfig]] = []
    for path in reversed(checkpoints(folder)):
        try:
            checkpoint = read_checkpoint(path)
        except InvalidConfig as error:
            damaged.append((path, error))
            continue
        for unreadable, reason in damaged:
            text = f"{reason}; it is removed, and the training goes on at step {checkpoint.step:,}"
            warnings.warn(text, stacklevel=2)
            shutil.rmtree(unreadable, ignore_errors=True)
        return checkpoint
    if damaged:
        raise InvalidConfig(f"{damaged[0][1]}; {folder} has no other one that can be read: begin a new training")
    return None


def read_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint.

    Raises:
        InvalidConfig: a file is missing or damaged.
    """
    try:
        normalization, wrappers = path / NORMALIZATION, path / WRAPPERS
        with ZipFile(path / MODEL) as model:
            if (damaged := model.testzip()) is not None:
                raise InvalidConfig(f"{MODEL}: {damaged} is damaged")
        state = pickle.loads((path / STATE).read_bytes())  # noqa: S301  # pickled, as is the model beside it
        replay: dict[str, NDArray[Any]] = {}
        if (path / REPLAY).exists():
            with np.load(path / REPLAY) as arrays:
                replay = dict(arrays)
        return Checkpoint(
            int(path.name.removeprefix(_PREFIX)),
            (path / MODEL).read_bytes(),
            normalization.read_bytes() if normalization.exists() else b"",
            wrappers.read_text(encoding="utf-8") if wrappers.exists() else "",
            state,
            replay,
        )
    except Exception as error:
        raise InvalidConfig(f"{path} is not a checkpoint: {type(error).__name__}: {error}") from error


def capture(model: BaseAlgorithm, env: TrainingEnv, counters: Mapping[str, Any], *, replay: bool = True) -> Checkpoint:
    """Return the state of a training, between two rollouts.

    Args:
        model: the algorithm.
        env: its environment.
        counters: state of the training's callbacks.
        replay: whether to copy the replay buffer.
    """
    file = io.BytesIO()
    model.save(file)
    state = {
        "attributes": {name: getattr(model, name) for name in _ATTRIBUTES if hasattr(model, name)},
        "exploration": _exploration(model),
        "random": _random_states(model, env),
        "episodes": env.recorder.running(),
        "simulated": simulated_state(env.env),
        "returns": None if env.normalization is None else env.normalization.returns,
        "counters": dict(counters),
        "reference_wrappers": [wrapper_state(each) for each in env.both[1:]],
        "monitor": [env.monitor.episode_returns, env.monitor.episode_lengths],
        "memories": [[getattr(*each) for each in _memories(env)] for env in env.both],
        "rewards": [_reward_state(each) for each in env.both],
    }
    buffer = getattr(model, "replay_buffer", None)
    return Checkpoint(
        model.num_timesteps,
        file.getvalue(),
        b"" if env.normalization is None else pickle.dumps(env.normalization),
        wrapper_state(env.env),
        deepcopy(state),
        _rows(buffer) if replay and isinstance(buffer, ReplayBuffer) else {},
    )


def restore_environment(checkpoint: Checkpoint, env: TrainingEnv, seed: int) -> None:
    """Bring a new environment to where the episodes of the checkpoint were.

    Raises:
        InvalidConfig: repeating the actions leads elsewhere, because model, weather files or engine have changed.
    """
    episodes: RunningEpisodes = checkpoint.state["episodes"]
    repeat(env.monitor, env.recorder, env.stepped, seed, episodes)
    if simulated_state(env.env) != checkpoint.state["simulated"]:
        raise InvalidConfig(
            f"the simulation differs from that of the checkpoint at step {checkpoint.step}: the building, its weather "
            "files or EnergyPlus have changed since; begin a new training"
        )
    # A reference has had other actions than the environment, so its wrappers have states of their own.
    texts = [checkpoint.wrappers, *checkpoint.state.get("reference_wrappers", ())]
    for each, text in zip(env.both, texts, strict=False):
        if text:
            with TemporaryDirectory(prefix="zenostat-") as folder:
                path = Path(folder) / WRAPPERS
                path.write_text(text, encoding="utf-8")
                restore_wrappers(each, path)
    _restore_memories(checkpoint.state, env)
    if env.normalization is not None:
        saved = pickle.loads(checkpoint.normalization)  # noqa: S301  # pickled, as is the model beside it
        for name, value in saved.__dict__.items():
            if name in ("obs_rms", "ret_rms", "old_obs", "old_reward"):
                setattr(env.normalization, name, value)
        env.normalization.returns = checkpoint.state["returns"]


def _restore_memories(state: Mapping[str, Any], env: TrainingEnv) -> None:
    """Restore what depends on earlier episodes, and was not repeated with the running ones.

    Those have been repeated with the maxima of a reward, the statistics and the random numbers of a new environment.
    """
    if "memories" not in state:  # a checkpoint of an earlier release
        return
    env.monitor.episode_returns, env.monitor.episode_lengths = deepcopy(state["monitor"])
    for each, values, reward in zip(env.both, state["memories"], state["rewards"], strict=True):
        for (layer, name), value in zip(_memories(each), values, strict=True):
            present = getattr(layer, name)
            if isinstance(present, deque):
                present.clear()
                present.extend(deepcopy(value))
            else:
                setattr(layer, name, deepcopy(value))
        if reward is not None and (bound := _reward(each)) is not None:
            bound.restore(reward)


_MEMORIES = {
    "DelayObservation": ("observation_queue",),
    "FrameStackObservation": ("obs_queue", "stacked_obs"),
    "RecordEpisodeStatistics": ("episode_returns",),
}
"""Attributes of Gymnasium's wrappers with what they have observed in the running episode."""


def _memories(env: Any) -> Iterator[tuple[Any, str]]:
    """Yield each layer of an environment with such an attribute, and its name."""
    for place in inside(env.unwrapped) or [env]:
        for layer in layers(place):
            if type(layer).__module__.startswith("gymnasium."):
                for name in _MEMORIES.get(type(layer).__name__, ()):
                    if hasattr(layer, name):
                        yield layer, name


def _reward(env: Any) -> BoundReward | None:
    """Return the bound reward of a building's environment; None if it has none."""
    reward = getattr(getattr(env.unwrapped, "_state", None), "reward", None)
    return reward if isinstance(reward, BoundReward) else None


def _reward_state(env: Any) -> dict[str, Any] | None:
    """Return the state of the reward; None without any, or if that of a reward of the user's cannot be copied."""
    reward = _reward(env)
    if reward is None:
        return None
    try:
        state = reward.state()
        pickle.dumps(state)
    except Exception:  # of code of the user's; the state is that of a new episode then
        return None
    return state


def restore_model(checkpoint: Checkpoint, model: BaseAlgorithm) -> None:
    """Give a newly constructed algorithm the weights, optimizers, replay buffer and counters of a checkpoint."""
    _, parameters, variables = load_from_zip_file(io.BytesIO(checkpoint.model), device=model.device)
    model.set_parameters(parameters, exact_match=True, device=model.device)
    with torch.no_grad():
        for name, value in (variables or {}).items():
            getattr(model, name).copy_(value)
    for name, value in checkpoint.state["attributes"].items():
        setattr(model, name, value)
    restore_action_noise(checkpoint, model)
    buffer = getattr(model, "replay_buffer", None)
    if isinstance(buffer, ReplayBuffer):
        _fill(buffer, checkpoint.replay)


def restore_action_noise(checkpoint: Checkpoint, model: BaseAlgorithm) -> None:
    """Restore the action noise, which `learn` resets at its beginning."""
    if "action_noise" in checkpoint.state["attributes"]:
        setattr(model, "action_noise", deepcopy(checkpoint.state["attributes"]["action_noise"]))  # noqa: B010


def restore_random_states(checkpoint: Checkpoint, model: BaseAlgorithm, env: TrainingEnv) -> None:
    """Restore the random states of Python, NumPy, torch, the action space and the environment."""
    state = checkpoint.state["random"]
    random.setstate(state["python"])
    np.random.set_state(state["numpy"])
    torch.set_rng_state(state["torch"])
    if state["cuda"] and torch.cuda.is_available():
        torch.cuda.set_rng_state_all(state["cuda"])
    model.action_space.np_random.bit_generator.state = state["actions"]
    if state["env"] is not None:
        for each in env.both:
            each.unwrapped.np_random.bit_generator.state = state["env"]
    for distribution, matrices in zip(_distributions(model), checkpoint.state["exploration"], strict=True):
        distribution.exploration_mat, distribution.exploration_matrices = matrices


def wrapper_state(env: Any) -> str:
    """Return the wrappers of an environment and what they have learnt as YAML; "" without any."""
    with TemporaryDirectory(prefix="zenostat-") as folder:
        path = Path(folder) / WRAPPERS
        save_wrappers(env, path)
        text = path.read_text(encoding="utf-8")
    return "" if text.strip() == "wrappers: []" else text


def _random_states(model: BaseAlgorithm, env: TrainingEnv) -> dict[str, Any]:
    base = None
    with suppress(AttributeError):
        base = env.env.unwrapped.np_random.bit_generator.state
    return {
        "python": random.getstate(),
        "numpy": np.random.get_state(),
        "torch": torch.get_rng_state(),
        "cuda": torch.cuda.get_rng_state_all() if torch.cuda.is_available() else [],
        "actions": model.action_space.np_random.bit_generator.state,
        "env": base,
    }


def _distributions(model: BaseAlgorithm) -> list[Any]:
    """Return the distributions with state-dependent exploration, which are not part of the weights."""
    policies = [model.policy, getattr(model.policy, "actor", None)]
    found_in = [getattr(policy, "action_dist", None) for policy in policies]
    return [distribution for distribution in found_in if hasattr(distribution, "exploration_mat")]


def _exploration(model: BaseAlgorithm) -> list[Any]:
    return [(d.exploration_mat.detach(), d.exploration_matrices.detach()) for d in _distributions(model)]


def _rows(buffer: ReplayBuffer) -> dict[str, NDArray[Any]]:
    """Return the filled rows of a replay buffer, and its position."""
    size = buffer.size()
    arrays = {name: getattr(buffer, name)[:size] for name in _ROWS if getattr(buffer, name, None) is not None}
    return {**arrays, "position": np.array([buffer.pos, buffer.full])}


def _fill(buffer: ReplayBuffer, rows: Mapping[str, NDArray[Any]]) -> None:
    for name, values in rows.items():
        if name != "position":
            getattr(buffer, name)[: len(values)] = values
    position, is_full = rows["position"].tolist()
    buffer.pos, buffer.full = int(position), bool(is_full)
