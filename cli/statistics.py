"""How a node kept up, as a table."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table

from topics.messages import ControllerStatus, LatencySummary, Statistics


def table(statistics: Statistics, controllers: Sequence[ControllerStatus]) -> Table:
    """Durations in milliseconds, the messages that changed nothing, and what came too late; see docs/time.md."""
    made = Table("", *(one for one in ("times", "median (ms)", "p99 (ms)", "max (ms)")), caption=_counts(statistics))
    made.columns[0].overflow = "fold"  # a controller's name stands whole
    for column in made.columns[1:]:
        column.justify = "right"
    for name, spread in (("step", statistics.step), ("cycle", statistics.cycle)):
        made.add_row(name, *_cells(spread))
    for controller in controllers:
        made.add_row(f"response of {controller.controller}", *_cells(controller.response))
    return made


def _cells(spread: LatencySummary) -> tuple[str, ...]:
    return str(spread.count), *milliseconds(spread)


def milliseconds(spread: LatencySummary) -> tuple[str, str, str]:
    """Median, 99th percentile and maximum, to three digits; dashes where nothing was counted."""
    if not spread.count:
        return "-", "-", "-"
    median, high, most = (
        f"{ms:.3g}" if ms < 999.5 else f"{ms:,.0f}" for ms in (spread.median_ms, spread.p99_ms, spread.max_ms)
    )
    return median, high, most


def _counts(statistics: Statistics) -> str:
    names = ("late", "rejected", "duplicate", "rate_limited", "missed", "overruns")
    behind = f" ({statistics.max_lag_s:.3g} s behind at worst)" if statistics.overruns else ""
    taken = f", {statistics.accepted_late} accepted late" if statistics.accepted_late else ""
    return ", ".join(f"{getattr(statistics, name)} {name.replace('_', ' ')}" for name in names) + behind + taken
