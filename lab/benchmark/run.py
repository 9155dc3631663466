"""Run a benchmark on several processes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from zenostat.agent_sdk.controllers.base import BaselineController
from zenostat.agent_sdk.controllers.loader import controller_files
from zenostat.bridge.recording.file import file_digest
from zenostat.lab.benchmark.definition import (
    BASELINE,
    BASELINES,
    SETS,
    TUNED,
    Episode,
    digest_of,
    is_prepared,
    training_key,
)
from zenostat.lab.benchmark.episodes import jobs, run_job
from zenostat.lab.benchmark.prepared import Preparation, ensure_prepared, preparation_of
from zenostat.lab.benchmark.recipes import FORMS
from zenostat.lab.benchmark.results import Results, changed_versions, load_results
from zenostat.lab.benchmark.selection import Selection
from zenostat.lab.workers import Progress, RunAll, worker_pool
from zenostat.topics.atomic_file import check_writable
from zenostat.topics.errors import InvalidConfig, UnknownName, did_you_mean
from zenostat.topics.extras import import_extra
from zenostat.topics.file_lock import locked

DEFAULT_CONTROLLERS = tuple(BASELINES)


def run_benchmark(
    set_name: str,
    path: Path,
    controllers: Sequence[str] = DEFAULT_CONTROLLERS,
    *,
    selection: Selection | None = None,
    workers: int = 1,
    cache: Path | None = None,
    policies: Path | None = None,
    hashes: Mapping[str, str] | None = None,
    progress: Progress | None = None,
) -> tuple[Results, list[str]]:
    """Run the episodes of a set that a file does not have yet, and write it after each training and task.

    Rows do not depend on the number of workers, the order of the controllers, the selection or interruptions.

    Args:
        set_name: a key of `SETS`.
        path: file of the results (JSON); if it exists, its rows are kept.
        controllers: names of `BASELINES`, or others as for `load_controller`. The baseline control is always run.
        selection: run only these episodes; None: all. Its controllers are ignored.
        workers: number of processes; each simulates one building at a time.
        cache: folder of the trainings and tunings; by default beside the results.
        policies: folder with finished trainings and tunings, which are used instead of the cache's, and which gets
            further ones; None: none.
        hashes: sha256 of the models and weather files by name, which are kept with the results.
        progress: called after each training and task.

    Returns:
        The results, and the errors of tasks that failed.

    Raises:
        UnknownName: there is no such set or controller, or nothing is selected.
        InvalidConfig: the file has other results, or those of other versions or other files; or
            another process is writing it.
        SimulatorError: a worker process was killed.
    """
    if set_name not in SETS:
        raise UnknownName(f"there is no set {set_name!r}; {did_you_mean(set_name, SETS, limit=len(SETS))}")
    names = list(dict.fromkeys([BASELINE, *controllers]))
    files = check_controllers(names)
    if policies is None:
        check_extras(names)
    episodes = SETS[set_name].episodes(names)
    if selection is not None:
        selection.check(episodes, f"the set {set_name!r}")
        episodes = [episode for episode in episodes if selection.has(episode)]
    check_writable(path, f"--out {path}")
    lock = path.with_name(f".{path.name}.lock")
    with locked(lock, f"{path}: another process is writing results there; choose another --out"):
        results = _open(path, set_name, dict(hashes or {}), files)
        missing = [episode for episode in episodes if episode.key not in results.rows]
        folder = cache_folder(path) if cache is None else cache
        return results, _run_missing(path, results, missing, folder, policies, workers, progress)


def cache_folder(path: Path) -> Path:
    """Return the default folder of the trainings of results."""
    return path.with_name(f"{path.stem}-trainings")


def _run_missing(
    path: Path, results: Results, missing: Sequence[Episode], cache: Path, policies: Path | None, workers: int,
    progress: Progress | None,
) -> list[str]:  # fmt: skip
    errors: list[str] = []
    with worker_pool(workers) as run_all:
        unprepared = prepare_missing(results, missing, cache, policies, run_all, progress, errors, path)
        runnable = [episode for episode in missing if (name_of(episode)) not in unprepared]
        for rows, failures in run_all(run_job, jobs(results.set, runnable, cache), "episodes", progress, errors):
            errors += failures
            results.add(rows)
            results.save(path)
    results.save(path)
    return errors


def name_of(episode: Episode) -> str:
    """Return the name of the training or tuning that an episode needs; "" if it needs none."""
    return preparation_of(episode, "", Path()).name if is_prepared(episode.controller) else ""


def check_controllers(names: Sequence[str]) -> dict[str, str]:
    """Check controllers, and return the hash of each: of its parameters, or of the file of one of the user's.

    Those that the benchmark trains or tunes have a hash for each training instead.

    Raises:
        UnknownName, InvalidConfig: see `load_controller`.
    """
    from zenostat.agent_sdk.controllers import load_controller

    hashes: dict[str, str] = {}
    for name in names:
        if is_prepared(name):
            continue
        if name in BASELINES:
            hashes[name] = digest_of([name, BASELINES[name], FORMS.get(name, {})])
        elif load_controller(name) is BaselineController:
            raise InvalidConfig(f"{name} is the baseline control: name it 'baseline'")
        else:
            hashes[name] = _controller_digest(name)
    return hashes


def check_extras(names: Sequence[str]) -> None:
    """Check that what trains and tunes is installed.

    Raises:
        InvalidConfig: an extra is missing.
    """
    for name in filter(is_prepared, names):
        if name != TUNED:
            import_extra("stable_baselines3", "train", f"the controller {name}")
        for module in ("optuna", "cmaes"):
            import_extra(module, "tune", f"the controller {name}, which is tuned or builds on one that is,")


def _controller_digest(name: str) -> str:
    """Return the sha256 of a controller's file; "" of a module or a bundled controller.

    That of a model is of its normalization and wrappers too, and that of `CONTROLLER@FILE.yaml` of both.
    """
    controller, at, parameters = name.rpartition("@")
    if at and parameters.casefold().endswith((".yaml", ".yml")):
        return digest_of([_controller_digest(controller), file_digest(Path(parameters).expanduser())])
    files = controller_files(name)
    digests = {file.name: file_digest(file) for file in files}
    return digest_of(digests) if len(files) > 1 else "".join(digests.values())


def _open(path: Path, set_name: str, hashes: dict[str, str], files: dict[str, str]) -> Results:
    """Return the results in a file, or new ones if there is none.

    Raises:
        InvalidConfig: rows could not be compared with those in the file.
    """
    if not path.exists():
        return Results(set_name, hashes=hashes, controllers=files)
    results = load_results(path)
    if results.set != set_name:
        raise InvalidConfig(f"{path} has results of the set {results.set!r}: choose another --out for {set_name!r}")
    if changes := changed_versions(results.versions):
        raise InvalidConfig(f"{path} has rows of other versions ({'; '.join(changes)}): choose another --out")
    for known, now, what in (
        (results.hashes, hashes, "another file"), (results.identities(), files, "another version of the controller"),
    ):  # fmt: skip
        differing = [name for name in known.keys() & now if known[name] != now[name]]
        if differing:
            raise InvalidConfig(f"{path} has rows of {what} {differing[0]}: choose another --out")
    results.hashes.update(hashes)
    results.controllers.update(files)
    if stale := stale_trainings(results):
        raise InvalidConfig(
            f"{path} has rows of {len(stale)} trainings or tunings of another definition, such as {stale[0]}: choose "
            "another --out"
        )
    return results


def stale_trainings(results: Results) -> list[str]:
    """Return the names of trainings and tunings whose configuration is not that of this version."""
    stale = []
    for name, record in results.trainings.items():
        now = Preparation(Path(), results.set, *training_key(name, results.set))
        if record["configuration"] != now.configuration:
            stale.append(name)
    return stale


def prepare_missing(
    results: Results, missing: Sequence[Episode], cache: Path, policies: Path | None, run_all: RunAll,
    progress: Progress | None, errors: list[str], path: Path | None = None,
) -> set[str]:  # fmt: skip
    """Train and tune what episodes need, and add the records to the results.

    Args:
        results: the results.
        missing: the episodes.
        cache: folder of the trainings and tunings.
        policies: as of `run_benchmark`.
        run_all: runs a function in worker processes.
        progress: as of `run_benchmark`.
        errors: gets the text of each error.
        path: file to which the results are written after each training; None: they are not.

    Returns:
        The names of what could not be trained or tuned, or has other weights than in the results.
    """
    trainings = {
        preparation.name: preparation
        for episode in missing
        if is_prepared(episode.controller)
        for preparation in [preparation_of(episode, results.set, cache, policies)]
    }
    tunings = {tuning.name: tuning for of in trainings.values() if (tuning := of.tuning) is not None}
    tunings |= {name: of for name, of in trainings.items() if of.training_seed is None}
    unprepared = tunings.keys() | trainings.keys()

    def prepare(stage: str, needed: Sequence[Preparation]) -> None:
        for preparation, record in run_all(ensure_prepared, needed, stage, progress, errors):
            former = results.trainings.get(preparation.name)
            if former is not None and not same_controller(former, record):
                errors.append(f"{preparation}: made again, it differs from that of the rows in the results")
                continue
            results.trainings[preparation.name] = record if former is None else former
            unprepared.discard(preparation.name)
            if path is not None:
                results.save(path)

    prepare("tuning", list(tunings.values()))
    based = [of for name, of in trainings.items() if name not in tunings]
    prepare("training", [of for of in based if of.tuning is None or of.tuning.name not in unprepared])
    return unprepared


def same_controller(record: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Return whether two records are of the same trained or tuned controller: processor times do not count."""
    names = ("configuration", "weights", "parameters")
    return all(record.get(name) == other.get(name) for name in names)
