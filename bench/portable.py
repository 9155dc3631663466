"""Portable controllers on many buildings: savings against the building's own control, and what each building lacks.

python -m bench.portable run RESULTS.json       # simulate; buildings that the file has already are kept
python -m bench.portable table RESULTS.json     # show the tables, and write them into docs/semantic.md
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

import zenostat
from bench import programs
from zenostat.agent_sdk import semantic
from zenostat.agent_sdk.controllers import Agent, Controller, PortableDemandLimit, PortableSetback
from zenostat.topics.atomic_file import atomic_file

BUILDINGS = (
    "warehouse", "office-small", "ref-small-office", "restaurant-fast-food", "restaurant-sit-down",
    "retail-standalone", "retail-stripmall", "office-medium", "ref-warehouse", "ref-quick-service-restaurant",
    "ref-full-service-restaurant", "ref-stand-alone-retail", "ref-strip-mall", "ref-super-market", "ref-medium-office",
    "ref-large-office", "school-primary", "ref-primary-school", "hotel-large", "ref-large-hotel",
)  # fmt: skip
"""Twenty of the bundled buildings, small ones first."""

WEATHER = "USA_CO_Denver"
SEASONS: Mapping[str, tuple[str, str]] = {"July": ("07-05", "07-06"), "January": ("01-11", "01-12")}
"""Two weekdays each; on the first one the controllers learn the building's own setpoints and arrival times."""

CONTROLLERS: Mapping[str, type[Controller] | None] = {
    "own control": None,
    "portable-setback": PortableSetback,
    "portable-limit": PortableDemandLimit,
}
PAGE = Path(__file__).parents[1] / "docs" / "semantic.md"
BEGIN_MARK, END_MARK = "<!-- tables of bench.portable -->", "<!-- end of the tables -->"
GAS = "HVAC:NaturalGas"
J_PER_KWH = 3.6e6


def simulate(building: str, begin: str, end: str) -> dict[str, Any]:
    """Run all controllers in a node of a building; return energy, peak and unmet hours of each, and what it lacks."""
    endpoint = f"tcp/127.0.0.1:{programs.free_port()}"
    settings = ("--building", building, "--weather", WEATHER, "--begin", begin, "--end", end, "--steps-per-hour", "6")
    program = [sys.executable, "-m", "zenostat", "node", *settings, "--name", "portable", "--listen", endpoint]
    with subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as node:
        try:
            assert node.stdout is not None
            node.stdout.readline()  # the node prints a line when it is on the bus
            with zenostat.connect(endpoint) as bus:
                model = semantic.read(bus, "portable")
                return {name: _episode(bus, kind, model) for name, kind in CONTROLLERS.items()}
        finally:
            node.terminate()


def _episode(bus: zenostat.Bus, kind: type[Controller] | None, model: semantic.SemanticGraph) -> dict[str, Any]:
    manifest = bus.manifest("portable")
    controller = None if kind is None else kind(manifest)
    agent = None if controller is None else Agent(controller, semantic=lambda: model)
    hvac = {meter.name: meter.meter for meter in manifest.meters if meter.meter.startswith("HVAC:")}
    unmet = [name for name in ("unmet_heating_time", "unmet_cooling_time") if name in manifest.names]
    energy_j = dict.fromkeys(hvac, 0.0)
    peak_w = unmet_h = 0.0
    with bus.controller("portable") as link:
        link.reset(seed=0)
        for sample in link:
            if sample.step:
                energy_j = {name: value + sample[name] for name, value in energy_j.items()}
                peak_w = max(peak_w, sample["electricity_facility"] / manifest.step_s)
                unmet_h += sum(sample[name] for name in unmet)
            if not sample.truncated:
                sample.send({} if agent is None else agent.values(sample))
    return {
        "hvac_kwh": sum(energy_j.values()) / J_PER_KWH,
        "hvac_gas_kwh": sum(value for name, value in energy_j.items() if hvac[name] == GAS) / J_PER_KWH,
        "peak_kw": peak_w / 1000.0,
        "unmet_h": unmet_h,
        "lacks": getattr(controller, "lacks", []),
    }


def rows(results: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return the columns of a season's table, and a row for each building."""
    has_gas = all("hvac_gas_kwh" in episode for episodes in results.values() for episode in episodes.values())
    columns = ["HVAC energy", *(["HVAC gas"] if has_gas else []), "peak", "unmet hours"]
    table = [("building", *(f"{name}: {column}" for name in ("setback", "limit") for column in columns), "lacks")]
    for building, episodes in results.items():
        own = episodes["own control"]
        cells = [building]
        for name in ("portable-setback", "portable-limit"):
            episode = episodes[name]
            cells.append(f"{_saving(own['hvac_kwh'], episode['hvac_kwh'])} %")
            if has_gas:
                gas = own["hvac_gas_kwh"], episode["hvac_gas_kwh"]
                cells.append(f"{_saving(*gas)} %" if gas[0] else "none")
            cells.append(f"{_saving(own['peak_kw'], episode['peak_kw'])} %")
            cells.append(f"{episode['unmet_h'] - own['unmet_h']:+.1f} h")
        lacks = dict.fromkeys(text for episode in episodes.values() for text in episode["lacks"])
        table.append((*cells, "; ".join(lacks)))
    return table


def _saving(own: float, value: float) -> str:
    saved = round(100.0 * (own - value) / own, 1) if own else 0.0
    return f"{saved + 0.0:.1f}"  # no negative zero


def write_page(tables: Mapping[str, Sequence[tuple[str, ...]]]) -> None:
    """Replace the tables in the page."""
    text = ""
    for season, (columns, *table) in tables.items():
        lines = [columns, ("---",) * len(columns), *table]
        text += f"{season}:\n\n" + "".join(f"| {' | '.join(line)} |\n" for line in lines) + "\n"
    marked = re.compile(f"{BEGIN_MARK}.*{END_MARK}", re.DOTALL)
    page = marked.sub(lambda _: f"{BEGIN_MARK}\n\n{text}{END_MARK}", PAGE.read_text(encoding="utf-8"))
    PAGE.write_text(page, encoding="utf-8")


def main(action: str, file: Path) -> None:
    """Simulate the buildings that the file lacks, or show the tables."""
    results: dict[str, Any] = json.loads(file.read_text()) if file.exists() else {}
    if action == "run":
        for season, (begin, end) in SEASONS.items():
            buildings = results.setdefault(season, {})
            for building in BUILDINGS:
                if building not in buildings:
                    buildings[building] = simulate(building, begin, end)
                    with atomic_file(file) as temporary:
                        temporary.write_text(json.dumps(results, indent=1) + "\n")
    tables = {season: rows(buildings) for season, buildings in results.items() if buildings}
    for season, (columns, *table) in tables.items():
        shown = Table(*columns, title=season)
        for row in table:
            shown.add_row(*row)
        Console().print(shown)
    if action == "table":
        write_page(tables)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
