"""The section of a district: balances of energy and of connections, and the comfort in each of its buildings."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from zenostat.metrics.district_balance import (
    CarrierBalance,
    connection_balances,
    district_balances,
    plant_names,
    plant_trajectory,
)
from zenostat.views.report.document import note_block
from zenostat.views.report.quantities import Quantities
from zenostat.views.report.runs import Comparison, Run
from zenostat.views.report.totals import number
from zenostat.views.report.totals_section import NONE

ANCHOR, TITLE = "district", "District"
_ENERGIES = ("supplied", "consumed", "exported", "lost", "stored")
_EXCHANGED = ("sent", "received", "clipped", "resampled", "residual", "stored")
_CONNECTION_NOTES = (
    "Means over the run in the unit of the target. Sent = received + clipped + resampled + residual + stored: what "
    "limits cut off, what the conversion of timesteps changes, what a solved loop leaves open, what a delay holds. The "
    "closure is what is missing of that, relative to what was sent."
)
_NOTES = (
    "Energies in kWh. Supplied = consumed + exported + lost + stored; the closure is what is missing of that, relative "
    "to the supply, 0 but for rounding. Vehicles are part of the consumption of a grid, and losses of batteries part "
    "of what is stored. Of buildings, only the consumption is measured; what a grid delivers to them is in both rows."
)


def has_district(comparison: Comparison) -> bool:
    """Return whether the runs are of a district."""
    return bool(plant_names(comparison.reference.trajectory.manifest))


def district_section(comparison: Comparison) -> str:
    """Return the section as HTML; empty if the runs are not of a district."""
    if not has_district(comparison):
        return ""
    parts = [_balances(run, is_single=len(comparison.runs) == 1) for run in comparison.runs]
    parts.append(note_block([_NOTES]))
    connections = [_connections(run, is_single=len(comparison.runs) == 1) for run in comparison.runs]
    if any(connections):
        parts += [*connections, note_block([_CONNECTION_NOTES])]
    parts += [text for run in comparison.runs if (text := _comfort(run, is_single=len(comparison.runs) == 1))]
    return f'<section id="{ANCHOR}"><h2>{TITLE}</h2>{"".join(parts)}</section>'


def _heading(text: str, run: Run, *, is_single: bool) -> str:
    return f"<h3>{escape(text if is_single else f'{text}, {run.label}')}</h3>"


def _balances(run: Run, *, is_single: bool) -> str:
    rows = [_balance_row(balance) for balance in district_balances(run.trajectory)]
    head = ("Plant", "Carrier", *(name.capitalize() for name in _ENERGIES), "Closure")
    return _heading("Energy balances", run, is_single=is_single) + _table("Energy balances", head, rows, texts=2)


def _balance_row(balance: CarrierBalance) -> list[str]:
    energies = [getattr(balance, name) for name in _ENERGIES]
    closure = NONE if balance.closure is None else f"{balance.closure:.1e}"
    return [balance.plant, balance.label, *(NONE if kwh is None else number(kwh) for kwh in energies), closure]


def _connections(run: Run, *, is_single: bool) -> str:
    """Return the table of the connections; empty if there are none."""
    rows = [
        [each.label, each.unit, *(number(getattr(each, term)) for term in _EXCHANGED), f"{each.closure:.1e}"]
        for each in connection_balances(run.trajectory)
    ]
    head = ("Connection", "Unit", *(term.capitalize() for term in _EXCHANGED), "Closure")
    title = "Balances of connections"
    return _heading(title, run, is_single=is_single) + _table(title, head, rows, texts=2) if rows else ""


def _comfort(run: Run, *, is_single: bool) -> str:
    """Return the table of the buildings with zones; empty if there are none."""
    rows, bands = [], list[str]()
    for plant in plant_names(run.trajectory.manifest):
        quantities = Quantities(plant_trajectory(run.trajectory, plant))
        comfort, hours = quantities.comfort, quantities.degree_hours
        if comfort is None or hours is None:
            continue
        above, below = hours
        total = above + below
        worst = comfort.labels[int(total.argmax())] if total.any() else NONE
        rows.append([plant, str(len(total)), number(float(above.sum())), number(float(below.sum())), worst])
        bands.append(f"{plant}: {comfort.source}{'' if comfort.has_occupants else ', as if occupied at all times'}")
    if not rows:
        return ""
    head = ("Building", "Zones", "Too warm, K h", "Too cold, K h", "Worst zone")
    note = f"Outside the comfort band while zones are occupied, summed over zones. Bands: {'; '.join(bands)}."
    table = _table("Comfort by building", head, rows, texts=1)
    return _heading("Comfort by building", run, is_single=is_single) + table + note_block([note])


def _table(title: str, head: Sequence[str], rows: Sequence[Sequence[str]], *, texts: int) -> str:
    """Return a table whose first columns are texts."""

    def kind(place: int) -> str:
        return ' class="n"' if place >= texts else ""

    columns = "".join(f'<th scope="col"{kind(place)}>{escape(text)}</th>' for place, text in enumerate(head))
    body = ""
    for first, *rest in rows:
        others = "".join(f"<td{kind(place)}>{escape(text)}</td>" for place, text in enumerate(rest, 1))
        body += f'<tr><th scope="row">{escape(first)}</th>{others}</tr>'
    return (
        f'<div class="scroll" role="group" aria-label="{escape(title)}" tabindex="0"><table class="totals"><thead><tr>'
        f"{columns}</tr></thead><tbody>{body}</tbody></table></div>"
    )
