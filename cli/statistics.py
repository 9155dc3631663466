"""Table of a node's latency statistics."""

from __future__ import annotations

from collections.abc import Sequence

from zenostat.cli.console import out
from zenostat.cli.tables import show
from zenostat.topics.messages import ControllerStatus, LatencySummary, Statistics


def show_statistics(statistics: Statistics, controllers: Sequence[ControllerStatus]) -> None:
    """Print a table of durations in milliseconds, and message and overrun counts below it; see docs/time.md."""
    latencies = {"step": statistics.step, "cycle": statistics.cycle}
    latencies |= {f"response of {controller.controller}": controller.response for controller in controllers}
    rows = [(name, str(latency.count), *milliseconds(latency)) for name, latency in latencies.items()]
    numbers = ("count", "median (ms)", "p99 (ms)", "max (ms)")
    show("", ("duration", *numbers), rows, right=numbers, wrap=("duration",))
    out.print(_counts(statistics))


def milliseconds(latency: LatencySummary) -> tuple[str, str, str]:
    """Format median, 99th percentile and maximum with three digits; dashes if there is no measurement."""
    if not latency.count:
        return "-", "-", "-"
    median, p99, maximum = (
        f"{ms:.3g}" if ms < 999.5 else f"{ms:,.0f}" for ms in (latency.median_ms, latency.p99_ms, latency.max_ms)
    )
    return median, p99, maximum


def _counts(statistics: Statistics) -> str:
    names = ("late", "rejected", "duplicate", "rate_limited", "missed", "overruns")
    lag = f" (at most {statistics.max_lag_s:.3g} s behind)" if statistics.overruns else ""
    late = f", {statistics.accepted_late} accepted late" if statistics.accepted_late else ""
    return ", ".join(f"{getattr(statistics, name)} {name.replace('_', ' ')}" for name in names) + lag + late
