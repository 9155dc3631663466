"""Portable controllers on many buildings: savings against the building's own control, and what each building lacks.

python -m bench.portable run RESULTS.json       # simulate; buildings that the file has already are kept
python -m bench.portable table RESULTS.json     # show it, and write it into docs/semantic.md
"""

from __future__ import annotations

import json
import re
import socket
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

import zenostat
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

WEATHER, BEGIN, END = "USA_CO_Denver", "07-05", "07-06"
"""Two weekdays; on the first one the controllers learn the building's own setpoints and arrival times."""

CONTROLLERS: Mapping[str, type[Controller] | None] = {
    "own control": None,
    "portable-setback": PortableSetback,
    "portable-limit": PortableDemandLimit,
}
PAGE = Path(__file__).parents[1] / "docs" / "semantic.md"
BEGIN_MARK, END_MARK = "<!-- table of bench.portable -->", "<!-- end of the table -->"
J_PER_KWH = 3.6e6


def simulate(building: str) -> dict[str, Any]:
    """Run all controllers in a node of a building; return energy, peak and unmet hours of each, and what it lacks."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    settings = ("--building", building, "--weather", WEATHER, "--begin", BEGIN, "--end", END, "--steps-per-hour", "6")
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
    hvac = [meter.name for meter in manifest.meters if meter.meter.startswith("HVAC:")]
    unmet = [name for name in ("unmet_heating_time", "unmet_cooling_time") if name in manifest.names]
    energy_j = peak_w = unmet_h = 0.0
    with bus.controller("portable") as link:
        link.reset(seed=0)
        for sample in link:
            if sample.step:
                energy_j += sum(sample[name] for name in hvac)
                peak_w = max(peak_w, sample["electricity_facility"] / manifest.step_s)
                unmet_h += sum(sample[name] for name in unmet)
            if not sample.truncated:
                sample.send({} if agent is None else agent.values(sample))
    return {
        "hvac_kwh": energy_j / J_PER_KWH,
        "peak_kw": peak_w / 1000.0,
        "unmet_h": unmet_h,
        "lacks": getattr(controller, "lacks", []),
    }


def rows(results: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return a row of the table for each building."""
    table = []
    for building, episodes in results.items():
        own = episodes["own control"]
        cells = [building]
        for name in ("portable-setback", "portable-limit"):
            episode = episodes[name]
            cells += [
                f"{_saving(own['hvac_kwh'], episode['hvac_kwh'])} %",
                f"{_saving(own['peak_kw'], episode['peak_kw'])} %",
                f"{episode['unmet_h'] - own['unmet_h']:+.1f} h",
            ]
        lacks = dict.fromkeys(text for episode in episodes.values() for text in episode["lacks"])
        table.append((*cells, "; ".join(lacks)))
    return table


def _saving(own: float, value: float) -> str:
    saved = round(100.0 * (own - value) / own, 1) if own else 0.0
    return f"{saved + 0.0:.1f}"  # no negative zero


COLUMNS = (
    "building", "setback: HVAC energy", "peak", "unmet hours", "limit: HVAC energy", "peak", "unmet hours", "lacks",
)  # fmt: skip


def write_page(table: Sequence[tuple[str, ...]]) -> None:
    """Replace the table in the page."""
    lines = [COLUMNS, ("---",) * len(COLUMNS), *table]
    text = "".join(f"| {' | '.join(line)} |\n" for line in lines)
    marked = re.compile(f"{BEGIN_MARK}.*{END_MARK}", re.DOTALL)
    page = marked.sub(lambda _: f"{BEGIN_MARK}\n\n{text}\n{END_MARK}", PAGE.read_text(encoding="utf-8"))
    PAGE.write_text(page, encoding="utf-8")


def main(action: str, file: Path) -> None:
    """Simulate the buildings that the file lacks, or show the table."""
    results: dict[str, Any] = json.loads(file.read_text()) if file.exists() else {}
    if action == "run":
        for building in BUILDINGS:
            if building not in results:
                results[building] = simulate(building)
                with atomic_file(file) as temporary:
                    temporary.write_text(json.dumps(results, indent=1) + "\n")
    table = rows(results)
    shown = Table(*COLUMNS)
    for row in table:
        shown.add_row(*row)
    Console().print(shown)
    if action == "table":
        write_page(table)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
