"""Load trained models of stable-baselines3 as controllers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from zenostat.agent_sdk.controllers import training_folder
from zenostat.agent_sdk.controllers.base import Controller
from zenostat.agent_sdk.controllers.policy import ALGORITHMS, PolicyController, preserve_random_state
from zenostat.agent_sdk.controllers.wrapped_policy import WrappedPolicy
from zenostat.agent_sdk.vec_normalization import load_normalization
from zenostat.topics import yaml12
from zenostat.topics.errors import InvalidConfig, UnknownName, did_you_mean
from zenostat.topics.extras import requires_extra
from zenostat.topics.messages import Manifest

with requires_extra("train", "training", "stable-baselines3"):
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.vec_env import VecNormalize


def load_policy(
    path: str | Path, algorithm: str | type[BaseAlgorithm] | None = None
) -> Callable[[Manifest], Controller]:
    """Load a trained model as a controller factory, which is called with a node's manifest like a controller class.

    The normalization of a model that was trained behind `VecNormalize` is loaded with it: `model.vecnormalize.pkl`
    beside `model.zip`, where `EvaluationCallback` saves it and `VecNormalize.save` can. A model acts within the
    wrappers of its training: those of the training's folder, or of `model.wrappers.yaml` beside `model.zip`, which
    `EvaluationCallback` and `zenostat.wrappers.save_wrappers` write.

    These files contain pickled Python objects, which may execute arbitrary code when they are loaded: load only files
    that you trust.

    Args:
        path: Folder of a training (`zenostat train`), whose best model is loaded; or a file in it; or a file written by
            `model.save`, which can have the algorithm as a prefix, `ppo:model.zip`.
        algorithm: One of `ALGORITHMS`, or a class such as `sb3_contrib.TRPO`; a training's folder names its own.

    Raises:
        UnknownName: No such file or algorithm.
        InvalidConfig: The file is not a model of that algorithm; its normalization is missing or does not fit; its
            wrappers cannot be written as data; or the folder was written by another version.
    """
    name, colon, rest = str(path).partition(":")
    if algorithm is None and colon:
        algorithm, path = name, rest
    path, folder = Path(path).expanduser(), None
    if training_folder.is_training(path):
        folder, path = path, training_folder.model_file(path)
    elif training_folder.is_training(path.parent):
        folder = path.parent
    if folder is not None or path.is_dir():  # a folder of another kind is an error
        algorithm = str(training_folder.read_training_fields(folder or path).get("algorithm"))
    if algorithm is None:
        raise InvalidConfig(
            f"the algorithm of {path} is missing: one of {', '.join(ALGORITHMS)} expected, as ppo:{path}"
        )
    model, normalization = load_model(path, algorithm)
    wrappers, states = _read_chain(path) if folder is None else training_folder.read_wrappers(folder, path)

    def policy(manifest: Manifest) -> Controller:
        if not wrappers:
            return PolicyController(manifest, model, normalization)
        return WrappedPolicy(manifest, model, normalization, wrappers, states)

    return policy


def _read_chain(model: Path) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the wrappers that `save_wrappers` wrote beside a model, innermost first, and their states.

    Raises:
        InvalidConfig: some of them could not be written.
    """
    file = training_folder.wrappers_path(model)
    if not file.is_file():
        return [], []
    content = yaml12.read_mapping(file)
    chain, states = list(content.get("chain", [])), list(content.get("wrappers", []))
    reason = content.get("chain_error", "it has no chain" if states and not chain else None)
    if reason is not None:
        raise InvalidConfig(
            f"{file}: the wrappers of the training of {model.name} cannot be applied again: {reason}; run the model in "
            "an environment within the same wrappers: evaluate_model(model, env)"
        )
    return chain, states


def load_model(path: Path, algorithm: str | type[BaseAlgorithm]) -> tuple[BaseAlgorithm, VecNormalize | None]:
    """Load a model's file and the normalization beside it."""
    if isinstance(algorithm, str):
        if algorithm.casefold() not in ALGORITHMS:
            raise UnknownName(f"no algorithm {algorithm!r}; {did_you_mean(algorithm, ALGORITHMS)}")
        algorithm = ALGORITHMS[algorithm.casefold()]
    if not path.is_file():
        raise UnknownName(f"there is no model file {path.absolute()}")
    try:
        with preserve_random_state():  # loading a model that was created with a seed seeds the global generators
            model = algorithm.load(path, device="cpu")
    except Exception as error:
        raise InvalidConfig(
            f"{path} is not a model of {algorithm.__name__}, or of another version: {type(error).__name__}: {error}"
        ) from error
    return model, load_normalization(model, path)
