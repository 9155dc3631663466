"""Bursts: workers that stand still between them take turns, so that whatever else the machine does falls on all.

A worker is a process of its own, `python -m bench.worker`; it is told on its standard input how far to go and says on
its standard output what it took.
"""

from __future__ import annotations

import json
import os
import select
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bench.machine import Others

_PATIENCE_S = 300.0
_SOON_S = 0.05
SKIPPED = 32
"""First steps of a burst that do not count: the caches are another worker's."""


class Over(Exception):
    """No more bursts are wanted."""


@dataclass(frozen=True, slots=True)
class Burst:
    """How far to go: `steps`, or as far as the monotonic clock is at `until`; what is before `after` does not count."""

    steps: int = 1 << 60
    after: float = 0.0
    until: float = float("inf")


@dataclass(frozen=True, slots=True)
class Took:
    """What was counted of a burst: steps and seconds."""

    steps: int
    seconds: float

    @property
    def us(self) -> float:
        """Microseconds a step."""
        return 1e6 * self.seconds / self.steps


class Pace:
    """The worker's side: `tick()` after each step."""

    def __init__(self) -> None:
        self._burst, self._count = Burst(), 0
        self._from: float | None = None
        self._answers = os.dup(1)
        os.dup2(2, 1)  # whatever else a program prints

    def begin(self, **about: Any) -> None:
        """Says that it is ready and waits for the first burst; `Over` if there is none."""
        self._say(about)
        self._wait()

    def tick(self) -> None:
        """A step is done; waits where a burst is. `Over` if there are no more."""
        now = time.perf_counter()
        self._count += 1
        if self._from is None:
            if self._count >= SKIPPED and now >= self._burst.after:
                self._from, self._count = now, 0
        elif self._count >= self._burst.steps or now >= self._burst.until:
            self._say(asdict(Took(self._count, now - self._from)))
            self._wait()

    def _say(self, what: dict[str, Any]) -> None:
        os.write(self._answers, json.dumps(what).encode() + b"\n")

    def _wait(self) -> None:
        line = sys.stdin.readline()
        if not line:
            raise Over
        self._burst, self._count = Burst(**json.loads(line)), 0
        self._from = None


class Worker:
    """A worker that stands ready; `with Worker(kind, scene, ...) as worker`.

    Attributes:
        about: what it said of itself.
    """

    def __init__(self, kind: str, scene: str, env: Mapping[str, str] | None = None, **options: Any) -> None:
        self.title = f"{kind} {scene} {options}"
        self._close = ExitStack()
        folder = tempfile.mkdtemp(prefix="zenostat-bench-")
        self._close.callback(shutil.rmtree, folder, ignore_errors=True)
        self._log = self._close.enter_context((Path(folder) / "log").open("w+"))
        self._process = subprocess.Popen(
            [sys.executable, "-m", "bench.worker", kind, scene, json.dumps(options)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            env={**os.environ, "TMPDIR": folder, "PYTHONPATH": str(Path(__file__).parents[1]), **(env or {})},
        )
        self._close.callback(self._end)
        try:
            self.about = self._answer()
        except BaseException:
            self._close.close()
            raise

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self._close.close()

    def _end(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            self._process.wait(30)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        ready, _, _ = select.select([self._process.stdout], [], [], _PATIENCE_S)
        line = self._process.stdout.readline() if ready else ""
        if not line:
            self._log.seek(0)
            raise RuntimeError(f"{self.title} gave no figure:\n{self._log.read()[-3000:]}")
        said: dict[str, Any] = json.loads(line)
        return said

    def go(self, burst: Burst) -> None:
        """Tells it to go; `took` waits."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(asdict(burst)) + "\n")
        self._process.stdin.flush()

    def took(self) -> Took:
        """What the burst took."""
        return Took(**self._answer())

    def run(self, burst: Burst) -> Took:
        """A burst of its own."""
        self.go(burst)
        return self.took()


def per_second(workers: Sequence[Worker], seconds: float) -> float:
    """Steps a second of all workers together, in a burst at the same time."""
    begin = time.perf_counter() + _SOON_S
    for worker in workers:
        worker.go(Burst(after=begin, until=begin + seconds))
    return sum(1e6 / worker.took().us for worker in workers)


def rate_of(workers: Sequence[Worker], seconds: float, *, each: int = 1) -> Callable[[], float]:
    """Measures transitions a second of all together; `each`: how many a step of one worker is."""
    return lambda: each * per_second(workers, seconds)


@dataclass(frozen=True, slots=True)
class Round:
    """One figure of each kind, measured one after the other, and what others took of the cores meanwhile."""

    figures: dict[str, float]
    others: float


def rounds(kinds: Mapping[str, Callable[[], float]], count: int, *, settle_s: float = 0.0) -> list[Round]:
    """Measures each kind once a round, beginning with another one each time.

    Args:
        kinds: measures one by its title.
        settle_s: pause after each, for those whose processes have something left to do.
    """
    found, titles = [], [*kinds]
    for number in range(count):
        others, figures = Others(), {}
        for title in titles[number % len(titles) :] + titles[: number % len(titles)]:
            figures[title] = kinds[title]()
            time.sleep(settle_s)
        found.append(Round(figures, others.share()))
    return found


def quieter(found: Sequence[Round]) -> list[Round]:
    """The half of the rounds in which others took least."""
    return sorted(found, key=lambda one: one.others)[: max(1, (len(found) + 1) // 2)]


def figures(found: Sequence[Round], of: str, against: str | None = None) -> dict[str, float]:
    """Median and quartiles of one kind over the quieter half of the rounds; of its ratio to another one's."""
    kept = quieter(found)
    return spread([one.figures[of] / (one.figures[against] if against else 1.0) for one in kept])


def steps_of(worker: Worker, steps: int) -> Callable[[], float]:
    """Measures microseconds a step."""
    return lambda: worker.run(Burst(steps=steps)).us


def others(found: Sequence[Round]) -> dict[str, float]:
    """What others took in the rounds that are counted, 0 to 1."""
    return spread([one.others for one in quieter(found)])


def spread(figures: Sequence[float]) -> dict[str, float]:
    """Median and quartiles."""
    if len(figures) < 2:
        return {"median": figures[0], "low": figures[0], "high": figures[0]}
    low, median, high = statistics.quantiles(figures, n=4, method="inclusive")
    return {"median": median, "low": low, "high": high}
