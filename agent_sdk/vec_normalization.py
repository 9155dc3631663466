"""The normalization of observations that a model of stable-baselines3 was trained behind."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np

from zenostat.agent_sdk.controllers.training_folder import normalization_path
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.extras import requires_extra

with requires_extra("train", "training", "stable-baselines3"):
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.vec_env import VecNormalize

_MARK = "observations_normalized"
_SCALED = 10.0
"""The bound at which `VecNormalize` clips by default."""


def mark_normalized(model: BaseAlgorithm) -> None:
    """Record in the model, and so in its file, whether its observations are normalized."""
    normalizing = model.get_vec_normalize_env()
    setattr(model, _MARK, normalizing is not None and normalizing.norm_obs)


def load_normalization(model: BaseAlgorithm, path: Path) -> VecNormalize | None:
    """Load the normalization beside a model's file; None if the model was trained without one.

    Raises:
        InvalidConfig: It is missing, cannot be read, or is for other observations.
    """
    file = normalization_path(path)
    if not file.is_file():
        if is_normalized(model):
            raise InvalidConfig(
                f"{path} was trained behind VecNormalize, and its normalization is missing: {file} expected, as "
                f"written by model.get_vec_normalize_env().save({str(file)!r}) at the end of the training"
            )
        return None
    try:
        normalization = pickle.loads(file.read_bytes())  # noqa: S301  # pickled, as is the model beside it
    except Exception as error:
        raise InvalidConfig(f"{file} is not a saved VecNormalize: {type(error).__name__}: {error}") from error
    if not isinstance(normalization, VecNormalize):
        raise InvalidConfig(f"{file} is not a saved VecNormalize but a {type(normalization).__name__}")
    if normalization.norm_obs:
        shape = getattr(normalization.obs_rms, "mean", np.empty(())).shape
        if shape != model.observation_space.shape:
            space = model.observation_space
            raise InvalidConfig(f"{file} normalizes observations of shape {shape}; {path} has {space}")
    return normalization


def normalization_of(model: Any) -> VecNormalize | None:
    """Return the `VecNormalize` of a model's environment; None if the model was trained without one.

    Raises:
        InvalidConfig: The model was trained behind one, but loaded without it.
    """
    get = getattr(model, "get_vec_normalize_env", None)
    normalization: VecNormalize | None = get() if callable(get) else None
    if normalization is None and is_normalized(model):
        raise InvalidConfig(
            "the model was trained behind VecNormalize, but loaded without its normalization: use "
            "zenostat.training.load_policy, or load(path, env=VecNormalize.load(normalization, env))"
        )
    return normalization


def is_normalized(model: Any) -> bool:
    """Return whether a model was trained on normalized observations.

    `EvaluationCallback` records this in the model. For other models it is deduced: stable-baselines3 keeps the last
    observation, and behind `VecNormalize` (off-policy also without) an original one; only normalized values lie outside
    the observation space, or are all small where the original ones are not.
    """
    if (mark := getattr(model, _MARK, None)) is not None:
        return bool(mark)
    last, original = getattr(model, "_last_obs", None), getattr(model, "_last_original_obs", None)
    if not isinstance(last, np.ndarray) or not isinstance(original, np.ndarray) or not last.size:
        return False
    space = model.observation_space
    inside = all(space.contains(row.astype(space.dtype)) for row in last)
    return not inside or bool(np.abs(last).max() <= _SCALED < np.abs(original).max() / 1.5)
