"""Bursts: workers that take turns and are idle in between, so that other load on the machine affects all alike.

A worker is a process of its own, `python -m bench.worker`. It reads bursts from standard input and writes measurements
to standard output.
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

from bench import programs
from bench.machine import OtherLoad, ProcessorTime

_TIMEOUT_S = 300.0
_LEAD_S = 0.05
SKIPPED = 32
"""First steps of a burst, which do not count: the caches contain another worker's data."""


class EndOfBursts(Exception):
    """There are no more bursts."""


@dataclass(frozen=True, slots=True)
class Burst:
    """Length of a burst: `steps`, or until the monotonic clock reaches `until`; steps before `after` do not count."""

    steps: int = 1 << 60
    after: float = 0.0
    until: float = float("inf")


@dataclass(frozen=True, slots=True)
class Measurement:
    """Counted steps of a burst, their duration, and the processor time of the worker and all that it started."""

    steps: int
    seconds: float
    cpu_seconds: float

    @property
    def us(self) -> float:
        """Microseconds per step."""
        return 1e6 * self.seconds / self.steps

    @property
    def cpu_us(self) -> float:
        """Microseconds of processor time per step."""
        return 1e6 * self.cpu_seconds / self.steps


class Pace:
    """The worker's side: `tick()` after each step."""

    def __init__(self) -> None:
        self._burst, self._count = Burst(), 0
        self._from: float | None = None
        self._cpu_from = 0.0
        self._output = os.dup(1)
        os.dup2(2, 1)  # other output of the program goes to standard error

    def begin(self, **about: Any) -> None:
        """Report that it is ready and wait for the first burst; raise `EndOfBursts` if there is none."""
        self._write(about)
        self._wait()

    def tick(self) -> None:
        """Count a step; at the end of a burst, wait for the next one and raise `EndOfBursts` if there are no more."""
        now = time.perf_counter()
        self._count += 1
        if self._from is None:
            if self._count >= SKIPPED and now >= self._burst.after:
                self._from, self._count, self._cpu_from = now, 0, self._cpu.seconds()
        elif self._count >= self._burst.steps or now >= self._burst.until:
            self._write(asdict(Measurement(self._count, now - self._from, self._cpu.seconds() - self._cpu_from)))
            self._wait()

    def _write(self, fields: dict[str, Any]) -> None:
        os.write(self._output, json.dumps(fields).encode() + b"\n")

    def _wait(self) -> None:
        line = sys.stdin.readline()
        if not line:
            raise EndOfBursts
        self._burst, self._count = Burst(**json.loads(line)), 0
        self._from, self._cpu = None, ProcessorTime()


class Worker:
    """A worker that is ready; `with Worker(kind, scene, ...) as worker`.

    Attributes:
        about: fields that the worker reported when it was ready.
        latest: its latest measurement.
    """

    latest: Measurement

    def __init__(self, kind: str, scene: str, env: Mapping[str, str] | None = None, **options: Any) -> None:
        self.title = f"{kind} {scene} {options}"
        self._close = ExitStack()
        folder = tempfile.mkdtemp(prefix="zenostat-bench-")
        self._close.callback(shutil.rmtree, folder, ignore_errors=True)
        self._log = self._close.enter_context((Path(folder) / "log").open("w+"))
        self._process = subprocess.Popen(
            programs.command("worker", kind, scene, json.dumps(options)),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            env={**programs.environment(), "TMPDIR": folder, **(env or {})},
        )
        self._close.callback(self._end)
        try:
            self.about = self._read()
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

    def _read(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        ready, _, _ = select.select([self._process.stdout], [], [], _TIMEOUT_S)
        line = self._process.stdout.readline() if ready else ""
        if not line:
            self._log.seek(0)
            raise RuntimeError(f"{self.title} reported no measurement:\n{self._log.read()[-3000:]}")
        fields: dict[str, Any] = json.loads(line)
        return fields

    def start(self, burst: Burst) -> None:
        """Start a burst; `measurement` waits for its end."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(asdict(burst)) + "\n")
        self._process.stdin.flush()

    def measurement(self) -> Measurement:
        """Return the measurement of the burst."""
        self.latest = Measurement(**self._read())
        return self.latest

    def run(self, burst: Burst) -> Measurement:
        """Run a burst and return its measurement."""
        self.start(burst)
        return self.measurement()


def per_second(workers: Sequence[Worker], seconds: float) -> float:
    """Return the steps per second of all workers together, in simultaneous bursts."""
    begin = time.perf_counter() + _LEAD_S
    for worker in workers:
        worker.start(Burst(after=begin, until=begin + seconds))
    return sum(1e6 / worker.measurement().us for worker in workers)


def rate_of(workers: Sequence[Worker], seconds: float, *, each: int = 1) -> Callable[[], float]:
    """Return a measurement of transitions per second of all workers; a step of a worker has `each` transitions."""
    return lambda: each * per_second(workers, seconds)


@dataclass(frozen=True, slots=True)
class Round:
    """One figure of each kind, measured one after the other, and the other load in the meantime, 0 to 1."""

    figures: dict[str, float]
    other_load: float


def rounds(
    kinds: Mapping[str, Callable[[], float]],
    count: int,
    *,
    settle_s: float = 0.0,
    also: Callable[[], Mapping[str, float]] = dict,
) -> list[Round]:
    """Measure each kind once per round, starting with a different one each time.

    Args:
        kinds: measurements by title.
        count: number of rounds.
        settle_s: pause after each measurement, for processes that have work left.
        also: returns further figures by title at the end of each round.
    """
    results, titles = [], [*kinds]
    for number in range(count):
        load, figures = OtherLoad(), {}
        for title in titles[number % len(titles) :] + titles[: number % len(titles)]:
            figures[title] = kinds[title]()
            time.sleep(settle_s)
        results.append(Round({**figures, **also()}, load.share()))
    return results


def quieter(results: Sequence[Round]) -> list[Round]:
    """Return the half of the rounds with the least other load."""
    return sorted(results, key=lambda result: result.other_load)[: max(1, (len(results) + 1) // 2)]


def figures(results: Sequence[Round], title: str, reference: str | None = None) -> dict[str, float]:
    """Return median and quartiles of one kind, or of its ratio to another, over the quieter half of the rounds."""
    kept = quieter(results)
    return spread([one.figures[title] / (one.figures[reference] if reference else 1.0) for one in kept])


def steps_of(worker: Worker, steps: int, *, less_us: float = 0.0) -> Callable[[], float]:
    """Return a measurement of microseconds per step, less a part of the step that does not count."""
    return lambda: worker.run(Burst(steps=steps)).us - less_us


def other_load(results: Sequence[Round]) -> dict[str, float]:
    """Return median and quartiles of the other load in the quieter half of the rounds, 0 to 1."""
    return spread([result.other_load for result in quieter(results)])


def spread(figures: Sequence[float]) -> dict[str, float]:
    """Return median and quartiles."""
    if len(figures) < 2:
        return {"median": figures[0], "low": figures[0], "high": figures[0]}
    low, median, high = statistics.quantiles(figures, n=4, method="inclusive")
    return {"median": median, "low": low, "high": high}
