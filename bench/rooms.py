"""Part `rooms`: cost of a paced step with the control room and three browsers open, beside the step without.

Between them is the step with the control room and three programs that read what the browsers would draw.

`python -m bench.rooms --minutes 30` measures instead whether the memory of the control room and of a page grows.
Both need playwright and the system's Chromium.
"""

from __future__ import annotations

import argparse
import importlib.util
import shutil
import statistics
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import psutil
from rich.console import Console
from rich.table import Table

import zenostat
from bench import pace, scenes
from bench.programs import started
from zenostat.bridge.client.local_node import LocalNode
from zenostat.bridge.runtime.affinity import Affinity

SCENE = "five-zone"
BROWSERS = 3
STEPS_PER_S = 20
STEPS = 400
"""Timesteps of a measurement, on a node of its own."""

_ARGUMENTS = ("--no-sandbox", "--headless", "--disable-gpu", "--disable-background-networking", "--no-first-run")
_ROOM = ("room", "--address", "127.0.0.1:0", "--operator", "bench")
_SAMPLE_S = 10.0
_IDLE = f"{Path(__file__).with_name('idle_class.py')}:Idle"


def _chromium() -> str | None:
    """Return the path of the system's Chromium; None if it or playwright is missing."""
    if importlib.util.find_spec("playwright") is None:
        return None
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@contextmanager
def _node(settings: dict[str, Any]) -> Iterator[LocalNode]:
    node = LocalNode(settings, Affinity.SEPARATE_CORES)
    try:
        yield node
    finally:
        node.close()


def _paced(*bus: str) -> dict[str, Any]:
    """Return the settings of a node whose timesteps are due `STEPS_PER_S` times a second, on a bus."""
    speed = 900.0 * STEPS_PER_S
    pacing = {"name": "bench", "mode": "paced", "speed": speed, "monitoring": True, "connect": [*bus]}
    return {**scenes.settings(SCENE), **pacing}


@contextmanager
def _room(endpoint: str) -> Iterator[tuple[psutil.Process, str]]:
    """Run the control room; yield its process and the link of the first browser."""
    with started(*_ROOM, "--connect", endpoint) as (pid, line):
        yield psutil.Process(pid), line.removeprefix("ready: ").strip()


@contextmanager
def _pages(link: str, count: int) -> Iterator[list[Any]]:
    """Open the list of nodes in so many browsers, each with its own session."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=_chromium(), args=[*_ARGUMENTS])
        pages: list[Any] = []
        for _ in range(count):
            page = browser.new_context(viewport={"width": 1280, "height": 900}).new_page()
            page.goto(link)
            page.locator(".card").first.wait_for()
            request = {
                "method": "POST",
                "headers": {"content-type": "application/json"},
                "body": '{"operator":"bench"}',
            }
            link = page.evaluate("r => fetch('/api/invitation', r).then(a => a.json())", request)["link"]
            pages.append(page)
        yield pages
        browser.close()


@contextmanager
def _readers(link: str, count: int) -> Iterator[None]:
    """Read the stream of the node's page in so many threads, which draw nothing."""
    import httpx

    base, _, token = link.partition("/#token=")
    with ExitStack() as stack:
        client = stack.enter_context(httpx.Client(base_url=base, headers={"origin": base}, timeout=None))
        client.post("/api/session", json={"token": token}).raise_for_status()
        streams = [client.stream("GET", "/api/stream?node=bench") for _ in range(count)]
        answers = [stack.enter_context(stream) for stream in streams]

        def read(answer: Any) -> None:
            with suppress(httpx.HTTPError, RuntimeError):  # it is closed at the end
                for _ in answer.iter_raw():
                    pass

        for answer in answers:
            threading.Thread(target=read, args=(answer,), daemon=True).start()
        yield


def _show_node(page: Any, link: str) -> None:
    page.goto(f"{link.partition('/#')[0]}/?node=bench")
    page.locator(".trend-panel canvas").wait_for()


def _step_us(bus: zenostat.Bus, wait: Callable[[float], object] = time.sleep) -> float:
    """Return the median duration of the first timesteps of a node in microseconds."""
    while (step := bus.status("bench").statistics.step).count < STEPS:
        wait(0.5)
    return 1e3 * step.median_ms


def measure(*, quick: bool) -> dict[str, Any]:
    """Return microseconds per step without and with the control room, and their ratio."""
    if _chromium() is None:
        return {"skipped": "playwright or Chromium is missing"}
    with _node({"plant": _IDLE, "name": "hub"}) as hub, zenostat.connect(hub.endpoint, affinity=Affinity.OFF) as bus:
        bus.pause("hub")

        def without_room() -> float:
            with _node(_paced(hub.endpoint)):
                return _step_us(bus)

        def with_readers() -> float:
            with _room(hub.endpoint) as (_, link), _readers(link, BROWSERS), _node(_paced(hub.endpoint)):
                return _step_us(bus)

        def with_room() -> float:
            with _room(hub.endpoint) as (_, link), _pages(link, BROWSERS) as pages, _node(_paced(hub.endpoint)):
                for page in pages:
                    _show_node(page, link)
                # The browsers are driven while the steps are simulated.
                return _step_us(bus, lambda seconds: pages[0].wait_for_timeout(1000 * seconds))

        phases = {"without": without_room, "read": with_readers, "with": with_room}
        rounds = pace.rounds(phases, 2 if quick else 9, settle_s=0.5)
    return {
        "us": {title: pace.figures(rounds, title) for title in phases},
        "ratios": {title: pace.figures(rounds, title, "without") for title in ("read", "with")},
        "others": pace.other_load(rounds),
    }


def show(results: dict[str, Any], console: Console) -> None:
    """Print a table."""
    if "skipped" in results:
        console.print(f"rooms: skipped, {results['skipped']}")
        return
    table = Table("", "µs per step", "ratio", title=f"{SCENE}, {STEPS_PER_S} paced steps/s")
    names = {"without": "alone", "read": f"with {BROWSERS} readers", "with": f"with {BROWSERS} browsers"}
    for title, name in names.items():
        ratio = results["ratios"].get(title)
        spread = f"{ratio['median']:.2f} ({ratio['low']:.2f}-{ratio['high']:.2f})" if ratio else ""
        table.add_row(name, f"{results['us'][title]['median']:.0f}", spread)
    console.print(table)


def measure_memory(minutes: float, report: Callable[..., object] = lambda **_: None) -> dict[str, Any]:
    """Return the memory of the control room and of a page over time, and their growth in MB per hour.

    Growth is the slope of a line through the second half of the samples: caches and histories fill in the first one.
    """
    samples: list[dict[str, float]] = []
    with _node(_paced()) as node, _room(node.endpoint) as (process, link), _pages(link, 1) as (page,):
        _show_node(page, link)
        tools = page.context.new_cdp_session(page)
        begin = time.monotonic()
        while (elapsed_s := time.monotonic() - begin) < 60.0 * minutes:
            tools.send("HeapProfiler.collectGarbage")
            heap = tools.send("Runtime.getHeapUsage")["usedSize"]
            sample = {"s": elapsed_s, "room_mb": process.memory_info().rss / 1e6, "page_mb": heap / 1e6}
            samples.append(sample)
            report(**sample)
            page.wait_for_timeout(1000.0 * _SAMPLE_S)
    later = samples[len(samples) // 2 :]
    hours = [sample["s"] / 3600.0 for sample in later]
    growth = {
        name: statistics.linear_regression(hours, [sample[name] for sample in later]).slope if len(later) > 1 else 0.0
        for name in ("room_mb", "page_mb")
    }
    return {"samples": samples, "mb_per_hour": growth}


def main() -> None:
    """Measure the growth of memory, and print it."""
    parser = argparse.ArgumentParser(prog="python -m bench.rooms", description=measure_memory.__doc__)
    parser.add_argument("--minutes", type=float, default=30.0, help="duration; default 30")
    console, minutes = Console(), parser.parse_args().minutes
    if _chromium() is None:
        parser.error("playwright or Chromium is missing")
    results = measure_memory(
        minutes, lambda s, room_mb, page_mb: console.print(f"{s:6.0f} s: room {room_mb:.1f} MB, page {page_mb:.1f} MB")
    )
    growth = results["mb_per_hour"]
    console.print(f"growth: room {growth['room_mb']:+.1f} MB/h, page {growth['page_mb']:+.1f} MB/h")


if __name__ == "__main__":
    main()
