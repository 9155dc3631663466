"""Table of episode metrics that `zenostat demo` and `zenostat run` print."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from zenostat.cli.tables import show

if TYPE_CHECKING:
    from zenostat.metrics.episode_metrics import EpisodeMetrics

_NOT_MEASURED = "not measured"


def show_results(results: Mapping[str, tuple[EpisodeMetrics, float]], title: str) -> None:
    """Print energy, peak power, comfort and timesteps per second, with one column for each key of `results`.

    A quantity that no node measures is left out.
    """
    pairs = list(results.values())
    rows = {
        "electricity (kWh)": [_number(r.energy_kwh.get("electricity"), 0) for r, _ in pairs],
        "  electricity of the HVAC (kWh)": [_number(r.hvac_electricity_kwh, 0) for r, _ in pairs],
        "gas (kWh)": [_number(r.energy_kwh.get("natural_gas"), 0) for r, _ in pairs],
        "  gas of the HVAC (kWh)": [_number(r.hvac_kwh.get("natural_gas"), 0) for r, _ in pairs],
        "peak (kW)": [_number(r.peak_kw, 1) for r, _ in pairs],
        "outside comfort, occupied (K h)": [_number(r.occupied_outside_kh, 1) for r, _ in pairs],
        "outside comfort, always (K h)": [_number(r.outside_kh, 1) for r, _ in pairs],
        **{
            f"{text} ({unit})": [_number(r.kpis.get(name), 4) for r, _ in pairs]
            for name, (text, unit) in _kpis().items()
        },
        "timesteps": [f"{r.steps}" for r, _ in pairs],
        "timesteps/s": [f"{rate:,.0f}" for _, rate in pairs],
        "late, rejected messages": [f"{r.late}, {r.rejected}" for r, _ in pairs],
    }
    cells = [(name, *values) for name, values in rows.items() if {*values} != {_NOT_MEASURED}]
    show(title, ("", *results), cells, right=tuple(results), wrap=("", *results))


def _kpis() -> dict[str, tuple[str, str]]:
    """Return the KPIs of energy; comfort and air quality have rows of their own, or are rarely measured."""
    from zenostat.metrics.kpis import KPIS

    return {name: text for name, text in KPIS.items() if name not in ("tdis_tot", "idis_tot")}


def _number(value: float | None, digits: int) -> str:
    return _NOT_MEASURED if value is None else f"{value:,.{digits}f}"
