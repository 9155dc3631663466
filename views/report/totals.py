"""Totals of each controller, and differences to the reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isfinite

from zenostat.metrics.kpis import KPIS
from zenostat.metrics.statistics import MetricSummary, summarize
from zenostat.views.report.figures.energy import fuel_label
from zenostat.views.report.runs import Comparison, Run

KELVIN_HOURS = "K\N{NO-BREAK SPACE}h"
EQUAL_PERCENT = 0.05
"""Differences below this are called equal."""
_MAX_PERCENT = 1e4
"""Larger differences in percent say nothing."""


@dataclass(frozen=True, slots=True)
class Metric:
    """A metric as a report names it; `sign` is -1 if lower is better, 1 if higher is, 0 if neither."""

    key: str
    label: str
    unit: str = ""
    sign: int = -1
    is_part: bool = False


@dataclass(frozen=True, slots=True)
class Difference:
    """Difference of a controller's metric to that of the reference, mean over the episodes.

    Attributes:
        mean: mean of the differences.
        percent: the same in percent of the reference; None if that is zero, or nearly zero beside the difference.
        half_width: half of the 95 % confidence interval of the mean, from the differences of the same episodes;
            None for one episode, or for episodes of other weather or seeds.
        verdict: `better`, `worse`, `equal`, `unclear` (the interval contains zero), or "" where neither is better or
            the episodes differ in length, weather or seeds.
    """

    mean: float
    percent: float | None
    half_width: float | None
    verdict: str


_COMMON = (
    Metric("site_kwh_m2", "Site energy per floor area", "kWh/m²"),
    Metric("electricity_produced_kwh", "Electricity produced", "kWh", 1),
    Metric("electricity_purchased_kwh", "Electricity purchased", "kWh"),
    Metric("electricity_sold_kwh", "Electricity sold", "kWh", 0),
    Metric("peak_kw", "Peak power", "kW"),
    Metric("peak_purchased_kw", "Peak of purchased power", "kW"),
    Metric("unmet_heating_h", "Heating setpoint unmet, occupied", "h"),
    Metric("unmet_cooling_h", "Cooling setpoint unmet, occupied", "h"),
    Metric("occupied_outside_kh", "Outside comfort, occupied", KELVIN_HOURS),
    Metric("outside_kh", "Outside comfort, always", KELVIN_HOURS),
    Metric("outside_percent", "Time with any zone outside", "%"),
    Metric("mean_deviation_k", "Mean deviation from comfort", "K"),
)
_COUNTS = (Metric("late", "Late messages"), Metric("rejected", "Rejected messages"))


def metrics(comparison: Comparison) -> list[Metric]:
    """Return the metrics that at least one run has, in the order of the totals."""
    known = dict.fromkeys(
        name for run in comparison.runs for result in run.results for name, value in result.metrics().items()
        if value is not None
    )  # fmt: skip
    rows = _energies(comparison)
    rows += [metric for metric in _COMMON if metric.key in known]
    if _is_year(comparison):
        rows = [replace(row, unit="kWh/m² a year") if row.key == "site_kwh_m2" else row for row in rows]
    if "reward" in known:
        rows.append(Metric("reward", "Reward", "", 1))
        terms = [name for name in known if name.startswith("reward.")]
        rows += [
            Metric(name, f"of which {name[7:].replace('_', ' ')}", "", 1, is_part=True)
            for name in terms
            if len(terms) > 1
        ]
    if not all(has_equal_lengths(run, comparison.reference) for run in comparison.runs):
        rows.append(Metric("steps", "Timesteps", "", 0))
    return rows + [
        metric for metric in _COUNTS if any(_values(run, metric.key, any_zero=False) for run in comparison.runs)
    ]


def _is_year(comparison: Comparison) -> bool:
    """Whether all episodes are a year long, so that energy per floor area is an energy use intensity."""
    return all(364.0 <= run.trajectory.steps * run.trajectory.step_h / 24.0 <= 366.0 for run in comparison.runs)


def _energies(comparison: Comparison) -> list[Metric]:
    """Return the metrics of each fuel and of the HVAC's part of it, without fuels that are never used."""
    results = [result for run in comparison.runs for result in run.results]
    fuels = dict.fromkeys(fuel for result in results for fuel in ("electricity", *result.energy_kwh, *result.hvac_kwh))
    rows = []
    for fuel in fuels:
        whole, part = (
            any(_values(run, key, any_zero=fuel == "electricity") for run in comparison.runs)
            for key in (f"{fuel}_kwh", f"hvac_{fuel}_kwh")
        )
        if whole:
            rows.append(Metric(f"{fuel}_kwh", fuel_label(fuel).capitalize(), "kWh"))
        if part or (whole and any(fuel in result.hvac_kwh for result in results)):
            label = "of which HVAC" if whole else f"HVAC {fuel_label(fuel)}"
            rows.append(Metric(f"hvac_{fuel}_kwh", label, "kWh", is_part=whole))
    return rows


def kpis(comparison: Comparison) -> list[Metric]:
    """Return the key performance indicators that at least one run has; air quality only where it is ever poor."""
    return [
        Metric(f"kpi.{name}", f"{label[:1].upper()}{label[1:]} ({name})", unit.replace(" ", "\N{NO-BREAK SPACE}"))
        for name, (label, unit) in KPIS.items()
        if any(_values(run, f"kpi.{name}", any_zero=name != "idis_tot") for run in comparison.runs)
    ]


def _values(run: Run, key: str, *, any_zero: bool = True) -> list[float]:
    values = [result.metrics().get(key) for result in run.results]
    if any(value is None for value in values):
        return []
    numbers = [float(value) for value in values if value is not None]
    return numbers if any_zero or any(numbers) else []


def total(run: Run, key: str) -> MetricSummary | None:
    """Return the statistics of a metric over a run's episodes; None if an episode lacks it, or values for it."""
    values = _values(run, key)
    return summarize(values) if values and all(map(isfinite, values)) else None


def difference(run: Run, reference: Run, metric: Metric) -> Difference | None:
    """Return the difference of a metric to the reference; None if one of them lacks it, or values for it."""
    values, others = _values(run, metric.key), _values(reference, metric.key)
    if not values or len(values) != len(others) or not all(map(isfinite, (*values, *others))):
        return None
    summary = summarize([value - other for value, other in zip(values, others, strict=True)])
    base = sum(others) / len(others)
    percent = 100.0 * summary.mean / abs(base) if base else None
    if percent is not None and abs(percent) > _MAX_PERCENT:
        percent = None
    is_paired = has_equal_conditions(run, reference)
    sign = metric.sign if is_paired and has_equal_lengths(run, reference) else 0
    half_width = summary.half_width if is_paired else None
    return Difference(summary.mean, percent, half_width, _verdict(summary, percent, sign))


def has_equal_lengths(run: Run, reference: Run) -> bool:
    """Whether the episodes of two runs have as many timesteps; totals of others do not compare."""
    return [result.steps for result in run.results] == [result.steps for result in reference.results]


def has_equal_conditions(run: Run, reference: Run) -> bool:
    """Whether the episodes of two runs have the same weather and seeds, in the same order."""
    return (run.seeds, run.weather_names) == (reference.seeds, reference.weather_names)


def _verdict(summary: MetricSummary, percent: float | None, sign: int) -> str:
    if summary.mean == 0.0 or (percent is not None and abs(percent) < EQUAL_PERCENT):
        return "equal"
    if sign == 0:
        return ""
    if summary.interval is not None and summary.interval[0] <= 0.0 <= summary.interval[1]:
        return "unclear"
    return "better" if summary.mean * sign > 0 else "worse"


def number(value: float, digits: int | None = None) -> str:
    """Return a number with about four significant digits and a minus sign."""
    size = abs(value)
    if abs(value - round(value)) < 1e-9 * size:  # of rounding
        value = float(round(value))
    if digits is None:
        digits = (
            0
            if size >= 1000 or value == int(value)
            else 1
            if size >= 100
            else 2
            if size >= 1
            else 3
            if size >= 0.1
            else 4
        )
    text = f"{value:,.{digits}f}".replace("-", "\N{MINUS SIGN}")
    if any(digit in text for digit in "123456789"):
        return text
    return "\N{ALMOST EQUAL TO}\N{NO-BREAK SPACE}0" if value else "0"


def kelvin_hours(value: float) -> str:
    """Return a number of degree-hours with its unit, which no line break separates."""
    return f"{number(value)}\N{NO-BREAK SPACE}{KELVIN_HOURS}"


def signed(value: float, digits: int | None = None) -> str:
    """Return a difference with its sign."""
    text = number(value, digits)
    return f"+{text}" if value > 0 and text[0].isdigit() and text != "0" else text


def names(items: Sequence[str]) -> str:
    """Return names as an enumeration: `a, b and c`."""
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}" if items else ""
