"""Table of a node's latency statistics."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table

from zenostat.topics.messages import ControllerStatus, LatencySummary, Statistics


def statistics_table(statistics: Statistics, controllers: Sequence[ControllerStatus]) -> Table:
    """Return a table of durations in milliseconds, with message and overrun counts below it; see docs/time.md."""
    table = Table("", "count", "median (ms)", "p99 (ms)", "max (ms)", caption=_counts(statistics))
    table.columns[0].overflow = "fold"  # never truncate a controller's name
    for column in table.columns[1:]:
        column.justify = "right"
    for name, latency in (("step", statistics.step), ("cycle", statistics.cycle)):
        table.add_row(name, *_cells(latency))
    for controller in controllers:
        table.add_row(f"response of {controller.controller}", *_cells(controller.response))
    return table


def _cells(latency: LatencySummary) -> tuple[str, ...]:
    return str(latency.count), *milliseconds(latency)


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
