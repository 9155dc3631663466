"""The scenario builder, trainings and the audit log of the control room in a real browser."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.control_room import NEEDS_CHROMIUM, Visitor, control_room, write_training
from support.nodes import NodeProgram, until
from support.tank_plant import TANK

import zenostat
from zenostat.topics import yaml12

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")

from zenostat.views.room.app import RoomSettings

pytestmark = [NEEDS_CHROMIUM, pytest.mark.process, pytest.mark.slow]

HOSTILE = "<img src=x onerror=\"document.title='taken'\">"


def training(folder: Path) -> None:
    write_training(folder, HOSTILE)
    (folder / "references.csv").write_text(f"controller,seed,reward\n{HOSTILE},1,-4\n")


def record(node: NodeProgram, file: Path) -> None:
    """Record a day of the tank, whose level rises."""
    with zenostat.connect(node.endpoint, affinity="off") as bus:
        bus.pause("tank")
        bus.pace("tank", mode="free")
        bus.record("tank", file, now=True)
        bus.step("tank", 1400)
        until(lambda: bus.status("tank").step == [1400], "it is simulated")
        bus.stop_recording("tank")


@pytest.fixture(scope="module")
def room(module_folder: Path) -> Iterator[Any]:
    (module_folder / "scenarios").mkdir()
    training(module_folder / "runs" / "ppo")
    training(module_folder / "runs" / HOSTILE.replace("/", "_"))
    with NodeProgram(module_folder / "node", plant=TANK, name="tank") as node:
        record(node, module_folder / "runs" / "ppo" / "day.mcap")
        settings = RoomSettings(
            scenarios=module_folder / "scenarios",
            trainings=module_folder / "runs",
            node_settings={"connect": [node.endpoint], "affinity": "off"},
        )
        with control_room(node.endpoint, settings=settings) as server:
            server.folder, server.endpoint = module_folder, node.endpoint
            yield server


def test_room__scenario_is_built_checked_saved_started_and_opened(ada: Visitor, room: Any) -> None:
    page = ada.open(f"{room.url}/?page=builder")
    page.get_by_text("No errors").wait_for()
    page.get_by_label("Building", exact=True).fill("ref-smal-office")
    page.locator(".check-errors li", has_text="no building 'ref-smal-office'").wait_for()
    page.get_by_label("Building", exact=True).fill("ref-small-office")
    page.get_by_text("No errors").wait_for()
    page.locator("#point-search").fill("core_zn zone air temperature")
    page.get_by_role("button", name="Add Zone Air Temperature CORE_ZN").click()
    page.get_by_label("Kind").last.select_option("linear")
    page.get_by_label("Weight", exact=True).fill("0.25")
    page.locator("#scenario-name").fill("mine")
    page.locator("pre", has_text="weight: 0.25").wait_for()
    page.get_by_role("button", name="Save", exact=True).click()
    page.locator(".toast", has_text="saved as mine.yaml").wait_for()
    saved = yaml12.read_mapping(room.folder / "scenarios" / "mine.yaml")
    assert saved["sensors"] == {"core_zn_zone_air_temperature": ["Zone Air Temperature", "CORE_ZN"]}
    assert saved["reward"] == {"kind": "linear", "weight": 0.25}
    assert yaml12.parse(page.locator("pre").inner_text(), "the page") == saved
    with page.expect_download() as download:
        page.get_by_role("button", name="Download").click()
    assert download.value.suggested_filename == "mine.yaml"
    page.locator("#node-name").fill("built")
    page.get_by_role("button", name="Save and start").click()
    page.get_by_role("link", name="Open built").click()
    page.locator(".zone[fill]").first.wait_for()
    with zenostat.connect(room.endpoint, affinity="off") as bus:
        manifest = bus.manifest("built")
        assert [point.name for point in manifest.sensors if point.observed] == ["core_zn_zone_air_temperature"]
        page = ada.open(f"{room.url}/?page=builder&scenario=mine")
        assert page.locator("#scenario-name").input_value() == "mine"
        page.get_by_role("button", name="End built").click()
        until(lambda: "built" not in bus.nodes(), "it has ended")
    page = ada.open(f"{room.url}/?page=audit")
    for change in ("save scenario", "start node", "end node"):
        page.locator("tbody tr", has_text=change).first.wait_for()


def test_room__curves_follow_a_training_and_texts_are_texts(ada: Visitor, room: Any) -> None:
    page = ada.open(f"{room.url}/?page=trainings&runs=ppo")
    page.locator(".legend li", has_text="ppo").wait_for()
    row = page.locator("tbody tr", has=page.get_by_role("checkbox", name="Draw ppo", exact=True))
    assert "200 of 400" in row.inner_text().replace("\N{NARROW NO-BREAK SPACE}", "")
    with (room.folder / "runs" / "ppo" / "evaluations.csv").open("a") as file:
        file.write("300,1,-1\n300,2,-1\n")
    row.get_by_text("300 of 400").wait_for()
    page.locator(".legend li", has_text="ppo").get_by_text("\N{MINUS SIGN}1").wait_for()
    page.locator(".legend li", has_text=HOSTILE[:20]).wait_for()  # the reference
    assert page.locator("img[src=x]").count() == 0
    assert page.title().startswith("Trainings")
    boxes = page.get_by_role("checkbox")
    assert [boxes.nth(place).is_checked() for place in range(2)].count(True) == 1
    boxes.nth(0).check()
    boxes.nth(1).check()
    until(lambda: page.locator(".legend li").count() >= 3, "both are drawn")
    assert "runs=" in page.url


def test_room__recording_is_replayed_from_its_page(ada: Visitor, room: Any) -> None:
    page = ada.open(f"{room.url}/?page=trainings")
    row = page.locator("tr", has=page.get_by_role("button", name="Replay ppo/day.mcap"))
    assert row.locator("td").first.inner_text() == "ppo"
    page.get_by_role("button", name="Replay ppo/day.mcap").focus()
    page.keyboard.press("Enter")
    assert page.get_by_label("Name of the node").input_value() == "day"
    page.get_by_label("Times the wall clock").fill("600")
    page.keyboard.press("Enter")
    page.get_by_role("link", name="Open day").focus()
    page.keyboard.press("Enter")
    page.locator(".u-wrap").wait_for()  # the trend since the page was opened
    clock = page.locator(".clock").inner_text()
    until(lambda: page.locator(".clock").inner_text() != clock, "it goes on")
    refusal = "This is the replay of a recording, which takes no requests."
    for name in ("Pause", "Record"):
        button = page.get_by_role("button", name=name, exact=True)
        assert (button.is_disabled(), button.get_attribute("title")) == (True, refusal)
    page.get_by_role("tab", name="What if").click()
    page.get_by_role("tabpanel", name="What if").get_by_text(refusal).wait_for()
    page = ada.open(f"{room.url}/?page=trainings")  # there the user may change things again
    page.get_by_role("button", name="End day").click()
    page.get_by_role("link", name="Open day").wait_for(state="detached")
    page = ada.open(f"{room.url}/?page=audit")
    page.locator("tbody tr", has_text="replay recording").first.wait_for()


@pytest.mark.parametrize("width", [320, 390, 700])
def test_room__new_pages_do_not_scroll_sideways(browser: Any, room: Any, width: int) -> None:
    visitor = Visitor(browser, width=width, scheme="light")
    visitor.open(room.room.link("grace")).locator(".card").first.wait_for()
    for view, shown in (("builder", "pre"), ("trainings", ".legend li"), ("audit", "tbody tr")):
        page = visitor.open(f"{room.url}/?page={view}")
        page.locator(shown).first.wait_for()
        assert page.evaluate("document.documentElement.scrollWidth") <= width
    visitor.close()


def test_room__keyboard_alone_reaches_all_pages(ada: Visitor, room: Any) -> None:
    page = ada.open(room.url)
    page.locator(".card").first.wait_for()
    for name in ("Scenario builder", "Trainings", "Audit log"):
        page.get_by_role("link", name=name).focus()
        page.keyboard.press("Enter")
        assert page.get_by_role("link", name=name).get_attribute("aria-current") == "page"
        assert page.title().startswith(name)
