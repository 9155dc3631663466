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

from zenostat.agent_sdk.controllers import Controller, PIDController
from zenostat.agent_sdk.controllers.action_roles import SETPOINTS, ActionBinding, Role, bind_actions
from zenostat.agent_sdk.controllers.base import Values
from zenostat.agent_sdk.controllers.comfort_band import Band, comfort_bands, inside
from zenostat.agent_sdk.controllers.fixed import default_values
from zenostat.agent_sdk.controllers.parameters import ControllerMismatch
from zenostat.bridge.client.sample import SampleView
from zenostat.lab.evaluate import evaluate
from zenostat.topics.messages import Manifest
from zenostat.topics.points import bounds
from zenostat.topics.scenario_ids import WEATHERS, pack_ids

BUNDLED = ("office-small", "office-medium", "ref-warehouse", "warehouse", "ref-large-hotel", "hotel-small")
SEASONS = {"January": ("01-09", "01-15"), "July": ("07-10", "07-16")}
BEGIN, END = "<!-- controllers -->", "<!-- /controllers -->"

_WEATHER = ("mixed", "chicago")
_KWH = ("electricity_kwh", "natural_gas_kwh")


class ZonePIDs(Controller):
    """One `PIDController` for each zone and zone setpoint, with its default gains; other actions as in `fixed`.

    The controllers' setpoints are 1 K (at most a third of the band) inside the comfort band of the first sample. An
    action that serves several zones takes the output of the zone that demands the most heating or cooling. Heating
    setpoints stay below the middle of the band and cooling setpoints above it, so that they cannot cross.
    """

    def __init__(self, manifest: Manifest) -> None:
        super().__init__(manifest)
        self._band = comfort_bands(manifest)
        bindings = bind_actions(manifest)
        self._setpoints = [b for b in bindings if b.role in SETPOINTS and b.temperatures]
        self._others = [b for b in bindings if b not in self._setpoints]
        if not self._setpoints:
            raise ControllerMismatch(f"node {manifest.node!r} has no zone setpoints")
        self._zones: list[tuple[ActionBinding, list[PIDController]]] = []

    def begin(self, sample: SampleView) -> None:
        """Create the controllers for the comfort band of the episode's first day."""
        band = self._band(sample.time)
        self._zones = [(b, [self._zone(b, index, band) for index in b.temperatures]) for b in self._setpoints]

    def _zone(self, binding: ActionBinding, index: int, band: Band) -> PIDController:
        middle, (low, high) = (band[0] + band[1]) / 2, bounds(binding.action)
        is_heating = binding.role is Role.HEATING
        setpoint = binding.clip(inside(band)[not is_heating])
        limits = {"high": min(middle, setpoint + 2.0)} if is_heating else {"low": max(middle, setpoint - 2.0)}
        limits = {name: value for name, value in limits.items() if low < value < high}
        sensor = self.manifest.names[index]
        return PIDController(self.manifest, setpoint=setpoint, sensor=sensor, actuator=binding.action.name, **limits)

    def act(self, sample: SampleView) -> Values:
        """Return the output of the most demanding zone of each zone setpoint, and the other actions' defaults."""
        band = inside(self._band(sample.time))
        values: Values = {}
        for binding in self._others:
            values |= default_values(binding, band)
        for binding, zones in self._zones:
            outputs = [value for zone in zones for value in zone.act(sample).values() if value is not None]
            values |= binding.at(max(outputs) if binding.role is Role.HEATING else min(outputs))
        return values


CONTROLLERS: Mapping[str, str | type[Controller]] = {
    **{name: name for name in ("baseline", "rbc", "incremental", "setback", "fixed")},
    "pid": ZonePIDs,
}


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
