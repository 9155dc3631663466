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
OURS = "vector environment"
ASYNC, SYNC = "AsyncVectorEnv", "SyncVectorEnv"


def measure(*, quick: bool) -> dict[str, Any]:
    """Transitions a second of each kind, and its ratio to the best of the bare engines and to `AsyncVectorEnv`."""
    seconds, count = (0.3, 3) if quick else (0.5, 16)
    with ExitStack() as stack:
        found = pace.rounds(_kinds(stack, seconds), count)
    bare = [title for title in found[0].figures if title.startswith("bare")]
    for one in found:  # the best of the bare engines, round by round
        one.figures["best bare"] = max(one.figures[title] for title in bare)
    titles = [*found[0].figures]
    return {
        "per_second": {title: pace.figures(found, title) for title in titles},
        "of_bare": {title: pace.figures(found, title, "best bare") for title in titles},
        "of_async": {title: pace.figures(found, title, ASYNC) for title in titles},
        "others": pace.others(found),
        "rounds": [one.figures for one in found],
    }


def _kinds(stack: ExitStack, seconds: float) -> dict[str, Callable[[], float]]:
    cores = sorted(os.sched_getaffinity(0))

    def start(kind: str, **options: Any) -> Worker:
        return stack.enter_context(Worker(kind, SCENE, **options))

    free = [start("bare") for _ in range(max(BARE))]
    pinned = [start("bare", core=cores[place % len(cores)]) for place in range(max(BARE))]
    kinds = {f"bare, {count} free": pace.rate_of(free[:count], seconds) for count in BARE}
    kinds |= {f"bare, {count} pinned": pace.rate_of(pinned[:count], seconds) for count in BARE}
    kinds["engines together, no bus"] = pace.rate_of([start("engines", count=SLOTS)], seconds, each=SLOTS)
    kinds["slots, no environment"] = pace.rate_of([start("slots", count=SLOTS)], seconds, each=SLOTS)
    kinds[OURS] = pace.rate_of([start("vector", count=SLOTS, mode="vector_entry_point")], seconds, each=SLOTS)
    kinds[ASYNC] = pace.rate_of([start("vector", count=SLOTS, mode="async")], seconds, each=SLOTS)
    kinds[SYNC] = pace.rate_of([start("vector", count=SLOTS, mode="sync")], seconds, each=SLOTS)
    return kinds


def show(results: dict[str, Any], console: Console) -> None:
    """A table."""
    table = Table("", "transitions/s", "of the best bare", "times async", title=f"{SLOTS} slots, {SCENE}")
    for title, rate in results["per_second"].items():
        bare, of = results["of_bare"][title], results["of_async"][title]
        cells = (f"{bare['median']:.0%} ({bare['low']:.0%}-{bare['high']:.0%})", f"{of['median']:.2f}")
        table.add_row(title, f"{rate['median']:.0f}", *cells)
    console.print(table)
    console.print(f"others took {results['others']['median']:.0%}")
