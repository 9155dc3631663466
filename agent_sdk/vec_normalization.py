"""The normalization of observations that a model of stable-baselines3 was trained behind."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np

from topics.errors import InvalidConfig
from topics.extras import install_command

try:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.vec_env import VecNormalize
except ImportError as error:
    raise InvalidConfig(f"training needs stable-baselines3 ({error}): {install_command('train')}") from None

_MARK = "observations_normalized"
_SCALED = 10.0
"""The bound at which `VecNormalize` clips, unless it is told another one."""


def beside_model(path: Path) -> Path:
    """The file of a model's normalization: `best.vecnormalize.pkl` of `best.zip`."""
    return path.with_suffix(".vecnormalize.pkl")


def mark_normalized(model: BaseAlgorithm) -> None:
    """Write into the model, and so into its file, whether its observations are normalized."""
    normalizing = model.get_vec_normalize_env()
    setattr(model, _MARK, normalizing is not None and normalizing.norm_obs)


def load_normalization(model: BaseAlgorithm, path: Path) -> VecNormalize | None:
    """The normalization beside a model's file; None if the model was trained without one.

    Raises:
        InvalidConfig: it is missing, cannot be read, or is of other observations.
    """
    file = beside_model(path)
    if not file.is_file():
        if is_normalized(model):
            raise InvalidConfig(
                f"{path} was trained behind VecNormalize, and its normalization is missing: {file} expected, as "
                f"model.get_vec_normalize_env().save({str(file)!r}) writes it at the end of the training"
            )
        return None
    try:
        found = pickle.loads(file.read_bytes())  # noqa: S301  # as the model beside it
    except Exception as fault:
        raise InvalidConfig(f"{file} is no saved VecNormalize: {type(fault).__name__}: {fault}") from fault
    if not isinstance(found, VecNormalize):
        raise InvalidConfig(f"{file} is no saved VecNormalize but a {type(found).__name__}")
    shape = getattr(getattr(found, "obs_rms", None), "mean", np.empty(model.observation_space.shape or ())).shape
    if found.norm_obs and shape != model.observation_space.shape:
        raise InvalidConfig(f"{file} normalizes observations of shape {shape}; {path} has {model.observation_space}")
    return found


def normalization_of(model: Any) -> VecNormalize | None:
    """The `VecNormalize` of the environment that a model is on; None if it was trained without one.

    Raises:
        InvalidConfig: it was trained behind one, and loaded without it.
    """
    find = getattr(model, "get_vec_normalize_env", None)
    found: VecNormalize | None = find() if callable(find) else None
    if found is None and is_normalized(model):
        raise InvalidConfig(
            "the model was trained behind VecNormalize, and has been loaded without its normalization: take "
            "agent_sdk.training.load_policy, or load(path, env=VecNormalize.load(normalization, env))"
        )
    return found


def is_normalized(model: Any) -> bool:
    """Whether a model was trained on normalized observations.

    A model that an `EvaluationCallback` has seen says so. Of others, stable-baselines3 keeps the last observation, and
    behind `VecNormalize` (off-policy also without) an original one: only normalized values leave their space, or are
    all small where the original ones are not.
    """
    if (said := getattr(model, _MARK, None)) is not None:
        return bool(said)
    last, original = getattr(model, "_last_obs", None), getattr(model, "_last_original_obs", None)
    if not isinstance(last, np.ndarray) or not isinstance(original, np.ndarray) or not last.size:
        return False
    space = model.observation_space
    inside = all(space.contains(row.astype(space.dtype)) for row in last)
    return not inside or bool(np.abs(last).max() <= _SCALED < np.abs(original).max() / 1.5)
