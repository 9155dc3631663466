"""Networks of pandapower as grids: equal loads give the voltages and loadings of pandapower's own power flow."""

from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("power_grid_model")
pandapower = pytest.importorskip("pandapower", reason="pandapower is not installed; it pins other libraries")

from zenostat.plants.grid.pandapower import NETWORKS, BusNames, create  # noqa: E402
from zenostat.plants.grid.plant import GridPlant  # noqa: E402

pytestmark = pytest.mark.slow


def loadings(net: Any, plant: GridPlant) -> Iterator[tuple[str, float]]:
    """Yield the names of lines and transformers with their loadings by pandapower."""
    open_at_both_ends = net.switch[(net.switch.et == "l") & ~net.switch.closed].element.value_counts() > 1
    is_used = net.line.in_service & ~net.line.index.isin(open_at_both_ends[open_at_both_ends].index)
    yield from zip(plant.grid.lines, net.res_line.loading_percent[is_used], strict=True)
    yield from zip(plant.grid.transformers, net.res_trafo.loading_percent[net.trafo.in_service], strict=True)


@pytest.mark.parametrize("name", NETWORKS)
@pytest.mark.parametrize("factor", [1.0, 0.4, -0.3])
def test_grid__of_pandapower_has_its_voltages_and_loadings(name: str, factor: float) -> None:
    net, plant = create(name), GridPlant(f"pandapower:{name}")
    plant.reset(0)
    demands = {f"{load}_demand": part.power_w * factor for load, part in plant.grid.loads.items()}
    values = plant.step(demands)
    for table in (net.load, net.sgen):
        table.p_mw *= factor  # the reactive power is constant
    pandapower.runpp(net, tolerance_mva=1e-11, calculate_voltage_angles=True, numba=False)
    names = BusNames(net)
    compared = {bus: values[f"{names.at(bus)}_voltage"] for bus in names.buses if f"{names.at(bus)}_voltage" in values}
    assert len(compared) == net.res_bus.vm_pu.count(), "all that pandapower has calculated"
    for bus, voltage in compared.items():
        assert voltage == pytest.approx(net.res_bus.vm_pu[bus], abs=1e-9), bus
    for part, loading in loadings(net, plant):
        assert values[f"{part}_loading"] == pytest.approx(loading, abs=1e-6), part
