"""A district in the control room: its grid, members, market and solved loop, in a real browser."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from support.builders import manifest, sensor
from support.control_room import NEEDS_CHROMIUM, Visitor, chromium, control_room
from support.nodes import NodeProgram, until

import zenostat

pytest.importorskip("starlette")

from zenostat.topics.messages import DistrictMember, ElectricGrid, GridBranch, GridDevice, Systems
from zenostat.views.room.description import describe
from zenostat.views.room.numbers import to_json

HOUSE = '''
class House:
    """A house whose power follows the voltage and the price."""
    step_s, begin, duration_s = 900.0, "2026-07-06T00:00", 86400.0
    sensors = {"power": "W"}
    actuators = {"voltage": ("pu", 0.0, 2.0, 1.0), "price": ("EUR/kWh", 0.0, 2.0, 0.2)}
    forkable = True

    def reset(self, seed):
        return {"power": 20_000.0}

    def step(self, commands):
        return {"power": 20_000.0 * commands["voltage"] ** 2 * (1.2 - commands["price"])}
'''
GRID = """
name: feeder
begin: "2026-07-06T00:00"
duration_s: 86400
step_s: 900
source: {bus: station}
buses: {station: {voltage_kv: 0.4}, north: {voltage_kv: 0.4}, spare: {voltage_kv: 0.4}}
lines:
  cable: &cable
    {from: station, to: north, length_m: 300, resistance_ohm_km: 0.2, reactance_ohm_km: 0.08, ampacity_a: 100}
  tie: {<<: *cable, from: spare, to: north}
loads: {house: {bus: north}}
pv: {roof: {bus: spare, power_w: 5000}}
"""
DISTRICT = """
name: street
timestep: 15min
duration: 1d
plants:
  market:
    market: {low: 0.2, high: 0.8, limit_w: 90000, bidders: [{demand: shop.power, slope_w: -1000}], bids: linear}
  shop: {plant: "house.py:House"}
  house: {plant: "house.py:House"}
  feeder: {grid: feeder.yaml}
connections:
  - {from: market.price, to: shop.price, name: price}
  - {from: house.power, to: feeder.house_demand, name: power}
  - {from: feeder.north_voltage, to: house.voltage, name: voltage, solve: true, tolerance: 0.0001, initial: 1}
"""


def test_district__grid_has_its_points_and_members_have_theirs() -> None:
    grid = ElectricGrid(
        prefix="feeder.",
        source="a",
        buses=("a", "b"),
        branches=(GridBranch(name="cable", kind="line", start="a", end="b"),),
        devices=(GridDevice(name="cells", kind="battery", bus="b"),),
    )
    members = (DistrictMember(name="feeder", kind="grid"), DistrictMember(name="deal", kind="market"))
    names = (
        "feeder.b_voltage", "feeder.cable_loading", "feeder.cells_power", "feeder.import", "deal.price",
        "residual.heat", "loop.heat.trials", "loop.heat.residual", "plant.feeder.available",
    )  # fmt: skip
    of = manifest(sensors=[sensor(name) for name in names])
    content = describe(of, None, Systems(grids=(grid,), members=members)).content["systems"]
    (drawn,) = content["grids"]
    assert [bus["voltage"] for bus in drawn["buses"]] == [None, 0]
    assert [branch["loading"] for branch in drawn["branches"]] == [1]
    assert [(device["power"], device["charge"]) for device in drawn["devices"]] == [(2, None)]
    feeder, deal = content["members"]
    assert (feeder["available"], feeder["power"], feeder["market"]) == (8, 3, None)
    assert deal["market"]["price"] == 4
    assert [each["residual"] for each in content["solved"]] == [5, 7]
    to_json(content)


@pytest.fixture
def street(module_folder: Path) -> Iterator[NodeProgram]:
    for name, text in (("house.py", HOUSE), ("feeder.yaml", GRID), ("street.yaml", DISTRICT)):
        (module_folder / name).write_text(text)
    file = str(module_folder / "street.yaml")
    with NodeProgram(module_folder / "node", module="zenostat.cosim", district=file, name="street") as node:
        yield node


@pytest.mark.process
@pytest.mark.slow
@NEEDS_CHROMIUM
def test_room__district_shows_its_grid_members_market_and_loop(street: NodeProgram, module_folder: Path) -> None:
    pytest.importorskip("playwright.sync_api", reason="pip install playwright")
    pytest.importorskip("power_grid_model")
    with (
        zenostat.connect(street.endpoint, affinity="off") as bus,
        control_room(street.endpoint) as room,
        chromium() as browser,
    ):
        bus.pause("street")
        bus.pace("street", mode="free")
        bus.step("street", 3)
        until(lambda: bus.status("street").step == [3], "three timesteps are simulated")
        visitor = Visitor(browser, width=390)
        visitor.open(room.link).locator(".card").wait_for()
        page = visitor.open(f"{room.url}/?node=street")
        page.locator(".one-line svg").wait_for()
        sample = bus.read("street")
        assert page.locator(".one-line .box").count() == 4  # two lines, a load, PV
        assert page.locator(".one-line .bus").count() == 3
        cable = page.locator(".one-line .box[aria-label^='line cable']")
        assert f"{sample['feeder.cable_loading']:.1f}" in cable.get_attribute("aria-label")
        assert f"{sample['feeder.north_voltage']:.3f}" in page.locator(".one-line").inner_text()
        rows = page.locator("table.members tbody tr").all_inner_texts()
        assert [row.split("\t")[0].strip() for row in rows] == ["market", "shop", "house", "feeder"]
        assert all("available" in row for row in rows)
        house = page.locator("table.members tr", has_text="house")
        with NodeProgram(
            module_folder / "house", plant=f"{module_folder}/house.py:House", name="street.house",
            connect=[street.endpoint],
        ):  # fmt: skip
            house.get_by_role("link").wait_for()
            bus.pause("street.house")
            house.get_by_role("cell", name="paused").wait_for()
            bus.resume("street.house")
            house.get_by_role("cell", name="available").wait_for()
            bus.stop("street.house")
            house.get_by_role("link").wait_for(state="hidden")  # though the list of nodes still has it
            assert house.get_by_role("button").is_visible()
        loop = page.locator("table.solved tr", has_text="loop")
        assert "solved" in loop.inner_text()
        assert "0.2" in page.locator(".district-panel dl").inner_text()  # the lowest price, without congestion
        cable.focus()
        page.keyboard.press("Enter")
        page.locator(".drawer").wait_for()
        assert "point=feeder.cable_loading" in page.url
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        assert visitor.complaints == []
        visitor.close()
