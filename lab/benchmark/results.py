"""Results of a benchmark as a JSON file: versions, hashes and rows."""

from __future__ import annotations

import importlib.metadata
import json
import platform
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from zenostat.lab.benchmark.definition import SETS, VERSION, Episode, Task, training_key
from zenostat.lab.benchmark.results_file import SHOWN_METRICS, TITLE, ResultsFile, Row, rows_digest
from zenostat.topics import VERSION as PRODUCT_VERSION
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.codec import describe_validation_errors
from zenostat.topics.errors import InvalidConfig, UnknownName
from zenostat.topics.user_file import user_file

_LIBRARIES = ("gymnasium", "numpy", "optuna", "pyenergyplus-lbnl", "scipy", "stable-baselines3", "torch")
NEEDED_VERSIONS = ("zenostat", "python", "machine", "gymnasium", "numpy", "pyenergyplus-lbnl")
"""Versions that determine the rewards of a sequence of actions, and so the rows of controllers that are not trained."""


def current_versions() -> dict[str, str]:
    """Return the versions of what determines the rows."""
    versions = {"zenostat": PRODUCT_VERSION, "python": platform.python_version(), "machine": platform.machine()}
    for library in _LIBRARIES:
        with suppress(importlib.metadata.PackageNotFoundError):
            versions[library] = importlib.metadata.version(library)
    return versions


@dataclass
class Results:
    """Rows of one set with what they were made with.

    Attributes:
        set: name of the set.
        rows: by `Episode.key`.
        hashes: sha256 of the models and weather files by name, where known.
        trainings: by name, the record of each training and tuning; see `zenostat.lab.benchmark.prepared`.
        controllers: by name, the hash of the parameters of a controller of the benchmark, or of another one's file.
        versions: of the product, EnergyPlus, Python and libraries.
    """

    set: str
    rows: dict[tuple[str, str, str, str, int, int], Row] = field(default_factory=dict)
    hashes: dict[str, str] = field(default_factory=dict)
    trainings: dict[str, dict[str, Any]] = field(default_factory=dict)
    controllers: dict[str, str] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=current_versions)

    def add(self, rows: Iterable[Row]) -> None:
        """Add rows; rows of the same key are replaced."""
        self.rows.update({episode_of(row).key: row for row in rows})

    def names(self) -> list[str]:
        """Return the controllers in the order in which they were added."""
        return list(dict.fromkeys(row.controller for row in self.rows.values()))

    def identities(self) -> dict[str, str]:
        """Return the hash of each controller by name, "" of one that has rows but no hash."""
        return {**dict.fromkeys(self.names(), ""), **self.controllers}

    def missing(self, names: Iterable[str]) -> list[Episode]:
        """Return the episodes of controllers that the set has and the rows do not."""
        return [episode for episode in SETS[self.set].episodes(names) if episode.key not in self.rows]

    def sorted_rows(self) -> list[Row]:
        """Return the rows in an order that does not depend on the order of their runs."""
        return [self.rows[key] for key in sorted(self.rows)]

    def plain(self) -> dict[str, Any]:
        """Return the content of the file."""
        rows = [row.plain() for row in self.sorted_rows()]
        return {
            "format": TITLE,
            "version": VERSION,
            "set": self.set,
            "definition": SETS[self.set].digest(),
            "versions": self.versions,
            "hashes": dict(sorted(self.hashes.items())),
            "trainings": dict(sorted(self.trainings.items())),
            "controllers": dict(sorted(self.controllers.items())),
            "rows_hash": rows_digest(rows),
            "rows": rows,
        }

    def save(self, path: Path) -> None:
        """Write the file atomically, with a line for each training and row."""
        content = self.plain()
        rows, trainings = content.pop("rows"), content.pop("trainings")
        head = json.dumps(content, indent=1)[:-2]
        entries = ",\n".join(f"  {json.dumps(name)}: {json.dumps(record)}" for name, record in trainings.items())
        lines = ",\n".join(f"  {json.dumps(row)}" for row in rows)
        text = f'{head},\n "trainings": {{\n{entries}\n }},\n "rows": [\n{lines}\n ]\n}}\n'
        with atomic_file(path) as temporary:
            temporary.write_text(text, encoding="utf-8")


def episode_of(row: Row) -> Episode:
    """Return the episode of a row."""
    return Episode(row.controller, Task(row.building, row.season, row.weather), row.seed, row.training_seed)


def load_results(path: str | Path) -> Results:
    """Read results that `zenostat benchmark` wrote.

    Raises:
        UnknownName: there is no such file, or it cannot be read.
        InvalidConfig: it has no results, those of another version of the benchmark, edited or incomplete rows, no
            versions, or trainings that the set does not have.
    """
    path = Path(path)
    with user_file(path, UnknownName):
        text = path.read_text(encoding="utf-8")
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InvalidConfig(f"{path} has no results of a benchmark: {error}") from None
    if not isinstance(content, dict) or content.get("format") != TITLE:
        raise InvalidConfig(f"{path} has no results of a benchmark: a file that `zenostat benchmark` wrote expected")
    _check_version(content, path)
    try:
        file = ResultsFile.model_validate_json(text)
    except ValidationError as error:
        described = describe_validation_errors(error, ResultsFile.model_fields)
        raise InvalidConfig(f"{path} does not have the form of results: {described}") from None
    if file.set not in SETS or file.definition != SETS[file.set].digest():
        raise InvalidConfig(f"{path} has results of another definition of the set {file.set!r}: choose another --out")
    if rows_digest(content["rows"]) != file.rows_hash:
        raise InvalidConfig(f"{path}: the rows are not those that were written: their hash differs")
    results = Results(
        file.set, hashes=file.hashes, trainings=content["trainings"], controllers=file.controllers,
        versions=file.versions,
    )  # fmt: skip
    results.add(file.rows)
    if len(results.rows) < len(file.rows):
        raise InvalidConfig(f"{path} has {len(file.rows) - len(results.rows)} episodes more than once")
    _check_content(results, path)
    return results


def _check_content(results: Results, path: Path) -> None:
    if absent := [name for name in NEEDED_VERSIONS if name not in results.versions]:
        raise InvalidConfig(f"{path}: versions: {', '.join(absent)} missing: nothing says what its rows were made with")
    for name in results.trainings:
        try:
            training_key(name, results.set)
        except InvalidConfig as error:
            raise InvalidConfig(f"{path}: {error}") from None
    for row in results.rows.values():
        if absent := [name for name in SHOWN_METRICS if name not in row.metrics]:
            raise InvalidConfig(f"{path}: the row {episode_of(row)} has no metric {absent[0]}")


def _check_version(content: Mapping[str, Any], path: Path) -> None:
    if content.get("version") == VERSION:
        return
    versions = content.get("versions")
    product = versions.get("zenostat", "(unknown)") if isinstance(versions, dict) else "(unknown)"
    raise InvalidConfig(
        f"{path} has results of version {content.get('version')} of the benchmark; this is version {VERSION}: use "
        f"Zenostat {product} for it, or another --out"
    )


def _release(version: str) -> str:
    """Return a version without its local part, which names a build: `2.13.0` of `2.13.0+cpu`."""
    return version.partition("+")[0]


def changed_versions(
    saved: Mapping[str, str], now: Mapping[str, str] | None = None, names: Collection[str] | None = None
) -> list[str]:
    """Return what had another version before: `numpy 2.3.0, now 2.4.0`.

    Args:
        saved: the versions of results or of a bound.
        now: those of other results, which are compared as far as both have them; None: the current ones.
        names: compare only these; None: all.
    """
    known = current_versions() if now is None else now
    compared = known.keys() | (_LIBRARIES if now is None else ())
    return [
        f"{name} {version}, now {known.get(name, 'missing')}"
        for name, version in saved.items()
        if name in compared and (names is None or name in names) and _release(version) != _release(known.get(name, ""))
    ]
