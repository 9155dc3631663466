"""Results of a benchmark as a JSON file: versions, hashes and rows."""

from __future__ import annotations

import importlib.metadata
import json
import platform
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from zenostat.lab.benchmark.definition import SETS, VERSION, Task, digest_of
from zenostat.topics import VERSION as PRODUCT_VERSION
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.errors import InvalidConfig, UnknownName
from zenostat.topics.user_file import user_file

_LIBRARIES = ("gymnasium", "numpy", "pyenergyplus-lbnl", "scipy", "stable-baselines3", "torch")
_TITLE = "zenostat benchmark"


@dataclass(frozen=True)
class Row:
    """One episode of one controller.

    Attributes:
        controller: name of a controller of the benchmark, or what `load_controller` accepts.
        building, season, weather: the task.
        seed: seed of the episode.
        reward: sum of the rewards, EUR.
        terms: sums of its terms, EUR.
        linear: sum of the linear rewards of the same episode.
        metrics: metrics and KPIs by name, see `EpisodeMetrics.metrics`.
    """

    controller: str
    building: str
    season: str
    weather: str
    seed: int
    reward: float
    terms: dict[str, float]
    linear: float
    metrics: dict[str, float]

    @property
    def task(self) -> Task:
        """The row's task."""
        return Task(self.building, self.season, self.weather)

    @property
    def key(self) -> tuple[str, str, str, str, int]:
        """Identity of a row among the results."""
        return (self.controller, self.building, self.season, self.weather, self.seed)


@dataclass
class Results:
    """Rows of one set with what they were made with.

    Attributes:
        set: name of the set.
        rows: by `Row.key`.
        hashes: sha256 of the models and weather files by name, where known.
        trainings: by `algorithm/building/season`, hashes of the training's configuration and of the trained weights.
        controllers: sha256 of the files of further controllers.
        versions: of the product, EnergyPlus, Python and libraries.
    """

    set: str
    rows: dict[tuple[str, str, str, str, int], Row] = field(default_factory=dict)
    hashes: dict[str, str] = field(default_factory=dict)
    trainings: dict[str, dict[str, str]] = field(default_factory=dict)
    controllers: dict[str, str] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.versions = self.versions or current_versions()

    def add(self, rows: Iterable[Row]) -> None:
        """Add rows; rows of the same key are replaced."""
        self.rows.update({row.key: row for row in rows})

    def names(self) -> list[str]:
        """Return the controllers in the order in which they were added."""
        return list(dict.fromkeys(row.controller for row in self.rows.values()))

    def sorted_rows(self) -> list[Row]:
        """Return the rows in an order that does not depend on the order of their runs."""
        return [self.rows[key] for key in sorted(self.rows)]

    def plain(self) -> dict[str, Any]:
        """Return the content of the file."""
        rows = [asdict(row) for row in self.sorted_rows()]
        return {
            "format": _TITLE,
            "version": VERSION,
            "set": self.set,
            "definition": SETS[self.set].digest(),
            "versions": self.versions,
            "hashes": dict(sorted(self.hashes.items())),
            "trainings": dict(sorted(self.trainings.items())),
            "controllers": dict(sorted(self.controllers.items())),
            "rows_hash": digest_of(rows),
            "rows": rows,
        }

    def save(self, path: Path) -> None:
        """Write the file atomically, with a line for each row."""
        content = self.plain()
        rows = content.pop("rows")
        head = json.dumps(content, indent=1)[:-2]
        lines = ",\n".join(f"  {json.dumps(row)}" for row in rows)
        with atomic_file(path) as temporary:
            temporary.write_text(f'{head},\n "rows": [\n{lines}\n ]\n}}\n', encoding="utf-8")


def load_results(path: str | Path) -> Results:
    """Read results that `zenostat benchmark` wrote.

    Raises:
        UnknownName: there is no such file, or it cannot be read.
        InvalidConfig: it has no results, those of another version of the benchmark, or edited rows.
    """
    path = Path(path)
    with user_file(path, UnknownName):
        text = path.read_text(encoding="utf-8")
    try:
        content = json.loads(text)
    except ValueError as error:
        raise InvalidConfig(f"{path} has no results of a benchmark: {error}") from None
    if not isinstance(content, dict) or content.get("format") != _TITLE:
        raise InvalidConfig(f"{path} has no results of a benchmark: a file that `zenostat benchmark` wrote expected")
    if content["version"] != VERSION:
        raise InvalidConfig(
            f"{path} has results of version {content['version']} of the benchmark; this is version {VERSION}: use "
            f"Zenostat {content.get('versions', {}).get('zenostat', '(unknown)')} for it, or another --out"
        )
    if content["set"] not in SETS or content["definition"] != SETS[content["set"]].digest():
        raise InvalidConfig(
            f"{path} has results of another definition of the set {content['set']!r}: choose another --out"
        )
    if digest_of(content["rows"]) != content["rows_hash"]:
        raise InvalidConfig(f"{path}: the rows are not those that were written: their hash differs")
    results = Results(
        content["set"], hashes=content["hashes"], trainings=content["trainings"], controllers=content["controllers"],
        versions=content["versions"],
    )  # fmt: skip
    results.add(Row(**row) for row in content["rows"])
    return results


def current_versions() -> dict[str, str]:
    """Return the versions of what determines the rows."""
    versions = {"zenostat": PRODUCT_VERSION, "python": platform.python_version(), "machine": platform.machine()}
    for library in _LIBRARIES:
        with suppress(importlib.metadata.PackageNotFoundError):
            versions[library] = importlib.metadata.version(library)
    return versions


def changed_versions(results: Results) -> list[str]:
    """Return what has another version than in the results: `numpy 2.3.0, now 2.4.0`."""
    now = current_versions()
    return [
        f"{name} {version}, now {now.get(name, 'missing')}"
        for name, version in results.versions.items()
        if name in now | dict.fromkeys(_LIBRARIES) and version != now.get(name)
    ]
