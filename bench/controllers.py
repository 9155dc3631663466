"""Compare the controllers of the package with each building's baseline control, in one winter and one summer week.

    python -m bench.controllers --page docs/controllers.md
    python -m bench.controllers --building shop --building office

It prints a Markdown table of energy and degree-hours outside the comfort band, or writes it between the markers of a
page.
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
CONTROLLERS = ("baseline", "rbc", "incremental", "setback", "fixed")
BEGIN, END = "<!-- controllers -->", "<!-- /controllers -->"

_WEATHER = ("mixed", "chicago")
_KWH = ("electricity_kwh", "natural_gas_kwh")


def scenarios() -> list[str]:
    """Return one id per building of the Sinergym pack, preferably with continuous actions and mixed weather."""
    by_building: dict[str, list[str]] = {}
    for name in pack_ids():
        parts = name.split("-")
        if len(parts) > 2 and "stochastic" not in parts:
            by_building.setdefault(parts[0], []).append(name)
    from_pack = [min(ids, key=_preference) for ids in by_building.values()]
    return from_pack + [f"{building}-{WEATHERS[0]}-continuous-v1" for building in BUNDLED]


def _preference(name: str) -> tuple[bool, bool]:
    return name.split("-")[1] not in _WEATHER, "continuous" not in name


def rows(names: Iterable[str]) -> Iterable[str]:
    """Yield a Markdown row for each scenario and season."""
    for name in names:
        for season, (begin, end) in SEASONS.items():
            results = evaluate(name, CONTROLLERS, begin=begin, end=end, affinity="off")
            by_controller = {row["controller"]: row for row in results.table()}
            cells = [_cell(by_controller.get(controller)) for controller in CONTROLLERS]
            yield f"| {name.removesuffix('-v1')} | {season} | {' | '.join(cells)} |"


def _cell(row: Mapping[str, float | None] | None) -> str:
    """Return energy in kWh, degree-hours when occupied and in total; empty if the controller does not fit."""
    if row is None:
        return ""
    fuels = [row[name] for name in _KWH if row.get(name) is not None] or [row["hvac_electricity_kwh"]]
    energy_kwh = sum(fuel for fuel in fuels if fuel is not None)
    return f"{energy_kwh:,.0f}; {row['occupied_outside_kh']:,.1f}; {row['outside_kh']:,.1f}"


def table(lines: Iterable[str]) -> str:
    """Return the table of these lines with its header."""
    header = ("scenario", "week of", *CONTROLLERS)
    return "\n".join([f"| {' | '.join(header)} |", f"|{'---|' * len(header)}", *lines])


def main() -> int:
    """Simulate, and print the table or write it into a page."""
    parser = argparse.ArgumentParser(prog="bench.controllers", description=__doc__)
    parser.add_argument("--building", action="append", help="only ids with this prefix; can be repeated")
    parser.add_argument("--page", type=Path, help="page to write the table into, between its markers")
    options = parser.parse_args()
    names = [name for name in scenarios() if not options.building or name.startswith(tuple(options.building))]
    if options.page is None:
        print(table(()))
        for line in rows(names):
            print(line, flush=True)
        return 0
    before, mark, rest = options.page.read_text().partition(BEGIN)
    _, closing, after = rest.partition(END)
    if not mark or not closing:
        parser.error(f"--page: {options.page} must contain the lines {BEGIN!r} and {END!r}")
    options.page.write_text(f"{before}{BEGIN}\n{table(rows(names))}\n{END}{after}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
