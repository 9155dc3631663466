"""Part `vector`: transitions a second of a vector environment, against engines without any exchange."""

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
    """Transitions a second of each kind, and its ratio to the best of the bare engines or to `AsyncVectorEnv`.

    The two comparisons are apart: the more processes a machine holds, the slower are those of many, also where all
    others stand still.
    """
    seconds, count = (0.3, 3) if quick else (2.0, 8)
    with ExitStack() as stack:
        engines = pace.rounds(_of_engines(stack, seconds), count)
    for one in engines:  # the best of the bare engines, round by round
        one.figures[BEST] = max(rate for title, rate in one.figures.items() if title.startswith("bare"))
    with ExitStack() as stack:
        environments = pace.rounds(_of_environments(stack, seconds), count)
    return {"of_bare": _told(engines, BEST), "of_async": _told(environments, ASYNC)}


def _told(found: list[pace.Round], against: str) -> dict[str, Any]:
    titles = [*found[0].figures]
    return {
        "per_second": {title: pace.figures(found, title) for title in titles},
        "ratio": {title: pace.figures(found, title, against) for title in titles},
        "others": pace.others(found),
        "rounds": [one.figures for one in found],
    }


def _of_engines(stack: ExitStack, seconds: float) -> dict[str, Callable[[], float]]:
    cores, kinds = sorted(os.sched_getaffinity(0)), {}
    for count in BARE:  # each with workers of its own: in one that took part in all, the years would end
        bare = [_start(stack, "bare", core=cores[place % len(cores)]) for place in range(count)]
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
    """A table for each of the two comparisons."""
    for which, against in (("of_bare", BEST), ("of_async", ASYNC)):
        found = results[which]
        table = Table("", "transitions/s", f"times {against}", "quartiles", title=f"{SLOTS} slots, {SCENE}")
        for title, rate in found["per_second"].items():
            ratio = found["ratio"][title]
            quartiles = f"{ratio['low']:.2f} to {ratio['high']:.2f}"
            table.add_row(title, f"{rate['median']:.0f}", f"{ratio['median']:.2f}", quartiles)
        console.print(table)
        console.print(f"others took {found['others']['median']:.0%}")
