"""Energy balances and comfort of the plants of a district, by hand and from the equations of the plants."""

import re
from dataclasses import replace

import numpy as np
import pytest
from support.builders import manifest

from zenostat.metrics.district_balance import (
    CarrierBalance,
    connection_balances,
    district_balances,
    plant_names,
    plant_trajectory,
)
from zenostat.metrics.episode_metrics import MetricsAccumulator
from zenostat.metrics.trajectory import Trajectory
from zenostat.plants.heat import DistrictHeating
from zenostat.topics.connection_balance import ConnectionBalance
from zenostat.topics.messages import Meter, Sensor
from zenostat.views.report.district_section import district_section
from zenostat.views.report.quantities import Quantities
from zenostat.views.report.runs import Comparison, Run
from zenostat.views.report.totals_section import MINUS, NONE

Columns = dict[str, tuple[str, list[float]]]
GRID: Columns = {  # W in two timesteps of half an hour and in one without a solution
    "import": ("W", [9e3, 4000.0, 0.0, 0.0]),
    "export": ("W", [9e3, 0.0, 1000.0, 0.0]),
    "losses": ("W", [9e3, 200.0, 100.0, 0.0]),
    "shop_power": ("W", [9e3, 3000.0, 2000.0, 0.0]),
    "roof_power": ("W", [9e3, 1000.0, 5000.0, 0.0]),
    "roof_available": ("W", [9e3, 1000.0, 5000.0, 0.0]),
    "store_power": ("W", [9e3, 800.0, -2100.0, 0.0]),
    "store_state_of_charge": ("fraction", [0.5, 0.5, 0.4, 0.4]),
    "car_power": ("W", [9e3, 1000.0, 4000.0, 0.0]),
    "car_connected": ("on_off", [1.0, 1.0, 1.0, 1.0]),
    "converged": ("on_off", [1.0, 1.0, 1.0, 0.0]),
}
SHOP: Columns = {"core_air_temperature": ("degC", [40.0, 28.0, 25.0, 18.5])}


def district(plants: dict[str, Columns], meters: dict[str, list[float]], step_s: float = 1800.0) -> Trajectory:
    sensors = {f"{plant}.{name}": column for plant, columns in plants.items() for name, column in columns.items()}
    count = len(next(iter(sensors.values()))[1])
    sensors |= {f"plant.{plant}.available": ("on_off", [1.0] * count) for plant in plants}
    base = manifest(
        sensors=[Sensor(name=name, unit=unit) for name, (unit, _) in sensors.items()],
        meters=[Meter(name=name, unit="J") for name in meters],
        actuators=[],
    )
    values = np.array([*(values for _, values in sensors.values()), *meters.values()]).T
    return Trajectory(
        manifest=base.model_copy(update={"step_s": step_s, "steps": count - 1}), step=np.arange(count), values=values,
        effective=np.zeros((count, 0)), source_index=np.zeros((count, 0), np.uint16), sources=("",),
    )  # fmt: skip


CONNECTION: Columns = {  # sample 0, then sent = received + clipped + stored
    "exchange.a.x-b.u": ("W", [0.0, 4.0, 4.0, 6.0]),
    "balance.a.x-b.u.sent": ("W", [1.0, 5.0, 10.0, 3.0]),
    "balance.a.x-b.u.clipped": ("W", [0.0, 0.0, 1.0, 0.0]),
    "balance.a.x-b.u.stored": ("W", [0.0, 1.0, 5.0, -3.0]),
}


def connected(columns: Columns) -> Trajectory:
    """A trajectory of a district with one plant and these own points."""
    run = district({"a": SHOP}, {})
    sensors = [*run.manifest.sensors, *(Sensor(name=name, unit=unit) for name, (unit, _) in columns.items())]
    return replace(
        run,
        manifest=run.manifest.model_copy(update={"sensors": tuple(sensors)}),
        values=np.hstack([run.values, np.array([values for _, values in columns.values()]).T]),
        fault_free_values=None,
    )


def test_connection_balances__by_hand() -> None:
    (balance,) = connection_balances(connected(CONNECTION))
    assert balance == ConnectionBalance(
        "a.x-b.u", "W", 6.0, pytest.approx(14 / 3), pytest.approx(1 / 3), 0.0, 0.0, 1.0, 6.0
    )
    assert balance.closure == pytest.approx(0.0, abs=1e-15)
    gap = {name: (unit, [*values[:2], np.nan, values[3]]) for name, (unit, values) in CONNECTION.items()}
    (partial,) = connection_balances(connected(gap))
    assert (partial.sent, partial.missing_steps, partial.label) == (4.0, 1, "a.x-b.u (steps without a value: 1)")
    unbalanced = CONNECTION | {"exchange.a.x-b.u": ("W", [0.0, 4.0, 4.0, 9.0])}
    assert connection_balances(connected(unbalanced))[0].closure == pytest.approx(-1 / 6)
    assert connection_balances(district({"shop": SHOP}, {})) == ()


def test_district_section__has_balances_of_connections() -> None:
    text = district_section(Comparison((Run("rule", (), connected(CONNECTION)),)))
    rows = [re.findall(r"<t[hd][^>]*>([^<]*)</t[hd]>", row) for row in re.findall(r"<tr>(.*?)</tr>", text)]
    (row,) = [row for row in rows if row[0] == "a.x-b.u"]
    assert row[:8] == ["a.x-b.u", "W", "6", "4.67", "0.333", "0", "0", "1"]
    assert abs(float(row[8])) < 1e-12


def test_district_balances__grid_by_hand() -> None:
    """Means in W for half an hour are half as much in Wh; no energy flows in the timestep without a solution."""
    run = district({"shop": SHOP, "grid": GRID}, {"shop.electricity_facility": [9e9, 5.4e6, 3.6e6, 0.0]})
    shop, grid = district_balances(run)
    assert shop == CarrierBalance("shop", "electricity", consumed=pytest.approx(2.5))
    assert shop.closure is None
    expected = {"supplied": 5.0, "consumed": 5.0, "exported": 0.5, "lost": 0.15, "stored": -0.65}
    assert {name: getattr(grid, name) for name in expected} == pytest.approx(expected)
    assert grid.closure == pytest.approx(0.0, abs=1e-12)
    assert CarrierBalance("g", "electricity", 10.0, 7.0, 1.0, 0.5, 0.5).closure == pytest.approx(0.1)


def test_district_balances__steps_without_a_value_are_left_out_of_all_terms_and_counted() -> None:
    gap = GRID | {"import": ("W", [9e3, 4000.0, np.nan, 0.0])}
    run = district({"shop": SHOP, "grid": gap}, {"shop.electricity_facility": [9e9, np.nan, 3.6e6, np.nan]})
    shop, grid = district_balances(run)
    assert shop == CarrierBalance("shop", "electricity", consumed=pytest.approx(1.0), missing_steps=2)
    assert [grid.supplied, grid.consumed, grid.exported, grid.lost, grid.stored] == pytest.approx(
        [2.5, 2.0, 0.0, 0.1, 0.4]
    )
    assert (grid.closure, grid.missing_steps) == (pytest.approx(0.0, abs=1e-12), 1)
    text = district_section(Comparison((Run("rule", (), run),)))
    assert "<td>electricity (steps without a value: 2)</td>" in text


@pytest.mark.parametrize("source", ["boiler", "heat_pump"])
def test_district_balances__heat_network_closes(source: str) -> None:
    """A day with random demands and setpoints, by the class itself."""
    plant, random = DistrictHeating(source), np.random.default_rng(3)
    rows = [plant.reset(0)]
    for _ in range(288):
        demands = {f"{name}_demand": random.uniform(0.0, 60e3) for name in ("north", "south")}
        rows.append(plant.step({**demands, "setpoint": random.uniform(50.0, 90.0), "outdoor_temperature": 3.0}))
    columns = {name: (spec[0], [row[name] for row in rows]) for name, spec in plant.sensors.items()}
    (meter,) = plant.meters
    run = district({"net": columns}, {f"net.{meter}": [row[meter] for row in rows]}, step_s=300.0)
    heat, fuel = district_balances(run)
    assert heat.carrier == "heat"
    assert heat.closure == pytest.approx(0.0, abs=1e-12)
    assert heat.consumed == pytest.approx(sum(row["north_heat"] + row["south_heat"] for row in rows[1:]) / 12e3)
    content_kwh = 10_000.0 * 4186.0 * (rows[-1]["tank_temperature"] - 70.0) / 3.6e6
    assert heat.stored == pytest.approx(content_kwh, rel=1e-9)
    assert fuel.carrier == meter.replace("_", " ")
    assert fuel.consumed == pytest.approx(sum(row[meter] for row in rows[1:]) / 3.6e6)


def test_plant_trajectory__has_the_names_of_the_plants_own_node() -> None:
    run = district({"shop": SHOP, "grid": GRID}, {"shop.electricity_facility": [0.0, 5.4e6, 3.6e6, 0.0]})
    assert plant_names(run.manifest) == ("shop", "grid")
    part = plant_trajectory(run, "shop")
    assert part.manifest.names == ("core_air_temperature", "electricity_facility")
    above, below = Quantities(part).degree_hours
    assert (above.tolist(), below.tolist()) == ([1.0], [0.75])  # half an hour at 28 and at 18.5, of 20 to 26 degC


def nested(run: Trajectory, district: str) -> Trajectory:
    """The trajectory of a district with this one as its plant, beside another plant `shed`."""
    points = {
        kind: tuple(
            point.model_copy(update={"name": f"{district}.{point.name}"}) for point in getattr(run.manifest, kind)
        )
        for kind in ("sensors", "meters")
    }
    own = tuple(Sensor(name=f"plant.{name}.available", unit="on_off") for name in (district, "shed"))
    return replace(
        run,
        manifest=run.manifest.model_copy(update={**points, "sensors": (*own, *points["sensors"])}),
        values=np.hstack([np.ones((len(run.values), 2)), run.values]),
        fault_free_values=None,
    )


@pytest.mark.parametrize("path", [["in"], ["exchange"], ["in", "out"], ["plant", "out"]])
def test_district_balances__of_a_nested_district_are_those_of_its_own_with_its_name(path: list[str]) -> None:
    run = outer = district({"shop": SHOP, "grid": GRID}, {"shop.electricity_facility": [9e9, 5.4e6, 3.6e6, 0.0]})
    for name in path:
        outer = nested(outer, name)
    prefix = "".join(f"{name}." for name in reversed(path))
    sheds = ["".join(f"{name}." for name in reversed(path[place:])) + "shed" for place in range(1, len(path) + 1)]
    assert plant_names(outer.manifest) == (f"{prefix}shop", f"{prefix}grid", *sheds)
    own = [replace(balance, plant=prefix + balance.plant) for balance in district_balances(run)]
    assert list(district_balances(outer)) == own
    part, alone = plant_trajectory(outer, f"{prefix}shop"), plant_trajectory(run, "shop")
    assert part.manifest.names == alone.manifest.names
    assert part.values.tolist() == alone.values.tolist()


def test_connection_balances__of_a_nested_district_are_those_of_its_own_with_its_name() -> None:
    (balance,) = connection_balances(connected(CONNECTION))
    assert connection_balances(nested(connected(CONNECTION), "in")) == (replace(balance, name="in.a.x-b.u"),)
    of_exchange = {name.replace("a.x", "exchange.x"): column for name, column in CONNECTION.items()}
    assert connection_balances(connected(of_exchange)) == (replace(balance, name="exchange.x-b.u"),)


def test_district_section__has_balances_and_comfort_by_building() -> None:
    run = district({"shop": SHOP, "grid": GRID}, {"shop.electricity_facility": [0.0, 5.4e6, 3.6e6, 0.0]})
    text = district_section(Comparison((Run("rule", (), run),)))
    cells = [re.findall(r"<t[hd][^>]*>([^<]*)</t[hd]>", row) for row in re.findall(r"<tr>(.*?)</tr>", text)]
    assert ["shop", "electricity", NONE, "2.50", NONE, NONE, NONE, NONE] in cells
    (grid,) = [row for row in cells if row[0] == "grid"]
    assert grid[1:7] == ["electricity", "5", "5", "0.500", "0.150", f"{MINUS}0.650"]
    assert ["shop", "1", "1", "0.750", "Core"] in cells
    assert "as if occupied at all times" in text


def test_district_section__is_absent_without_a_district() -> None:
    run = plant_trajectory(district({"shop": SHOP}, {}), "shop")
    assert not plant_names(run.manifest)
    assert district_section(Comparison((Run("rule", (), run),))) == ""


def test_plant_trajectory__of_a_building_has_its_energy() -> None:
    """Only the names of its points are left of EnergyPlus's meters."""
    meters = {"electricity_facility": 3.6e6, "naturalgas_facility": 7.2e6, "hvac_electricity": 1.8e6}
    run = district({"shop": SHOP}, {f"shop.{name}": [0.0, joules, joules, 0.0] for name, joules in meters.items()})
    part = plant_trajectory(run, "shop")
    measured = MetricsAccumulator(part.manifest).measure(part)
    assert measured.energy_kwh == pytest.approx({"electricity": 2.0, "natural_gas": 4.0})
    assert measured.hvac_kwh == pytest.approx({"electricity": 1.0})
    assert measured.peak_kw == pytest.approx(2.0)
    assert {name: kwh.sum() for name, kwh in Quantities(part).energy_kwh.items()} == pytest.approx(
        {"electricity": 2.0, "natural gas": 4.0, "hvac_electricity": 1.0}
    )
