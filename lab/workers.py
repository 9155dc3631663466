"""Run a function with many arguments in worker processes."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from functools import partial
from multiprocessing.process import BaseProcess
from typing import Any

from zenostat.topics.errors import SimulatorError, ZenostatError

Progress = Callable[[str, int, int], None]
"""Callback with the stage (`training`, `episodes`), the number of finished items (first 0) and of all."""

RunAll = Callable[[Callable[..., Any], Sequence[Any], str, Progress | None, list[str]], Iterator[Any]]


@contextmanager
def worker_pool(workers: int) -> Iterator[RunAll]:
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


def describe_error(error: Exception) -> str:
    """Return the text of an error of the product, and the type too of any other one."""
    return str(error) if isinstance(error, ZenostatError) else f"{type(error).__name__}: {error}"
