"""The controllers that come along beside each building's own control: a week in winter and a week in summer.

    python -m bench.controllers --page docs/controllers.md
    python -m bench.controllers --building shop --building office

Prints a table in Markdown of energy and degree-hours outside the comfort band, or puts it between the marks of a page.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path

from agent_sdk.evaluation.evaluate import evaluate
from topics.scenario_ids import WEATHERS, pack_ids

BUNDLED = ("office-small", "office-medium", "ref-warehouse", "warehouse", "ref-large-hotel", "hotel-small")
SEASONS = {"January": ("01-09", "01-15"), "July": ("07-10", "07-16")}
CONTROLLERS = ("building", "rbc", "incremental", "setback", "fixed")
BEGIN, END = "<!-- controllers -->", "<!-- /controllers -->"

_WEATHER = ("mixed", "chicago")
_KWH = ("electricity_kwh", "natural_gas_kwh")


def scenarios() -> list[str]:
    """An id for each building of the Sinergym pack, with continuous actions and mixed weather where it has them."""
    found: dict[str, list[str]] = {}
    for name in pack_ids():
        parts = name.split("-")
        if len(parts) > 2 and "stochastic" not in parts:
            found.setdefault(parts[0], []).append(name)
    theirs = [min(ids, key=_preference) for ids in found.values()]
    return theirs + [f"{building}-{WEATHERS[0]}-continuous-v1" for building in BUNDLED]


def _preference(name: str) -> tuple[bool, bool]:
    return name.split("-")[1] not in _WEATHER, "continuous" not in name


def rows(wanted: Iterable[str]) -> Iterable[str]:
    """A row of Markdown for each scenario, season and controller."""
    for name in wanted:
        for season, (begin, end) in SEASONS.items():
            found = evaluate(name, CONTROLLERS, begin=begin, end=end, affinity="off")
            by_controller = {row["controller"]: row for row in found.table()}
            cells = [_cell(by_controller.get(controller)) for controller in CONTROLLERS]
            yield f"| {name.removesuffix('-v1')} | {season} | {' | '.join(cells)} |"


def _cell(row: Mapping[str, float | None] | None) -> str:
    """Energy in kWh, degree-hours in use and at all hours; empty where the controller does not fit."""
    if row is None:
        return ""
    fuels = [row[name] for name in _KWH if row.get(name) is not None] or [row["hvac_electricity_kwh"]]
    energy_kwh = sum(fuel for fuel in fuels if fuel is not None)
    return f"{energy_kwh:,.0f}; {row['occupied_outside_kh']:,.1f}; {row['outside_kh']:,.1f}"


def table(lines: Iterable[str]) -> str:
    """The lines below their head."""
    head = ("scenario", "week of", *CONTROLLERS)
    return "\n".join([f"| {' | '.join(head)} |", f"|{'---|' * len(head)}", *lines])


def main() -> int:
    """Simulates, and prints the table or puts it into a page."""
    parser = argparse.ArgumentParser(prog="bench.controllers", description=__doc__)
    parser.add_argument("--building", action="append", help="only ids that begin with this; repeated")
    parser.add_argument("--page", type=Path, help="a page to put the table into, between its marks")
    asked = parser.parse_args()
    wanted = [name for name in scenarios() if not asked.building or name.startswith(tuple(asked.building))]
    if asked.page is None:
        print(table(()))
        for line in rows(wanted):
            print(line, flush=True)
        return 0
    before, mark, rest = asked.page.read_text().partition(BEGIN)
    _, closing, after = rest.partition(END)
    if not mark or not closing:
        parser.error(f"--page: {asked.page} needs the lines {BEGIN!r} and {END!r}")
    asked.page.write_text(f"{before}{BEGIN}\n{table(rows(wanted))}\n{END}{after}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
