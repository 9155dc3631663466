"""File of a bound: the best known sequence of actions of a task and seed, with its score."""

from __future__ import annotations

import base64
import binascii
import hashlib
import math
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from zenostat.lab.benchmark.bound_moves import Actions
from zenostat.lab.benchmark.definition import SETS, VERSION, Task, digest_of
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.codec import describe_validation_errors
from zenostat.topics.errors import InvalidConfig, UnknownName
from zenostat.topics.user_file import user_file

_MAX_BYTES = 1_000_000
_MAX_VALUES = 1_000_000

Key = tuple[str, str, str, int]
"""Building, season, weather and seed."""


class Bound(BaseModel):
    """The best known sequence of actions of a task and seed.

    Attributes:
        format: kind of the file.
        version: version of the benchmark.
        definition: hash of the task's arguments.
        building, season, weather, seed: the episode.
        relative_k: bound of the actions' offsets to the baseline control, K; None: actions are absolute.
        reward: total reward, EUR, computed as for a row of the results.
        terms: sums of its terms, EUR.
        linear: sum of the linear rewards.
        starts: total rewards of the controllers from which the search could begin, by name and form.
        simulations: simulated timesteps of the controllers and the search, in episodes.
        stages: stages of the search.
        search_seed: seed of the search.
        curve: number of simulations and total reward at each improvement.
        hashes: sha256 of the model and the weather file, where known.
        versions: of the product, EnergyPlus, Python and libraries.
        shape: timesteps and actions.
        actions: float32, little-endian, in the order of `shape`, compressed with zlib, as Base64.
        actions_hash: sha256 of their bytes before compression.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    format: Literal["zenostat bound"] = "zenostat bound"
    version: int = VERSION
    definition: str
    building: str
    season: str
    weather: str
    seed: int
    relative_k: Annotated[float, Field(gt=0.0)] | None
    reward: float
    terms: dict[str, float]
    linear: float
    starts: dict[str, float]
    simulations: int
    stages: int
    search_seed: int
    curve: tuple[tuple[int, float], ...]
    hashes: dict[str, str] = {}
    versions: dict[str, str] = {}
    shape: tuple[Annotated[int, Field(gt=0)], Annotated[int, Field(gt=0)]]
    actions_hash: str
    actions: str

    def __str__(self) -> str:
        return f"{self.task}/{self.seed}"

    @property
    def task(self) -> Task:
        """Building, season and weather."""
        return Task(self.building, self.season, self.weather)

    @property
    def key(self) -> Key:
        """Identity among the bounds of a set."""
        return (self.building, self.season, self.weather, self.seed)

    def changed_files(self, hashes: Mapping[str, str]) -> list[str]:
        """Return which files have another hash among some than in the bound: `file ref-warehouse`."""
        return [f"file {name}" for name, digest in self.hashes.items() if hashes.get(name, digest) != digest]

    def sequence(self) -> Actions:
        """Return the actions, shape (timesteps, actions).

        Raises:
            InvalidConfig: they are not those that were written.
        """
        size = 4 * math.prod(self.shape)
        if size > 4 * _MAX_VALUES:
            raise InvalidConfig(f"a bound of shape {self.shape}; at most {_MAX_VALUES} values expected")
        try:
            raw = zlib.decompressobj().decompress(base64.b64decode(self.actions, validate=True), size + 1)
        except (binascii.Error, zlib.error) as error:
            raise InvalidConfig(f"its actions cannot be read: {error}") from None
        if hashlib.sha256(raw).hexdigest() != self.actions_hash:
            raise InvalidConfig("its actions are not those that were written: their hash differs")
        if len(raw) != size:
            raise InvalidConfig(f"{len(raw)} bytes of actions; {size} expected for the shape {self.shape}")
        return np.frombuffer(raw, "<f4").reshape(self.shape).astype(np.float32)

    def save(self, folder: Path) -> Path:
        """Write the file of the task and seed atomically, and return its path."""
        path = bound_path(folder, self.task, self.seed)
        with atomic_file(path) as temporary:
            temporary.write_text(self.model_dump_json(indent=1) + "\n", encoding="utf-8")
        return path


def packed(actions: Actions) -> dict[str, Any]:
    """Return the fields of a `Bound` that have a sequence."""
    raw = np.ascontiguousarray(actions, "<f4").tobytes()
    return {
        "shape": actions.shape,
        "actions_hash": hashlib.sha256(raw).hexdigest(),
        "actions": base64.b64encode(zlib.compress(raw, 9)).decode("ascii"),
    }


def bound_path(folder: Path, task: Task, seed: int) -> Path:
    """Return the path of the file of a task and seed."""
    return folder / f"{'-'.join(task.key)}-{seed}.json"


def definition_of(set_name: str, task: Task) -> str:
    """Return a hash of all that determines the reward of a sequence of actions, but the seed."""
    return digest_of([VERSION, SETS[set_name].arguments(*task.key)])


def load_bound(path: Path, set_name: str) -> Bound:
    """Read a file that `zenostat bounds` wrote.

    Args:
        path: the file.
        set_name: set of the benchmark whose definition it has to have.

    Raises:
        UnknownName: there is no such file, or it cannot be read.
        InvalidConfig: it has no bound, that of another version or definition, or edited actions.
    """
    with user_file(path, UnknownName):
        if path.stat().st_size > _MAX_BYTES:
            raise InvalidConfig(
                f"{path} has more than {_MAX_BYTES} bytes; a file that `zenostat bounds` wrote expected"
            )
        text = path.read_text(encoding="utf-8")
    try:
        bound = Bound.model_validate_json(text)
    except ValidationError as error:
        described = describe_validation_errors(error, Bound.model_fields)
        raise InvalidConfig(f"{path} is not a file that `zenostat bounds` wrote: {described}") from None
    if bound.version != VERSION:
        raise InvalidConfig(
            f"{path} has a bound of version {bound.version} of the benchmark; this is version {VERSION}"
        )
    if bound.task not in SETS[set_name].tasks() or bound.definition != definition_of(set_name, bound.task):
        raise InvalidConfig(f"{path} has a bound of another definition of the set {set_name!r}")
    try:
        bound.sequence()
    except InvalidConfig as error:
        raise InvalidConfig(f"{path}: {error}") from None
    return bound


def load_bounds(folder: Path, set_name: str) -> dict[Key, Bound]:
    """Read all bounds of a folder; errors as of `load_bound`.

    Raises:
        UnknownName: there is no such folder, or it has no bounds.
        InvalidConfig: two files have bounds of one task and seed.
    """
    if not folder.is_dir():
        raise UnknownName(f"there is no folder {folder.absolute()}; one that `zenostat bounds` wrote expected")
    bounds: dict[Key, Bound] = {}
    for path in sorted(folder.glob("[!.]*.json")):
        bound = load_bound(path, set_name)
        if bound.key in bounds:
            raise InvalidConfig(f"{path} has a bound of {bound}, as another file there: remove one")
        bounds[bound.key] = bound
    if not bounds:
        raise UnknownName(f"{folder} has no bounds; write them with `zenostat bounds {folder}`")
    return bounds
