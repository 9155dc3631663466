"""Controllers that the benchmark trains, and the folders that keep them."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from zenostat.lab.benchmark.definition import SETS, digest_of
from zenostat.lab.benchmark.results import current_versions

_FINISHED = "weights.sha256"
"""File that marks a training of the benchmark as finished, with the hash of its weights."""


@dataclass(frozen=True)
class Training:
    """A training of the benchmark.

    Attributes:
        cache: folder with a folder for each training.
        set: name of the set.
        algorithm: `ppo` or `sac`.
        building, season: what it is trained for.
    """

    cache: Path
    set: str
    algorithm: str
    building: str
    season: str

    @property
    def key(self) -> tuple[str, str, str]:
        """Algorithm, building and season."""
        return (self.algorithm, self.building, self.season)

    @property
    def name(self) -> str:
        """Its name in the results."""
        return "/".join(self.key)

    def __str__(self) -> str:
        return f"training {self.name}"

    @property
    def fields(self) -> dict[str, Any]:
        """Fields of its training file."""
        return SETS[self.set].training(*self.key)

    @property
    def digest(self) -> str:
        """Hash of its configuration and of the versions that determine its weights."""
        return digest_of([SETS[self.set].published_training(*self.key), current_versions()])

    @property
    def folder(self) -> Path:
        """Its folder, which `load_controller` accepts."""
        return self.cache / f"{'-'.join(self.key)}-{self.digest[:12]}"


def ensure_trained(training: Training) -> tuple[Training, dict[str, str]]:
    """Train if the cache has no finished training, and return the hashes of its configuration and weights.

    An interrupted training is resumed, to the bit.
    """
    finished = training.folder / _FINISHED
    if not finished.is_file():
        _train(training)
    return training, {"training": training.digest, "weights": finished.read_text(encoding="utf-8").strip()}


def _train(training: Training) -> None:
    from zenostat.agent_sdk.controllers.training_folder import MODEL, is_training
    from zenostat.lab.training import ALGORITHMS, read_training, train

    folder = training.folder
    config = read_training({**training.fields, "output": str(folder)}, str(training))
    train(config, resume=is_training(folder))
    model = ALGORITHMS[training.algorithm].load(folder / MODEL, device="cpu")
    digest = hashlib.sha256()
    for name, tensor in sorted(model.policy.state_dict().items()):
        digest.update(name.encode())
        digest.update(tensor.numpy().tobytes())
    (folder / _FINISHED).write_text(digest.hexdigest() + "\n", encoding="utf-8")
