"""Part `vector`: transitions per second of a vector environment, compared with bare engines and with Gymnasium's."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from rich.console import Console
from rich.table import Table

from bench import pace
from bench.pace import Worker

SCENE = "five-zone"
SLOTS = 8
BARE = (2, 4, 8)
OURS, BEST = "vector environment", "best bare"
ASYNC, SYNC = "AsyncVectorEnv", "SyncVectorEnv"


def measure(*, quick: bool) -> dict[str, Any]:
    """Return transitions per second of each kind, and the ratio to the best bare engines or to `AsyncVectorEnv`.

    The two comparisons run one after the other: kinds with many processes get slower the more processes there are, even
    if these are idle.
    """
    seconds, count = (0.3, 3) if quick else (2.0, 8)
    with ExitStack() as stack:
        engines = pace.rounds(_of_engines(stack, seconds), count)
    for result in engines:  # the best bare engines of each round
        result.figures[BEST] = max(rate for title, rate in result.figures.items() if title.startswith("bare"))
    with ExitStack() as stack:
        environments = pace.rounds(_of_environments(stack, seconds), count)
    return {"of_bare": _summary(engines, BEST), "of_async": _summary(environments, ASYNC)}


def _summary(rounds: list[pace.Round], reference: str) -> dict[str, Any]:
    titles = [*rounds[0].figures]
    return {
        "per_second": {title: pace.figures(rounds, title) for title in titles},
        "ratio": {title: pace.figures(rounds, title, reference) for title in titles},
        "others": pace.other_load(rounds),
        "rounds": [result.figures for result in rounds],
    }


def _of_engines(stack: ExitStack, seconds: float) -> dict[str, Callable[[], float]]:
    cores, kinds = sorted(os.sched_getaffinity(0)), {}
    for count in BARE:  # with workers of their own: shared ones would reach the end of the run period
        bare = [_start(stack, "bare", core=cores[index % len(cores)]) for index in range(count)]
        kinds[f"bare, {count}"] = pace.rate_of(bare, seconds)
    kinds["engines together, no bus"] = pace.rate_of([_start(stack, "engines", count=SLOTS)], seconds, each=SLOTS)
    kinds["slots, no environment"] = pace.rate_of([_start(stack, "slots", count=SLOTS)], seconds, each=SLOTS)
    return kinds | {OURS: _vector(stack, seconds, "vector_entry_point")}


def _of_environments(stack: ExitStack, seconds: float) -> dict[str, Callable[[], float]]:
    modes = {OURS: "vector_entry_point", ASYNC: "async", SYNC: "sync"}
    return {title: _vector(stack, seconds, mode) for title, mode in modes.items()}


def _vector(stack: ExitStack, seconds: float, mode: str) -> Callable[[], float]:
    return pace.rate_of([_start(stack, "vector", count=SLOTS, mode=mode)], seconds, each=SLOTS)


def _start(stack: ExitStack, kind: str, **options: Any) -> Worker:
    return stack.enter_context(Worker(kind, SCENE, **options))


def show(results: dict[str, Any], console: Console) -> None:
    """Print a table for each of the two comparisons."""
    for key, reference in (("of_bare", BEST), ("of_async", ASYNC)):
        result = results[key]
        table = Table("", "transitions/s", f"ratio to {reference}", "quartiles", title=f"{SLOTS} slots, {SCENE}")
        for title, rate in result["per_second"].items():
            ratio = result["ratio"][title]
            quartiles = f"{ratio['low']:.2f} to {ratio['high']:.2f}"
            table.add_row(title, f"{rate['median']:.0f}", f"{ratio['median']:.2f}", quartiles)
        console.print(table)
        console.print(f"other load {result['others']['median']:.0%}")
