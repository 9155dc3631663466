"""The network of a grid as a model of power-grid-model, and its power flow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zenostat.plants.grid.schema import Grid
from zenostat.topics.arrays import Floats
from zenostat.topics.extras import requires_extra

_TOLERANCE = 1e-10
"""Largest difference of voltages between two iterations, per unit."""
_ITERATIONS = 50


class DivergedPowerFlow(Exception):
    """A power flow that did not converge.

    Attributes:
        bus: with the lowest voltage of the linear approximation.
        voltage_pu: that voltage.
    """

    def __init__(self, bus: str, voltage_pu: float) -> None:
        super().__init__(f"the linear approximation has its lowest voltage, {voltage_pu:.2f} p.u., at bus {bus!r}")
        self.bus, self.voltage_pu = bus, voltage_pu


@dataclass(frozen=True, slots=True)
class PowerFlow:
    """Results of a power flow.

    Attributes:
        voltages_pu: of the buses.
        line_loadings, transformer_loadings: current over rated current of the end with the larger ratio, %.
        source_w: power that the source feeds in, W; negative: it takes power.
        losses_w: of all lines and transformers, W.
    """

    voltages_pu: Floats
    line_loadings: Floats
    transformer_loadings: Floats
    source_w: float
    losses_w: float


class Network:
    """A network that calculates power flows; it has no state.

    Args:
        grid: the file.
        injections: names of everything that draws power, with their buses, in the order of `solve`.

    Raises:
        InvalidConfig: power-grid-model is not installed.
    """

    def __init__(self, grid: Grid, injections: Mapping[str, str]) -> None:
        with requires_extra("grid", "an electric grid", "power-grid-model"):
            import power_grid_model
            import power_grid_model.errors
        self._library: Any = power_grid_model
        self._grid, self._injections = grid, len(injections)
        numbers = count()
        self._buses = {name: next(numbers) for name in grid.buses}
        arrays = {
            "node": self._nodes(),
            "line": self._lines(numbers),
            "transformer": self._transformers(numbers),
            "sym_load": self._loads(injections, numbers),
            "source": self._source(numbers),
        }
        present = {name: array for name, array in arrays.items() if len(array)}
        self._kinds = set(present)
        self._model = power_grid_model.PowerGridModel(present, system_frequency=float(grid.frequency_hz))
        self._update = self._array("update", "sym_load", len(injections))
        if len(injections):
            self._update["id"] = arrays["sym_load"]["id"]
        transformers = arrays["transformer"]
        self._rated = [transformers["sn"] / (sqrt(3.0) * transformers[side]) for side in ("u1", "u2")]

    def _array(self, kind: str, component: str, length: int) -> NDArray[Any]:
        array: NDArray[Any] = self._library.initialize_array(kind, component, length)
        return array

    def _nodes(self) -> NDArray[Any]:
        nodes = self._array("input", "node", len(self._buses))
        nodes["id"] = [*self._buses.values()]
        nodes["u_rated"] = [bus.voltage_kv * 1e3 for bus in self._grid.buses.values()]
        return nodes

    def _branches(self, component: str, branches: Mapping[str, Any], numbers: Any) -> NDArray[Any]:
        array = self._array("input", component, len(branches))
        for row, branch in zip(array, branches.values(), strict=True):
            row["id"] = next(numbers)
            row["from_node"], row["to_node"] = self._buses[branch.start], self._buses[branch.end]
            row["from_status"] = row["to_status"] = 1
        return array

    def _lines(self, numbers: Any) -> NDArray[Any]:
        lines = self._branches("line", self._grid.lines, numbers)
        for row, line in zip(lines, self._grid.lines.values(), strict=True):
            length_km, parallel = line.length_m / 1e3, line.parallel
            row["r1"], row["x1"] = (
                per_km * length_km / parallel for per_km in (line.resistance_ohm_km, line.reactance_ohm_km)
            )
            row["c1"], row["tan1"] = line.capacitance_nf_km * 1e-9 * length_km * parallel, 0.0
            row["i_n"] = line.ampacity_a * parallel
            if line.open_end is not None:
                row[f"{line.open_end}_status"] = 0
        return lines

    def _transformers(self, numbers: Any) -> NDArray[Any]:
        array = self._branches("transformer", self._grid.transformers, numbers)
        star, delta = self._library.WindingType.wye_n, self._library.WindingType.delta
        for row, part in zip(array, self._grid.transformers.values(), strict=True):
            buses = [self._grid.buses[bus].voltage_kv for bus in (part.start, part.end)]
            row["u1"] = (part.primary_kv or buses[0]) * 1e3 * (1.0 + part.tap_percent / 100.0)
            row["u2"] = (part.secondary_kv or buses[1]) * 1e3
            power_va = part.power_kva * 1e3
            row["sn"], row["uk"], row["pk"] = power_va, part.short_circuit_percent / 100.0, part.copper_loss_w
            row["i0"] = max(part.no_load_percent / 100.0, part.iron_loss_w / power_va)
            row["p0"] = part.iron_loss_w
            row["winding_from"], row["winding_to"] = (delta if part.clock % 2 else star), star
            row["clock"] = part.clock
            row["tap_side"] = row["tap_pos"] = row["tap_min"] = row["tap_max"] = row["tap_nom"] = 0
            row["tap_size"] = 0.0
        return array

    def _loads(self, injections: Mapping[str, str], numbers: Any) -> NDArray[Any]:
        loads = self._array("input", "sym_load", len(injections))
        for row, bus in zip(loads, injections.values(), strict=True):
            row["id"], row["node"], row["status"] = next(numbers), self._buses[bus], 1
            row["type"] = self._library.LoadGenType.const_power
            row["p_specified"] = row["q_specified"] = 0.0
        return loads

    def _source(self, numbers: Any) -> NDArray[Any]:
        source, part = self._array("input", "source", 1), self._grid.source
        source["id"], source["node"], source["status"] = next(numbers), self._buses[part.bus], 1
        source["u_ref"], source["sk"] = part.voltage_pu, part.short_circuit_mva * 1e6
        return source

    def solve(self, active_w: Floats, reactive_var: Floats) -> PowerFlow:
        """Calculate the power flow by Newton and Raphson's method.

        Args:
            active_w: power that each injection draws, W.
            reactive_var: reactive power that it draws, var.

        Raises:
            DivergedPowerFlow: it does not converge.
        """
        if self._injections:
            self._update["p_specified"], self._update["q_specified"] = active_w, reactive_var
            self._model.update(update_data={"sym_load": self._update})
        try:
            output = self._calculate(self._library.CalculationMethod.newton_raphson)
        except self._library.errors.PowerGridError:
            raise self._diverged() from None
        voltages = output["node"]["u_pu"]
        if not np.isfinite(voltages).all():
            raise self._diverged()
        return PowerFlow(
            voltages_pu=voltages.copy(),
            line_loadings=self._line_loadings(output),
            transformer_loadings=self._transformer_loadings(output),
            source_w=float(output["source"]["p"][0]),
            losses_w=sum(
                float((output[kind]["p_from"] + output[kind]["p_to"]).sum())
                for kind in ("line", "transformer")
                if kind in self._kinds
            ),
        )

    def _calculate(self, method: Any) -> Any:
        return self._model.calculate_power_flow(
            symmetric=True, error_tolerance=_TOLERANCE, max_iterations=_ITERATIONS, calculation_method=method
        )

    def _diverged(self) -> DivergedPowerFlow:
        voltages = self._calculate(self._library.CalculationMethod.linear)["node"]["u_pu"]
        lowest = int(np.argmin(np.nan_to_num(voltages, nan=-np.inf)))
        return DivergedPowerFlow([*self._buses][lowest], float(voltages[lowest]))

    def _line_loadings(self, output: Any) -> Floats:
        loadings: Floats = output["line"]["loading"] * 100.0 if "line" in self._kinds else np.zeros(0)
        return loadings

    def _transformer_loadings(self, output: Any) -> Floats:
        if "transformer" not in self._kinds:
            return np.zeros(0)
        currents = [output["transformer"][f"i_{side}"] for side in ("from", "to")]
        ratios = [current / rated for current, rated in zip(currents, self._rated, strict=True)]
        loadings: Floats = np.maximum(*ratios) * 100.0
        return loadings


def reactive_ratio(power_factor: float) -> float:
    """Return reactive over active power of a load with a power factor."""
    return sqrt(1.0 - power_factor**2) / power_factor
