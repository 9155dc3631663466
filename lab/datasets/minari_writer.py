"""Write episodes as a Minari data set; jax, which Minari's own collector needs, is not imported."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec

from zenostat.lab.datasets.episode import AgentEpisode
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.extras import requires_extra

_DATA = "data"
_FEATURE = "a data set"


def check_minari() -> None:
    """Check that the libraries are installed; `InvalidConfig` has the command that installs them."""
    with requires_extra("dataset", _FEATURE, "Minari"):
        import h5py  # noqa: F401
        import minari  # noqa: F401
        import PIL  # noqa: F401


def datasets_folder(folder: str | Path | None = None) -> Path:
    """Return the folder of all data sets: `folder`, else `MINARI_DATASETS_PATH`, else `~/.minari/datasets`."""
    return Path(folder or os.environ.get("MINARI_DATASETS_PATH") or "~/.minari/datasets").expanduser().absolute()


def check_new_dataset(dataset_id: str, folder: Path) -> Path:
    """Return the path of a new data set.

    Raises:
        InvalidConfig: the id is not one of Minari's, the data set exists, or its folder cannot be written.
    """
    from minari.dataset.minari_dataset import parse_dataset_id

    try:
        parse_dataset_id(dataset_id)
    except (ValueError, TypeError):  # TypeError: no version
        raise InvalidConfig(
            f"the id {dataset_id!r}: expected NAMESPACE/NAME-vNUMBER, such as zenostat/five-zone/rbc-v0, with two "
            "or more letters, digits, '_' or '-' in each part"
        ) from None
    path = folder / dataset_id
    if path.exists():
        raise InvalidConfig(f"the data set {dataset_id} exists already: {path}; choose another version, or delete it")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder, prefix=".check-"):
            pass
    except OSError as error:
        raise InvalidConfig(f"cannot write data sets to {folder}: {error.strerror}") from None
    return path


def write_minari(
    path: Path,
    folder: Path,
    *,
    spaces: tuple[gym.Space[Any], gym.Space[Any]],
    spec: EnvSpec | None,
    metadata: Mapping[str, Any],
    episodes: Iterable[tuple[AgentEpisode, Mapping[str, Any]]],
) -> None:
    """Write a data set as the episodes come; it appears at `path` when it is complete, or not at all.

    Args:
        path: of the data set, below `folder`.
        folder: of all data sets.
        spaces: of observations and of actions.
        spec: of the environment, from which Minari recovers it.
        metadata: of the data set.
        episodes: each with its own metadata.
    """
    from minari.data_collector import EpisodeBuffer
    from minari.dataset.minari_storage import MinariStorage

    observation_space, action_space = spaces
    with tempfile.TemporaryDirectory(dir=folder, prefix=".writing-") as scratch:
        data = Path(scratch) / "set" / _DATA
        data.mkdir(parents=True)
        storage = MinariStorage.new(
            data,
            observation_space=observation_space,
            action_space=action_space,
            env_spec=spec,
            data_format="hdf5",
            jpeg_encoding=False,
        )
        storage.update_metadata(dict(metadata))
        for number, (episode, about) in enumerate(episodes):
            is_last = np.arange(episode.trajectory.steps) == episode.trajectory.steps - 1
            buffer: Any = EpisodeBuffer(
                seed=episode.trajectory.seed,
                observations=episode.observations,
                actions=episode.trajectory.actions,
                rewards=episode.trajectory.rewards,
                terminations=is_last & episode.terminated,
                truncations=is_last & episode.truncated,
                infos=episode.infos(),
            )
            storage.update_episodes([buffer])
            storage.update_episode_metadata([dict(about)], [number])
        path.parent.mkdir(parents=True, exist_ok=True)
        data.parent.rename(path)
    _write_namespaces(path.parent, folder)


def _write_namespaces(parent: Path, folder: Path) -> None:
    """Mark the folders between `folder` and a data set as namespaces, as Minari does."""
    from minari.namespace import NAMESPACE_METADATA_FILENAME

    while parent != folder:
        file = parent / NAMESPACE_METADATA_FILENAME
        if not file.exists():
            file.write_text("{}")
        parent = parent.parent
