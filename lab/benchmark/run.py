"""Run a benchmark on several processes, and check results by running them again."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from functools import partial
from itertools import product
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from zenostat.agent_sdk.controllers.base import BaselineController
from zenostat.bridge.recording.file import file_digest
from zenostat.lab.benchmark.definition import BASELINES, SETS, Task, is_trained
from zenostat.lab.benchmark.episodes import Job, describe_error, run_job
from zenostat.lab.benchmark.results import Results, Row, changed_versions, load_results
from zenostat.lab.benchmark.selection import Selection
from zenostat.lab.benchmark.trained import Training, ensure_trained
from zenostat.topics.errors import InvalidConfig, SimulatorError, UnknownName, did_you_mean
from zenostat.topics.file_lock import locked

Progress = Callable[[str, int, int], None]
"""Callback with the stage (`training`, `episodes`), the number of finished items (first 0) and of all."""

Episode = tuple[str, Task, int]
"""Controller, task and seed."""

DEFAULT_CONTROLLERS = tuple(BASELINES)


def run_benchmark(
    set_name: str,
    path: Path,
    controllers: Sequence[str] = DEFAULT_CONTROLLERS,
    *,
    workers: int = 1,
    cache: Path | None = None,
    hashes: Mapping[str, str] | None = None,
    progress: Progress | None = None,
) -> tuple[Results, list[str]]:
    """Run the episodes of a set that a file does not have yet, and write it after each task.

    Rows do not depend on the number of workers, the order of the controllers or interruptions.

    Args:
        set_name: a key of `SETS`.
        path: file of the results (JSON); if it exists, its rows are kept.
        controllers: names of `BASELINES`, or others as for `load_controller`. The baseline control is always run.
        workers: number of processes; each simulates one building at a time.
        cache: folder of the trainings; by default beside the results.
        hashes: sha256 of the models and weather files by name, which are kept with the results.
        progress: called after each training and task.

    Returns:
        The results, and the errors of tasks that failed.

    Raises:
        UnknownName: there is no such set or controller.
        InvalidConfig: the file has other results, or those of other versions or other files; or
            another process is writing it.
        SimulatorError: a worker process was killed.
    """
    if set_name not in SETS:
        raise UnknownName(f"there is no set {set_name!r}; {did_you_mean(set_name, SETS, limit=len(SETS))}")
    names = list(dict.fromkeys(["baseline", *controllers]))
    files = check_controllers(names)
    if not path.absolute().parent.is_dir():
        raise InvalidConfig(f"--out {path}: there is no folder {path.absolute().parent}")
    lock = path.with_name(f".{path.name}.lock")
    with locked(lock, f"{path}: another process is writing results there; choose another --out"):
        return _run_missing(path, _open(path, set_name, dict(hashes or {}), files), names, workers, cache, progress)


def _run_missing(
    path: Path, results: Results, names: Sequence[str], workers: int, cache: Path | None, progress: Progress | None
) -> tuple[Results, list[str]]:
    set_name = results.set
    folder = path.with_name(f"{path.stem}-trainings") if cache is None else cache
    missing = [
        (name, task, seed)
        for name, task, seed in product(names, SETS[set_name].tasks(), SETS[set_name].seeds)
        if (name, *task.key, seed) not in results.rows
    ]
    errors: list[str] = []
    with _pool(workers) as run_all:
        untrained = _train_missing(results, missing, folder, run_all, progress, errors)
        runnable = [episode for episode in missing if (episode[0], *episode[1].key[:2]) not in untrained]
        for rows, failures in run_all(run_job, _jobs(set_name, runnable, folder), "episodes", progress, errors):
            errors += failures
            results.add(rows)
            results.save(path)
    results.save(path)
    return results, errors


def check_controllers(names: Sequence[str]) -> dict[str, str]:
    """Check controllers, and return the sha256 of the file of each that is not part of the benchmark.

    Raises:
        UnknownName, InvalidConfig: see `load_controller`.
    """
    from zenostat.agent_sdk.controllers import load_controller

    files: dict[str, str] = {}
    for name in names:
        if is_trained(name):
            import zenostat.lab.training  # noqa: F401  # stable-baselines3 is there
        elif load_controller(name) is BaselineController and name != "baseline":
            raise InvalidConfig(f"{name} is the baseline control: name it 'baseline'")
        elif name not in BASELINES:
            files[name] = _controller_digest(name)
    return files


def _controller_digest(name: str) -> str:
    """Return the sha256 of a controller's file or of a training's model; "" of a module or a bundled controller."""
    algorithm_or_file, _, rest = name.rpartition(":")
    for candidate in (name, rest, algorithm_or_file):
        path = Path(candidate).expanduser()
        if candidate and path.is_dir():
            from zenostat.agent_sdk.controllers.training_folder import model_file

            path = model_file(path)
        if candidate and path.is_file():
            return file_digest(path)
    return ""


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
    if changes := changed_versions(results):
        raise InvalidConfig(f"{path} has rows of other versions ({'; '.join(changes)}): choose another --out")
    for known, now in ((results.hashes, hashes), (results.controllers, files)):
        differing = [name for name in known.keys() & now if known[name] != now[name]]
        if differing:
            raise InvalidConfig(f"{path} has rows of another file {differing[0]}: choose another --out")
        known.update(now)
    return results


RunAll = Callable[[Callable[..., Any], Sequence[Any], str, Progress | None, list[str]], Iterator[Any]]


@contextmanager
def _pool(workers: int) -> Iterator[RunAll]:
    """A function that calls another one with each of some arguments in worker processes, or here if there is one.

    It yields the results as they come, and appends the text of each error to a list.
    """
    with ExitStack() as stack:
        executor: ProcessPoolExecutor | None = None
        if workers > 1:
            executor = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"))
            stack.callback(executor.shutdown, cancel_futures=True)
            stack.push(partial(_end_workers, others=multiprocessing.active_children()))

        def run_all(
            function: Callable[..., Any], items: Sequence[Any], stage: str, progress: Progress | None, errors: list[str]
        ) -> Iterator[Any]:
            outcomes: Iterable[tuple[Any, str]]
            if progress is not None and items:
                progress(stage, 0, len(items))
            if executor is None:
                outcomes = (_attempt(function, item) for item in items)
            else:
                futures = [executor.submit(_attempt, function, item) for item in items]
                outcomes = (_result(future) for future in as_completed(futures))
            for done, (result, error) in enumerate(outcomes, 1):
                if error:
                    errors.append(error)
                else:
                    yield result
                if progress is not None:
                    progress(stage, done, len(items))

        yield run_all


def _end_workers(error: type[BaseException] | None, *_: object, others: Sequence[BaseProcess]) -> None:
    """After an error or a signal, end the workers instead of waiting for their present episodes."""
    if error is not None:
        for process in multiprocessing.active_children():
            if process not in others:
                process.terminate()


def _result(future: Future[tuple[Any, str]]) -> tuple[Any, str]:
    try:
        return future.result()
    except BrokenProcessPool:
        raise SimulatorError(
            "a worker process was killed, perhaps for lack of memory; the same command continues, with fewer workers"
        ) from None


def _attempt(function: Callable[..., Any], item: Any) -> tuple[Any, str]:
    """Return the result of a call, or the text of its error: not all exceptions can be sent to another process."""
    try:
        return function(item), ""
    except Exception as error:
        return None, f"{item}: {describe_error(error)}"


def _train_missing(
    results: Results, missing: Sequence[Episode], cache: Path, run_all: RunAll, progress: Progress | None,
    errors: list[str],
) -> set[tuple[str, str, str]]:  # fmt: skip
    """Train what the missing episodes need; return algorithm, building and season of what could not be trained."""
    needed = dict.fromkeys((name, *task.key[:2]) for name, task, _ in missing if is_trained(name))
    trainings = [Training(cache, results.set, *key) for key in needed]
    for training, hashes in run_all(ensure_trained, trainings, "training", progress, errors):
        key = training.key
        former = results.trainings.get(training.name)
        if former is not None and former["weights"] != hashes["weights"]:
            errors.append(f"{training.name}: trained again, it has other weights than those of the rows in the results")
            continue
        results.trainings[training.name] = hashes
        del needed[key]
    return set(needed)


def _jobs(set_name: str, episodes: Sequence[Episode], cache: Path) -> list[Job]:
    """Return a job for each task; the building of a task is started once for all its episodes."""
    by_task: dict[Task, list[tuple[str, int]]] = {}
    for name, task, seed in episodes:
        by_task.setdefault(task, []).append((name, seed))
    return [Job(set_name, task, tuple(pairs), cache) for task, pairs in by_task.items()]


def check(
    path: Path, selection: Selection | None = None, *, workers: int = 1, cache: Path | None = None,
    progress: Progress | None = None, hashes: Mapping[str, str] | None = None,
) -> list[str]:  # fmt: skip
    """Run the rows of a file again, and return what differs; empty if all rows are equal to the bit.

    Args:
        path: file of the results.
        selection: check only these rows; None: all.
        workers: as of `run_benchmark`.
        cache: as of `run_benchmark`.
        progress: as of `run_benchmark`.
        hashes: as of `run_benchmark`.

    Raises:
        UnknownName, InvalidConfig: see `load_results`; or there are no such rows.
    """
    results = load_results(path)
    chosen = selected_rows(results, selection, str(path))
    files = check_controllers(list(dict.fromkeys(row.controller for row in chosen)))
    differences = [f"version of {change}" for change in changed_versions(results)]
    for known, now in ((results.hashes, hashes or {}), (results.controllers, files)):
        differences += [f"file {name}" for name, digest in now.items() if known.get(name, digest) != digest]
    folder = path.with_name(f"{path.stem}-trainings") if cache is None else cache
    episodes = [(row.controller, row.task, row.seed) for row in chosen]
    again: dict[Any, Row] = {}
    with _pool(workers) as run_all:
        untrained = _train_missing(results, episodes, folder, run_all, progress, differences)
        runnable = [episode for episode in episodes if (episode[0], *episode[1].key[:2]) not in untrained]
        for rows, failures in run_all(run_job, _jobs(results.set, runnable, folder), "episodes", progress, differences):
            differences += failures
            again.update({row.key: row for row in rows})
    return differences + [_difference(row, again.get(row.key)) for row in chosen if again.get(row.key) != row]


def selected_rows(results: Results, selection: Selection | None, what: str) -> list[Row]:
    """Return the selected rows in order; errors as of `Selection.check`."""
    selection, rows = selection or Selection(), results.sorted_rows()
    selection.check([(row.controller, row.task, row.seed) for row in rows], what)
    return [row for row in rows if selection.has(row.controller, row.task, row.seed)]


def _difference(row: Row, again: Row | None) -> str:
    name = "/".join(map(str, row.key))
    if again is None:
        return f"{name}: could not be run again"
    return f"{name}: reward {row.reward!r}, now {again.reward!r}; linear {row.linear!r}, now {again.linear!r}"
