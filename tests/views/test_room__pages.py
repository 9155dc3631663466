"""Pages of the control room in a real browser: what they keep of files, samples, events and streams."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from support.control_room import NEEDS_CHROMIUM, Visitor, control_room, write_training
from support.nodes import NodeProgram, next_step, until

import zenostat
from zenostat.topics import yaml12
from zenostat.topics.messages import Event, EventKind, Reset

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")

from zenostat.views.room.app import RoomSettings

pytestmark = [NEEDS_CHROMIUM, pytest.mark.process, pytest.mark.slow]

TANK = '''
class Tank:
    """A tank of one level, which rises by what its valve lets in."""
    step_s = 3600.0
    begin = "2026-01-12T00:00"
    duration_s = 864000.0
    sensors = {"level": ("m", 0.0, None)}
    actuators = {"valve": ("kg/s", 0.0, 0.05, 0.0123)}

    def reset(self, seed):
        self.level = 0.0
        return {"level": self.level}

    def step(self, commands):
        self.level += commands["valve"]
        return {"level": self.level}


class Pair(Tank):
    """The valve is the third of all points, and the second actuator."""
    actuators = {"pump": ("kg/s", 0.0, 1.0, 0.5), "valve": ("kg/s", 0.0004, 15.125, 0.01)}


class Twin(Tank):
    """The valve is the third of all points as well, but the first actuator."""
    sensors = {"level": ("m", 0.0, None), "other": ("m", 0.0, None)}
    actuators = {"valve": ("kg/s", 0.0, 0.05, 0.01), "pump": ("kg/s", 0.0, 1.0, 0.5)}

    def reset(self, seed):
        return super().reset(seed) | {"other": 0.0}

    def step(self, commands):
        return super().step(commands) | {"other": 0.0}


class Same(Tank):
    """Its actuator has the name of its sensor."""
    actuators = {"level": ("kg/s", 0.0, 1.0, 0.5)}
    forkable = True

    def step(self, commands):
        return super().step({"valve": 2 * commands["level"]})


class Fast:
    """Thirty levels and four steps in a second."""
    step_s = 0.25
    begin = "2026-01-12T00:00"
    duration_s = 600.0
    sensors = {f"level_{place}": "m" for place in range(30)}
    actuators = {}

    def reset(self, seed):
        return dict.fromkeys(self.sensors, 0.0)

    def step(self, commands):
        return dict.fromkeys(self.sensors, 1.0)
'''
ALARMS = "alarms: [{name: empty, points: [level], low: -1.0, high: 30.0, unit: m, priority: high}]\n"
SCENARIO = """
building: ref-small-office
weather: [USA_CO_Denver]
begin: 07-03
end: 07-04
sensors:
  core: {key: CORE_ZN, variable: Zone Air Temperature}
  later: {lead_h: 1.0, key: BLDG_OCC_SCH, variable: Schedule Value}
actuators:
  cool: {component_type: Zone Temperature Control, control_type: Cooling Setpoint, key: CORE_ZN, high: 30.0}
"""


@pytest.fixture(scope="module")
def tank(module_folder: Path) -> Iterator[NodeProgram]:
    (module_folder / "tank.py").write_text(TANK)
    (module_folder / "alarms.yaml").write_text(ALARMS)
    settings = {"plant": f"{module_folder}/tank.py:Tank", "alarms": str(module_folder / "alarms.yaml")}
    with NodeProgram(module_folder / "node", name="tank", **settings) as node:
        yield node


@pytest.fixture(scope="module")
def bus(tank: NodeProgram) -> Iterator[zenostat.Bus]:
    """The bus of the tank, which is paused."""
    with zenostat.connect(tank.endpoint, affinity="off") as connected:
        connected.pause("tank")
        connected.pace("tank", mode="free")
        connected.step("tank")
        until(lambda: connected.status("tank").step == [1], "a timestep is simulated")
        yield connected


@pytest.fixture(scope="module")
def room(module_folder: Path, tank: NodeProgram, bus: zenostat.Bus) -> Iterator[Any]:
    (module_folder / "scenarios").mkdir()
    for name in ("ppo", "lr=1,seed=2", "50%2C"):
        write_training(module_folder / "runs" / name)
    settings = RoomSettings(scenarios=module_folder / "scenarios", trainings=module_folder / "runs")
    with control_room(tank.endpoint, settings=settings) as server:
        server.folder = module_folder
        yield server


@pytest.fixture(scope="module")
def ada(signed_in: Visitor) -> Iterator[Visitor]:
    yield signed_in
    assert [text for text in signed_in.complaints if "Failed to load resource" not in text] == []  # refusals


@pytest.fixture
def mine(room: Any) -> Path:
    """A saved scenario `mine`, whose points are mappings."""
    file: Path = room.folder / "scenarios" / "mine.yaml"
    file.write_text(SCENARIO)
    return file


def step_and_show(page: Any, bus: zenostat.Bus, node: str) -> None:
    """Simulate a timestep, and wait until the page shows it."""
    page.get_by_text(f"step {next_step(bus, node)} of ").wait_for()


def time_at(page: Any, share: float) -> str:
    """Time of the sample of the trends at a share of their width, as the page shows it below the pointer."""
    box = page.locator(".trend-panel .u-over").bounding_box()
    page.mouse.move(box["x"] + 2 + share * (box["width"] - 4), box["y"] + 60)
    return str(page.locator(".trend-panel .when").inner_text())


def drag(page: Any, begin: float, end: float) -> None:
    """Choose a part of the trends from one share of their width to another."""
    box = page.locator(".trend-panel .u-over").bounding_box()
    page.mouse.move(box["x"] + begin * box["width"], box["y"] + 60)
    page.mouse.down()
    page.mouse.move(box["x"] + end * box["width"], box["y"] + 60, steps=4)
    page.mouse.up()


def test_builder__new_scenario_is_not_the_one_that_was_opened(ada: Visitor, room: Any, mine: Path) -> None:
    page = ada.open(f"{room.url}/?page=builder&scenario=mine")
    page.locator("pre", has_text="BLDG_OCC_SCH").wait_for()
    page.get_by_role("button", name="New", exact=True).click()
    page.locator("pre", has_text="office-small").wait_for()
    assert "scenario=" not in page.url
    assert page.locator("#scenario-name").input_value() == "scenario"
    page.locator("#scenario-name").fill("mine")
    page.get_by_role("button", name="Save", exact=True).click()
    page.get_by_label("Replace the scenario").get_by_role("button", name="Cancel").click()
    assert mine.read_text() == SCENARIO
    page.go_back()
    page.locator("pre", has_text="BLDG_OCC_SCH").wait_for()
    assert page.locator("#scenario-name").input_value() == "mine"


def test_builder__save_asks_before_it_replaces_what_somebody_else_has_saved(
    ada: Visitor, room: Any, mine: Path
) -> None:
    page = ada.open(f"{room.url}/?page=builder&scenario=mine")
    page.locator("pre", has_text="BLDG_OCC_SCH").wait_for()
    page.get_by_role("button", name="Save", exact=True).click()
    page.locator(".toast", has_text="saved as mine.yaml").wait_for()
    mine.write_text("building: ref-small-office\n")
    page.get_by_label("high of cool").fill("29")
    page.get_by_label("high of cool").blur()
    page.get_by_role("button", name="Save", exact=True).click()
    dialog = page.get_by_label("Replace the scenario")
    dialog.get_by_text("Scenario 'mine' has changed since it was opened").wait_for()
    dialog.get_by_role("button", name="Replace").click()
    until(lambda: mine.read_text() != "building: ref-small-office\n", "it is replaced")
    assert yaml12.read_mapping(mine)["actuators"]["cool"]["high"] == 29


def test_builder__points_keep_their_fields_whatever_their_order(ada: Visitor, room: Any, mine: Path) -> None:
    page = ada.open(f"{room.url}/?page=builder&scenario=mine")
    page.locator(".chosen-point", has_text="Zone Air Temperature · CORE_ZN").wait_for()
    assert page.get_by_label("low of cool").input_value() == ""
    assert page.get_by_label("high of cool").input_value() == "30"
    page.get_by_label("low of cool").fill("22")
    page.get_by_label("Aggregation of core").select_option("sum")
    page.get_by_label("Aggregation of later").select_option("instant")
    page.get_by_label("high of cool").fill("")
    page.get_by_label("high of cool").blur()
    page.get_by_label("Name of Schedule Value, BLDG_OCC_SCH").fill("people")
    page.get_by_label("Name of Schedule Value, BLDG_OCC_SCH").blur()
    page.locator("pre", has_text="people").wait_for()
    page.get_by_role("button", name="Save", exact=True).click()
    page.locator(".toast", has_text="saved as mine.yaml").wait_for()
    saved = yaml12.read_mapping(mine)
    assert saved["sensors"] == {
        "core": {"variable": "Zone Air Temperature", "key": "CORE_ZN", "aggregation": "sum"},
        "people": {"variable": "Schedule Value", "key": "BLDG_OCC_SCH", "lead_h": 1.0, "aggregation": "instant"},
    }
    cooling = {"component_type": "Zone Temperature Control", "control_type": "Cooling Setpoint", "key": "CORE_ZN"}
    assert saved["actuators"] == {"cool": cooling | {"low": 22}}


def test_builder__points_of_lists_keep_their_fields(ada: Visitor, room: Any, mine: Path) -> None:
    actuator = ["Zone Temperature Control", "Cooling Setpoint", "CORE_ZN"]
    sensor = ["Schedule Value", "BLDG_OCC_SCH"]
    mine.write_text(
        SCENARIO.partition("sensors:")[0]
        + f"sensors: {{later: {[*sensor, 'mean', 1.0]}}}\nactuators: {{cool: {[*actuator, 18, 30]}}}\n"
    )
    page = ada.open(f"{room.url}/?page=builder&scenario=mine")
    page.get_by_label("Aggregation of later").select_option("instant")
    page.get_by_label("high of cool").fill("")
    page.get_by_label("high of cool").blur()
    page.get_by_label("Name of Zone Temperature Control, Cooling Setpoint, CORE_ZN").fill("cold")
    page.get_by_label("Name of Zone Temperature Control, Cooling Setpoint, CORE_ZN").blur()
    page.locator("pre", has_text="cold").wait_for()
    page.get_by_role("button", name="Save", exact=True).click()
    page.locator(".toast", has_text="saved as mine.yaml").wait_for()
    saved = yaml12.read_mapping(mine)
    assert saved["sensors"] == {"later": [*sensor, "instant", 1.0]}
    assert saved["actuators"] == {"cold": [*actuator, 18]}


def test_pages__hidden_page_has_no_stream_and_follows_again_when_it_is_shown(
    ada: Visitor, room: Any, bus: zenostat.Bus
) -> None:
    page = ada.open(f"{room.url}/?node=tank")
    page.locator(".clock").wait_for()
    until(lambda: room.room.updates.followers == 1, "only this page follows")
    hide = "hidden => { Object.defineProperty(document, 'hidden', {get: () => hidden, configurable: true}); "
    hide += "document.dispatchEvent(new Event('visibilitychange')); }"
    page.evaluate(hide, True)
    until(lambda: room.room.updates.followers == 0, "it does not follow")
    step = next_step(bus, "tank")
    page.evaluate(hide, False)
    page.get_by_text(f"step {step} of ").wait_for()
    assert page.get_by_text("no connection").is_hidden()
    page.evaluate(hide, True)
    until(lambda: room.room.updates.followers == 0, "it does not follow")
    page.get_by_role("link", name="Control room").click()  # another page in the same tab
    page.evaluate(hide, False)
    page.locator(".card").first.wait_for()
    assert room.room.updates.followers == 1


@contextmanager
def second_node(bus: zenostat.Bus, tank: NodeProgram, folder: Path, name: str, plant: str, **settings: Any) -> Any:
    """A paused node beside the tank, whose plant is another class of the same file."""
    settings |= {"plant": f"{folder}/tank.py:{plant}", "name": name, "connect": [tank.endpoint]}
    with NodeProgram(folder / name, **settings) as node:
        until(lambda: name in bus.nodes(), "it is on the bus")
        bus.pause(name)
        bus.pace(name, mode="free")
        yield node


@pytest.fixture
def bare(bus: zenostat.Bus, tank: NodeProgram, module_folder: Path) -> Iterator[NodeProgram]:
    """A second node of the bus, paused and without a history."""
    with second_node(bus, tank, module_folder, "bare", "Tank", history_mb=0.0) as node:
        yield node


def test_trends__samples_of_a_node_without_history_are_zoomed(
    ada: Visitor, room: Any, bus: zenostat.Bus, bare: NodeProgram
) -> None:
    page = ada.open(f"{room.url}/?node=bare&range=6")
    page.locator(".clock").wait_for()
    for _ in range(9):
        step_and_show(page, bus, "bare")
    until(lambda: time_at(page, 0.0).endswith("03:00"), "the last six hours are shown")
    drag(page, 0.3, 0.7)
    page.get_by_text("follow again").wait_for()
    until(lambda: time_at(page, 0.0).endswith("05:00"), "the chart begins with the first sample of the choice")
    step_and_show(page, bus, "bare")
    assert time_at(page, 1.0).endswith("07:00")
    page.get_by_role("button", name="all", exact=True).click()
    until(lambda: time_at(page, 1.0).endswith("10:00"), "all samples are shown")


def test_trends__range_drops_samples_that_are_older(ada: Visitor, room: Any, bus: zenostat.Bus) -> None:
    page = ada.open(f"{room.url}/?node=tank&range=6")
    page.locator(".trend-panel .u-over").wait_for()
    for _ in range(9):
        step_and_show(page, bus, "tank")
    before = bus.status("tank").step[0] - 6
    until(lambda: time_at(page, 0.0).endswith(f"{before % 24:02}:00"), "the chart begins six hours ago")


def test_trends__are_drawn_after_a_request_has_failed(ada: Visitor, room: Any, bus: zenostat.Bus) -> None:
    page = ada.open(f"{room.url}/?node=tank&range=all")
    page.locator(".trend-panel .u-over").wait_for()
    page.route("**/history?*", lambda route: route.fulfill(status=404, json={"message": "no node 'tank'"}))
    page.get_by_role("button", name="6 h", exact=True).click()
    page.locator(".trend-panel").get_by_text("no node 'tank'").wait_for()
    page.unroute("**/history?*")
    page.locator(".trend-panel .u-over").wait_for()


def test_trends__of_points_that_the_node_lacks_state_it(ada: Visitor, room: Any) -> None:
    page = ada.open(f"{room.url}/?node=tank&trend=core_zn_air_temperature")
    page.locator(".trend-panel").get_by_text("This node has none of the points that were chosen.").wait_for()


def test_trends__of_a_fast_plant_are_zoomed_to_seconds_and_name_the_lines_that_are_left_out(
    ada: Visitor, room: Any, bus: zenostat.Bus, tank: NodeProgram, module_folder: Path
) -> None:
    with second_node(bus, tank, module_folder, "fast", "Fast"):
        bus.step("fast", 80)
        until(lambda: bus.status("fast").step == [80], "20 s are simulated")
        chosen = ",".join(f"level_{place}" for place in range(30))
        page = ada.open(f"{room.url}/?node=fast&range=all&trend={chosen}")
        page.locator(".legend", has_text="the first 24; 6 others not drawn").wait_for()
        assert page.locator(".legend .swatch").count() == 24
        page.locator(".trend-panel .u-over").scroll_into_view_if_needed()
        until(lambda: time_at(page, 1.0) == "Mon 2026-01-12 00:00:20.000", "20 s are shown")
        drag(page, 0.3, 0.7)
        page.get_by_text("follow again").wait_for()
        until(lambda: time_at(page, 0.0).endswith("00:00:06.000"), "seconds 6 to 14 are shown")
        assert time_at(page, 1.0).endswith("00:00:14.000")


def test_point__forms_begin_with_the_whole_value(ada: Visitor, room: Any, bus: zenostat.Bus) -> None:
    bus.write("tank", "valve", 0.0012345, source="bob")
    step_and_show(ada.open(f"{room.url}/?node=tank"), bus, "tank")
    page = ada.open(f"{room.url}/?node=tank&point=valve")
    page.locator(".drawer").get_by_text("Set by bob").wait_for()
    assert float(page.locator("#override").input_value()) == pytest.approx(0.0012345, rel=1e-6)
    page = ada.open(f"{room.url}/?node=tank&tab=what-if")
    page.locator(".clock", has_text="2026").wait_for()
    page.locator("#what-if-point").fill("valve")
    page.get_by_role("button", name="Add", exact=True).click()
    assert float(page.locator(".what-if-row input").input_value()) == pytest.approx(0.0012345, rel=1e-6)
    bus.write("tank", "valve", None, source="bob")


def test_keys__held_space_resumes_once_and_scrolls_a_focused_list(ada: Visitor, room: Any) -> None:
    page, changes = ada.open(f"{room.url}/?node=tank"), []
    page.get_by_role("button", name="Resume").wait_for()

    def accept(route: Any) -> None:
        changes.append(route.request.url.rpartition("/")[2])
        route.fulfill(json={"text": "accepted"})

    page.route("**/tank/resume", accept)
    with page.expect_response("**/resume"):
        for _ in range(5):
            page.keyboard.down(" ")  # but for the first, they repeat it
        page.keyboard.up(" ")
    page.keyboard.press("Shift+ ")
    page.get_by_role("tab", name="All points").focus()
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.matches('.scroll')")
    page.keyboard.press(" ")
    page.locator("main").focus()
    with page.expect_response("**/resume"):
        page.keyboard.press(" ")
    assert changes == ["resume"] * 2
    page.unroute("**/tank/resume")


def test_events__page_has_those_that_the_stream_leaves_out(ada: Visitor, room: Any) -> None:
    page = ada.open(f"{room.url}/?node=tank&tab=events")
    watch = room.room.watch.find("tank")
    watch.add_event(Event(kind=EventKind.WARNING, text="the first"))
    page.locator(".tab-panel .log", has_text="the first").wait_for()
    for number in range(150):  # many more than a message of the stream has
        watch.add_event(Event(kind=EventKind.WARNING, text=f"number {number}"))
    until(lambda: page.locator(".tab-panel .log li", has_text="number ").count() == 150, "all are shown")
    numbers = page.locator(".tab-panel .log li").evaluate_all("rows => rows.map(row => Number(row.dataset.number))")
    assert numbers == [*range(numbers[0], numbers[0] - len(numbers), -1)]


def test_point__events_are_its_own_with_their_kind(ada: Visitor, room: Any) -> None:
    page = ada.open(f"{room.url}/?node=tank&point=valve")
    watch = room.room.watch.find("tank")
    for kind, text in (
        (EventKind.WRITTEN, "main_valve = 1 kg/s"),
        (EventKind.WRITTEN, "valve_2 = 1 kg/s"),
        (EventKind.WRITTEN, "north.valve = 1 kg/s"),
        (EventKind.REJECTED, "valve = 9 kg/s; its bounds are 0 to 0.05 kg/s"),
        (EventKind.WARNING, "no value of valve."),
    ):
        watch.add_event(Event(kind=kind, text=text))
    page.locator(".drawer .log", has_text="warning no value of valve.").wait_for()
    shown = [text for text in page.locator(".drawer .log li").all_inner_texts() if "valve" in text]
    assert "rejected valve = 9 kg/s; its bounds are 0 to 0.05 kg/s" in shown[1]
    assert not any("main" in text or "valve_2" in text or "north" in text for text in shown)


CONDITION = """async ([module, point, alarm]) => {
    const { AlarmPanel } = await import(module);
    return new AlarmPanel(document.createElement("div"), "node", { points: [point] }).condition(alarm);
}"""


@pytest.mark.parametrize(
    ("unit", "shown", "value", "limit", "expected"),
    [
        ("1", {"unit": ""}, 0.123, 0.1, "0.123, high limit 0.1"),
        ("percent", {"unit": "%"}, 62.5, 50.0, "62.5\u00a0%, high limit 50\u00a0%"),
        ("degF", {"unit": "°F"}, 70.0, 60.0, "70\u00a0°F, high limit 60\u00a0°F"),
        ("W", {"unit": "kW", "factor": 1e-3}, 123_457.0, 1000.0, "123\u00a0kW, high limit 1\u00a0kW"),
        # 10 minutes at 1.5 kW
        ("J", {"unit": "kW", "factor": 1 / 600e3}, 900e3, 600e3, "1.50\u00a0kW, high limit 1\u00a0kW"),
    ],
)
def test_alarms__values_and_limits_are_in_the_units_of_the_page(
    ada: Visitor, room: Any, unit: str, shown: dict[str, Any], value: float, limit: float, expected: str
) -> None:
    page = ada.open(room.url)
    page.locator(".card").first.wait_for()
    alarm = {"point": "p", "unit": unit, "value": value, "high": limit, "event_state": "high_limit"}
    assert page.evaluate(CONDITION, [f"{room.url}/static/panels.js", {"id": "p", **shown}, alarm]) == expected


def test_alarms__missing_value_is_named(ada: Visitor, room: Any, bus: zenostat.Bus) -> None:
    bus.faults("tank", {"faults": [{"kind": "drop", "points": ["level"]}]})
    bus.step("tank")
    page = ada.open(f"{room.url}/?node=tank")
    shown = page.locator(".alarms li", has_text="empty")
    shown.get_by_text("value is missing").wait_for()
    assert "30" not in shown.locator("p").first.inner_text()
    bus.faults("tank", {"faults": []})
    bus.step("tank")
    shown.get_by_text("normal again").wait_for()


def test_point__panel_follows_a_node_that_restarts_with_others(
    ada: Visitor, room: Any, bus: zenostat.Bus, tank: NodeProgram, module_folder: Path
) -> None:
    def node(plant: str) -> NodeProgram:
        settings = {"plant": f"{module_folder}/tank.py:{plant}", "name": "pair", "connect": [tank.endpoint]}
        return NodeProgram(module_folder / plant, **settings)

    with node("Pair"):
        until(lambda: "pair" in bus.nodes(), "it is on the bus")
        page = ada.open(f"{room.url}/?node=pair&point=valve")
        page.locator(".drawer").get_by_text("Under baseline control").wait_for()
        assert page.locator(".override").get_by_text("Bounds: 0.0004 to 15.125").is_visible()
        bus.stop("pair")
        page.get_by_text("The node has ended.").wait_for()
    with node("Twin"):
        until(lambda: "pair" in bus.nodes(), "it is on the bus")
        bus.pause("pair")
        bus.pace("pair", mode="free")
        bus.write("pair", "valve", 0.02, source="bob")
        bus.step("pair")
        page.locator(".drawer").get_by_text("Set by bob to 0.02").wait_for()
        bus.stop("pair")


@pytest.fixture
def same(bus: zenostat.Bus, tank: NodeProgram, module_folder: Path) -> Iterator[NodeProgram]:
    """A node whose level and actuator have one name, paused at 0 m; its alarm is active from the first timestep on."""
    (module_folder / "full.yaml").write_text(ALARMS.replace("30.0", "0.0625"))
    with second_node(bus, tank, module_folder, "same", "Same", alarms=str(module_folder / "full.yaml")) as node:
        yield node


def test_points__sensor_and_actuator_of_one_name_are_two(
    ada: Visitor, room: Any, bus: zenostat.Bus, same: NodeProgram
) -> None:
    page = ada.open(f"{room.url}/?node=same&table=points")
    rows = page.locator("table.points tbody tr")
    for place in (0, 1):
        rows.nth(place).get_by_role("button", name="Trend of").click()
    page.locator(".legend li").nth(1).wait_for()
    for _ in range(2):
        step_and_show(page, bus, "same")
    until(lambda: page.locator(".legend-value").all_inner_texts() == ["2\u00a0m", "0.5\u00a0kg/s"], "1 m in each step")
    page.locator(".alarms li", has_text="high limit 0.0625\u00a0m").wait_for()
    assert rows.locator(".chip.alarm").count() == rows.nth(0).locator(".chip.alarm").count() == 1
    rows.nth(1).locator("th button").click()
    page.locator("#override").fill("0.25")
    page.get_by_role("button", name="Override", exact=True).click()
    page.locator(".drawer tr.effective", has_text="ada").wait_for()
    assert bus.priorities("same")["level"][7].value == 0.25
    rows.nth(0).locator("th button").click()
    page.locator(".drawer .big", has_text="2\u00a0m").wait_for()
    assert page.locator("#override").count() == 0
    page = ada.open(f"{room.url}/?node=same&tab=what-if")
    page.locator("#what-if-point").fill("level")
    page.get_by_role("button", name="Add", exact=True).click()
    assert page.locator(".what-if-row .unit").inner_text() == "kg/s"
    page = ada.open(f"{room.url}/?node=same&tab=faults")
    for place, point in enumerate(("level", "actuator/level")):
        page.locator("#fault-point").fill(point)
        page.get_by_role("button", name="Inject").click()
        page.locator("ul[aria-label='Injected faults'] li").nth(place).wait_for()
    assert page.locator("ul[aria-label='Injected faults'] li span:first-child").all_inner_texts() == [
        "bias, level, offset 2\u00a0m", "bias, level, offset 2\u00a0kg/s",
    ]  # fmt: skip
    assert [(fault.points, fault.actuators) for fault in bus.fault_plan("same").faults] == [
        (("level",), ()), ((), ("level",)),
    ]  # fmt: skip


def test_what_if__answer_is_of_its_episode(ada: Visitor, room: Any, bus: zenostat.Bus, same: NodeProgram) -> None:
    page = ada.open(f"{room.url}/?node=same&tab=what-if")
    page.locator(".clock", has_text="2026").wait_for()
    for _ in range(2):
        page.locator("#what-if-point").fill("level")
        page.get_by_role("button", name="Add", exact=True).click()
        page.get_by_role("button", name="Remove Level").focus()
        page.keyboard.press("Space")
        page.locator(".what-if-row").wait_for(state="detached")
        page.keyboard.press("Space")  # the button is gone; it is no request to go on
    page.locator("#what-if-point").fill("level")
    page.get_by_role("button", name="Add", exact=True).click()
    page.get_by_role("button", name="Simulate").click()
    page.get_by_role("heading", name="24 h from Mon 12 Jan 2026, 00:00").wait_for()
    apply = page.get_by_role("button", name="Apply for 24 h")
    assert apply.is_enabled()
    bus.reset("same", Reset(controller="eve"))
    page.get_by_text("The node has begun another episode since.").wait_for()
    assert apply.is_disabled()
    assert bus.status("same").paused
    bus.step("same", 236)  # of 240 h
    page.get_by_text("step 236 of ").wait_for()
    page.get_by_role("button", name="Simulate").click()
    page.get_by_role("heading", name="4 h from Wed 21 Jan 2026, 20:00, to the end of the episode").wait_for()


def test_trainings__names_with_commas_are_chosen(ada: Visitor, room: Any) -> None:
    page = ada.open(f"{room.url}/?page=trainings")
    page.get_by_role("checkbox", name="Draw ppo", exact=True).uncheck()
    page.locator(".legend li", has_text="ppo").wait_for(state="detached")
    for _ in range(2):
        for name in ("lr=1,seed=2", "50%2C"):
            assert page.get_by_role("checkbox", name=f"Draw {name}", exact=True).is_checked()
            page.locator(".legend li", has_text=name).wait_for()
        assert not page.get_by_role("checkbox", name="Draw ppo", exact=True).is_checked()
        page = ada.open(page.url)  # the address has the choice
        page.locator(".legend li").first.wait_for()


def test_audit__training_is_not_a_link_to_a_node(ada: Visitor, room: Any) -> None:
    page = ada.open(f"{room.url}/?page=trainings")
    page.get_by_role("button", name="Make a report of ppo").click()
    page.locator(".toast").wait_for()
    page = ada.open(f"{room.url}/?page=audit")
    row = page.locator("tbody tr", has_text="make report")
    row.get_by_text("ppo", exact=True).wait_for()
    assert row.locator("a").count() == 0


def test_pages__unknown_name_shows_the_nodes(ada: Visitor, room: Any) -> None:
    for name in ("constructor", "toString", "nothing"):
        page = ada.open(f"{room.url}/?page={name}")
        page.locator(".card").first.wait_for()
        assert page.title() == "Control room"


def test_pages__used_link_leaves_a_browser_signed_in(browser: Any, room: Any) -> None:
    visitor = Visitor(browser)
    link = room.room.link("eve")
    visitor.open(link).locator(".card").first.wait_for()
    page = visitor.open(link)
    page.locator(".card").first.wait_for()
    assert "token" not in page.url
    visitor.close()


CHART = """async ([module, ...parts]) => {
    const { chart } = await import(module), root = document.createElement("div");
    document.body.append(root);
    const series = parts.map(([unit, values]) => ({ label: unit, unit, color: "#2878dc", values }));
    const plot = chart(root, { time: parts[0][1].map((_, place) => 1e9 + 3600 * place), series });
    await new Promise(requestAnimationFrame);
    const range = ({ scale }) => [plot.scales[scale].min, plot.scales[scale].max];
    return [[plot.scales.x.min, plot.scales.x.max], ...plot.series.slice(1).map(range)];
}"""


@pytest.mark.parametrize("units", [["x"], ["degC", "x"], ["", "1"], ["a", "b", "c", "d", "e"]])
def test_chart__values_of_each_unit_are_within_their_scale(ada: Visitor, room: Any, units: list[str]) -> None:
    page = ada.open(room.url)
    page.locator(".card").first.wait_for()
    parts = [[unit, [10.0**place, 2 * 10.0**place, 3 * 10.0**place]] for place, unit in enumerate(units)]
    times, *ranges = page.evaluate(CHART, [f"{room.url}/static/trends.js", *parts])
    assert times == [1e9, 1e9 + 7200]
    for (low, high), (_, values) in zip(ranges, parts, strict=True):
        assert low <= values[0] < values[2] <= high
        assert high - low < 2 * (values[2] - values[0])


SINGLE = """async (module) => {
    const { chart } = await import(module), root = document.createElement("div");
    document.body.append(root);
    const series = [{ label: "air", unit: "degC", color: "#2878dc", values: [20] }];
    const plot = chart(root, { time: [1e9], series });
    await new Promise(requestAnimationFrame);
    const at = (value, scale) => Math.round(plot.valToPos(value, scale, true));
    const isMarked = plot.ctx.getImageData(at(1e9, "x"), at(20, "unit degC"), 1, 1).data[3] > 0;
    const single = [plot.scales.x.min, plot.scales.x.max, isMarked];
    plot.setData([[1e9, 1e9 + 600], [20, 21]]);
    await new Promise(requestAnimationFrame);
    return [single, [plot.scales.x.min, plot.scales.x.max]];
}"""


def test_chart__single_sample_is_marked_on_an_axis_of_an_hour(ada: Visitor, room: Any) -> None:
    page = ada.open(room.url)
    page.locator(".card").first.wait_for()
    single, two = page.evaluate(SINGLE, f"{room.url}/static/trends.js")
    assert single == [1e9 - 1800, 1e9 + 1800, True]
    assert two == [1e9, 1e9 + 600]


def test_chart__axis_of_people_has_whole_numbers(ada: Visitor, room: Any) -> None:
    page = ada.open(room.url)
    page.locator(".card").first.wait_for()
    _, (low, high) = page.evaluate(CHART, [f"{room.url}/static/trends.js", ["people", [0, 0, 0]]])
    assert (low, high) == (0, 1)


def test_trends__legend_keeps_the_focus_of_a_line_that_is_removed(ada: Visitor, room: Any, bus: zenostat.Bus) -> None:
    page = ada.open(f"{room.url}/?node=tank&trend=level,valve")
    page.get_by_role("button", name="Remove Valve").focus()
    page.keyboard.press("Space")
    page.get_by_role("button", name="Remove Valve").wait_for(state="detached")
    page.keyboard.press("Space")  # the button is gone; it is no request to go on
    assert page.evaluate("document.activeElement.matches('.legend')")
    assert bus.status("tank").paused


BAND = """async ([module, low, high]) => {
    const { chart } = await import(module), root = document.createElement("div");
    document.body.append(root);
    const time = low.map((_, place) => 1e9 + 3600 * place), values = low.map((_, place) => 20 + place);
    const series = [{ label: "air", unit: "°C", color: "#2878dc", values }];
    const plot = chart(root, { time, series, band: { unit: "°C", low, high } });
    await new Promise(requestAnimationFrame);
    const { data } = plot.ctx.getImageData(0, 0, plot.ctx.canvas.width, plot.ctx.canvas.height);
    const isShaded = (time, value) => {
        const at = Math.round(plot.valToPos(value, "unit °C", true)) * plot.ctx.canvas.width;
        return data[4 * (at + Math.round(plot.valToPos(time, "x", true))) + 3] > 0;
    };
    return [0.4, 1.4, 2.4, 3.4].map((hour) => [20.3, 22.3].map((value) => isShaded(1e9 + 3600 * hour, value)));
}"""


def test_chart__band_is_that_of_each_timestep(ada: Visitor, room: Any) -> None:
    page = ada.open(room.url)
    page.locator(".card").first.wait_for()
    low, high = [20.1, 20.1, 22.1, None, 20.1], [20.9, 20.9, 22.9, None, 22.9]
    shaded = page.evaluate(BAND, [f"{room.url}/static/trends.js", low, high])
    assert shaded == [[True, False], [False, True], [False, False], [True, True]]


SCHEMATIC = """async (module) => {
    const { Schematic } = await import(module), root = document.createElement("div");
    document.body.append(root);
    const zones = Array.from({ length: 400 }, (_, place) => ({ name: `Room ${place}`, zone: null, equipment: [] }));
    new Schematic(root, { points: [], zones: [], systems: { components: [], loops: [], zones } }).onView();
    const drawn = () => root.querySelectorAll(".plain-zone").length, more = root.querySelector(".wide-button");
    const first = [drawn(), more.hidden, more.textContent];
    more.click();
    return [...first, drawn(), more.hidden];
}"""


def test_schematic__many_zones_are_drawn_when_they_are_wanted(ada: Visitor, room: Any) -> None:
    page = ada.open(room.url)
    page.locator(".card").first.wait_for()
    shown = page.evaluate(SCHEMATIC, f"{room.url}/static/schematic.js")
    assert shown == [30, False, "370 more zones", 400, True]


FORMAT = "async ([module, name, ...values]) => (await import(module))[name](...values)"


@pytest.mark.parametrize(
    ("name", "values", "text"),
    [
        ("withUnit", [0.0002, "kW"], "0.2\u00a0W"),
        ("withUnit", [-0.0123456, "kW"], "\u221212.3\u00a0W"),
        ("withUnit", [0.5, "kW"], "0.500\u00a0kW"),
        ("withUnit", [0.0, "kW"], "0\u00a0kW"),
        ("withUnit", [1e-14, "kW"], "0\u00a0kW"),
        ("ticks", [[0.0, 0.1, 0.2]], ["0.0", "0.1", "0.2"]),
        ("ticks", [[0.0, 2.5, 5.0, 7.5]], ["0.0", "2.5", "5.0", "7.5"]),
        ("ticks", [[0.0, 2e-7, 4e-7]], ["0", "2e\u22127", "4e\u22127"]),
        ("ticks", [[0.0010005, 0.001001, 0.0010015]], ["1.0005e\u22123", "1.0010e\u22123", "1.0015e\u22123"]),
        ("ticks", [[-1.00015e6, -1.0001e6]], ["\u22121.00015e+6", "\u22121.00010e+6"]),
    ],
)
def test_format__small_and_close_numbers_are_told_apart(
    ada: Visitor, room: Any, name: str, values: list[Any], text: str | list[str]
) -> None:
    page = ada.open(room.url)
    assert page.evaluate(FORMAT, [f"{room.url}/static/format.js", name, *values]) == text
