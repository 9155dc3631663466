"""Pictures of the control room for the documentation: `python tests/support/room_pictures.py` draws them again."""

import sys
import tempfile
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np

import zenostat
from support.control_room import Visitor, chromium, control_room
from support.nodes import NodeProgram, until
from zenostat.agent_sdk.controllers import Agent, load_controller, make_controller
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.views.room.app import RoomSettings

IMAGES = Path(__file__).parents[2] / "docs" / "images"
BUILDING: dict[str, Any] = {
    "building": "office-medium",
    "weather": "USA_CO_Denver",
    "begin": "07-01",
    "end": "07-07",
    "monitoring": True,
}
STEPS = 5 * 96 + 45  # 11:15 of the sixth day
ALARMS = """
alarms:
  - name: zone_too_warm
    points: "*_air_temperature"
    high: 26.0
    unit: degC
    deadband: 0.5
    delay_s: 900
    occupied: true
    priority: high
    text: Check the cooling of this zone.
"""


def control(bus: zenostat.Bus) -> zenostat.ControllerLink:
    """Control the office by rules until the picture's time, with two overrides of its operator in between."""
    agent = Agent(make_controller(load_controller("rbc"), bus.manifest("office"), {}))
    link = bus.controller("office", name="rbc")
    for sample in link:
        if sample.step == STEPS:
            return link
        if sample.step == STEPS - 30:
            day_s = 86400.0
            bus.write("office", "perimeter_mid_zn_3_cooling_setpoint", 28.0, duration_s=day_s, source="ada.lovelace")
            bus.write("office", "core_mid_cooling_setpoint", 23.0, duration_s=day_s, source="ada.lovelace")
        sample.send(agent.values(sample))
    return link


def picture(page: Any, name: str, *, full: bool = False) -> None:
    page.wait_for_timeout(1500)  # fonts, charts and the next poll
    page.screenshot(path=IMAGES / name, full_page=full)


def main() -> None:
    with tempfile.TemporaryDirectory(prefix="zt-", dir="/tmp") as folder:
        rules = Path(folder) / "alarms.yaml"
        rules.write_text(ALARMS)
        with (
            NodeProgram(Path(folder) / "node", **BUILDING, alarms=str(rules)) as node,
            zenostat.connect(node.endpoint, affinity=Affinity.OFF) as bus,
            control_room(node.endpoint, operator="ada.lovelace") as room,
            chromium() as browser,
        ):
            until_end = control(bus)
            dark = Visitor(browser, width=1440)
            dark.open(room.link).locator(".card").wait_for()
            page = dark.open(f"{room.url}/?node=office&range=72")
            page.locator(".trend-panel canvas").wait_for()
            picture(page, "room.png", full=True)
            page = dark.open(f"{room.url}/?node=office&point=core_mid_cooling_setpoint")
            page.locator(".drawer tr.effective").wait_for()
            picture(page, "room-point.png")
            light = Visitor(browser, width=1440, scheme="light")
            light.open(room.room.link("grace.hopper")).locator(".card").wait_for()
            page = light.open(f"{room.url}/?node=office&zone=7&tab=what-if")
            page.get_by_role("button", name="All cooling setpoints").click()
            page.get_by_role("spinbutton", name="All cooling setpoints").fill("26")
            page.get_by_role("button", name="Simulate").click()
            page.locator("table.totals").wait_for()
            page.set_viewport_size({"width": 1440, "height": 2400})  # the panel is as high as the window
            page.wait_for_timeout(1500)  # its chart
            page.locator(".panel", has=page.locator("table.totals")).screenshot(path=IMAGES / "room-what-if.png")
            until_end.close()
    systems()
    district()
    builder_and_trainings()


def builder_and_trainings() -> None:
    """The scenario builder with a node that was started from it, and three trainings whose rewards follow a formula."""
    with tempfile.TemporaryDirectory(prefix="zt-", dir="/tmp") as name:
        folder = Path(name)
        (folder / "scenarios").mkdir()
        for algorithm, seed, gain, steps in (
            ("ppo", 1, 85.0, 44_000),
            ("ppo", 2, 74.0, 31_000),
            ("sac", 1, 58.0, 44_000),
        ):
            learning_curve(folder / "runs" / f"{algorithm}-{seed}", algorithm, seed, gain, steps)
        with (
            NodeProgram(folder / "node", **{**BUILDING, "end": "07-01"}) as node,
            control_room(
                node.endpoint,
                operator="ada.lovelace",
                settings=RoomSettings(
                    scenarios=folder / "scenarios",
                    trainings=folder / "runs",
                    node_settings={"connect": [node.endpoint], "affinity": "off"},
                ),
            ) as room,
            chromium() as browser,
        ):
            visitor = Visitor(browser, width=1440)
            visitor.open(room.link).locator(".card").wait_for()
            page = visitor.open(f"{room.url}/?page=builder")
            page.get_by_text("No errors").wait_for()
            page.locator("#point-search").fill("core zone mean air temperature")
            page.locator(".point-results tbody button").first.click()
            page.locator("#scenario-name").fill("office-summer")
            page.locator("#node-name").fill("office-2")
            page.get_by_role("button", name="Save and start").click()
            page.get_by_role("link", name="Open office-2").wait_for()
            page.locator(".toast").last.wait_for(state="detached")
            picture(page, "room-builder.png")
            visitor = Visitor(browser, width=1440, scheme="light")
            visitor.open(room.room.link("grace.hopper")).locator(".card").first.wait_for()
            page = visitor.open(f"{room.url}/?page=trainings")
            page.locator(".legend li").nth(4).wait_for()
            picture(page, "room-trainings.png")


def learning_curve(folder: Path, algorithm: str, seed: int, gain: float, steps: int) -> None:
    """Write the files of a training whose reward approaches a limit."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng([seed, len(algorithm), steps])

    def reward(step: int) -> float:
        return float(-180 + gain * (1 - np.exp(-step / 11_000)) + rng.normal(0, 4))

    scenario = "office-small-USA_CO_Denver-continuous-v1"
    (folder / "training.yaml").write_text(f"algorithm: {algorithm}\nscenario: {scenario}\nsteps: 44000\nseed: {seed}\n")
    (folder / "versions.json").write_text('{"format": 1}')
    (folder / "scenario.yaml").write_text("building: office-small\nweather: [USA_CO_Denver]\n")
    episodes = [f"{step},0,{reward(step):.2f},672" for step in range(672, steps + 1, 672)]
    (folder / "curve.csv").write_text("\n".join(["step,slot,reward,steps", *episodes, ""]))
    evaluations = [f"{step},{10_000 + k},{reward(step):.2f}" for step in range(2000, steps + 1, 2000) for k in range(3)]
    (folder / "evaluations.csv").write_text("\n".join(["step,seed,reward", *evaluations, ""]))
    (folder / "references.csv").write_text("controller,seed,reward\nbaseline,10000,-135\nrbc,10000,-118\n")
    if steps == 44_000:
        (folder / "model.zip").write_bytes(b"")


def district() -> None:
    """The demonstration's district at 13:00 of its first day."""
    file = Path(__file__).parents[2] / "cosim" / "demo" / "district.yaml"
    with (
        tempfile.TemporaryDirectory(prefix="zt-", dir="/tmp") as folder,
        NodeProgram(Path(folder) / "node", module="zenostat.cosim", district=str(file), name="district") as node,
        zenostat.connect(node.endpoint, affinity=Affinity.OFF) as bus,
        control_room(node.endpoint, operator="ada.lovelace") as room,
        chromium() as browser,
    ):
        bus.pause("district")
        bus.pace("district", mode="free")
        bus.step("district", 52)
        until(lambda: bus.status("district").step[0] == 52, "13:00")
        visitor = Visitor(browser, width=1440)
        visitor.open(room.link).locator(".card").wait_for()
        page = visitor.open(f"{room.url}/?node=district")
        page.locator(".district-panel svg").wait_for()
        page.wait_for_timeout(1500)
        page.locator(".district-panel").screenshot(path=IMAGES / "room-district.png")


def systems() -> None:
    """The air loop of a storey of a large office, at noon of a summer day."""
    with tempfile.TemporaryDirectory(prefix="zt-", dir="/tmp") as folder:
        day: dict[str, Any] = {"building": "office-large", "weather": "USA_CO_Denver", "begin": "07-03", "end": "07-03"}
        with (
            NodeProgram(Path(folder) / "node", **day, monitoring=True, systems=True) as node,
            zenostat.connect(node.endpoint, affinity=Affinity.OFF) as bus,
            control_room(node.endpoint, operator="ada.lovelace") as room,
            chromium() as browser,
        ):
            bus.pause("office")
            bus.pace("office", mode="free")
            bus.step("office", bus.manifest("office").steps // 2)
            until(lambda: bus.status("office").step[0] == bus.manifest("office").steps // 2, "noon")
            visitor = Visitor(browser, width=1440)
            visitor.open(room.link).locator(".card").wait_for()
            loop = next(n for n, each in enumerate(bus.systems("office").loops) if each.name == "VAV_mid WITH REHEAT")
            page = visitor.open(f"{room.url}/?node=office&loop={loop}")
            page.locator(".schematic svg").wait_for()
            page.wait_for_timeout(1500)
            page.locator(".systems-panel").screenshot(path=IMAGES / "room-systems.png")


if __name__ == "__main__":
    main()
