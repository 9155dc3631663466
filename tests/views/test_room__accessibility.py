"""Contrast, names and structure of the pages of the control room, by axe-core: light, dark, as wide as a phone."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.control_room import NEEDS_CHROMIUM, Visitor, control_room, violations, write_training
from support.nodes import SMALL, NodeProgram, until

import zenostat

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
pytest.importorskip("axe_playwright_python", reason="pip install axe-playwright-python")

from zenostat.views.room.app import RoomSettings

pytestmark = [NEEDS_CHROMIUM, pytest.mark.process, pytest.mark.slow]

ALARMS = "alarms: [{name: warm, points: [core_zn_air_temperature], high: 10.0, unit: degC, priority: high}]\n"
DISTRICT = Path(__file__).parents[2] / "cosim" / "demo" / "district.yaml"
SETPOINT = "core_zn_cooling_setpoint"


def training(folder: Path) -> None:
    """Two trainings with a reference, one of them damaged, and a study."""
    for name in ("ppo", "study/trials/0000/training"):
        write_training(folder / name, "office")
        (folder / name / "references.csv").write_text("controller,seed,reward\nbaseline,1,-4\n")
        (folder / name / "scenario.yaml").write_text("")
    (folder / "study/trials/0000/trial.json").write_text('{"metric": "reward", "training": {"algorithm": "ppo"}}')
    (folder / "ppo" / "report.html").write_text("")
    (folder / "ppo" / "run.mcap").write_bytes(b"")
    (folder / "old").mkdir()
    (folder / "old" / "training.yaml").write_text("a: 1\n")


@pytest.fixture(scope="module")
def room(module_folder: Path) -> Iterator[Any]:
    """The control room of a paused office with an alarm, a fault and a command, and with trainings."""
    (module_folder / "alarms.yaml").write_text(ALARMS)
    (module_folder / "scenarios").mkdir()
    (module_folder / "scenarios" / "mine.yaml").write_text("building: office-small\nweather: USA_CO_Denver\n")
    training(module_folder / "runs")
    settings = RoomSettings(scenarios=module_folder / "scenarios", trainings=module_folder / "runs")
    office = {**SMALL, "alarms": str(module_folder / "alarms.yaml"), "monitoring": True, "systems": True}
    with (
        NodeProgram(module_folder / "node", **office) as node,
        zenostat.connect(node.endpoint, affinity="off") as bus,
        control_room(node.endpoint, settings=settings) as server,
    ):
        bus.pause("office")
        bus.pace("office", mode="free")
        bus.step("office", 30)
        bus.write("office", SETPOINT, 27.0, duration_s=3600.0, source="ada")
        until(lambda: bus.status("office").step == [30], "30 timesteps are simulated")
        yield server


@pytest.fixture(
    scope="module", params=[("light", 1280), ("dark", 1280), ("light", 360)], ids=["light", "dark", "phone"]
)
def visitor(browser: Any, room: Any, request: pytest.FixtureRequest) -> Iterator[Visitor]:
    scheme, width = request.param
    started = Visitor(browser, scheme=scheme, width=width)
    started.open(room.room.link("ada")).locator(".card").wait_for()
    yield started
    started.close()


@pytest.mark.parametrize(
    ("view", "shown"),
    [
        ("", ".card"),
        ("?node=office", ".zone[fill]"),
        ("?node=office&table=points&tab=faults", "table.points tbody tr"),
        ("?node=office&tab=events", ".tab-panel .log li"),
        ("?node=office&tab=controllers", ".tab-panel .facts"),
        ("?node=office&tab=what-if", ".tab-panel form"),
        ("?node=office&tab=what-if&try=controller", "#what-if-controller"),
        (f"?node=office&point={SETPOINT}", ".drawer tr.effective"),
        ("?page=builder&scenario=mine", ".check-errors li, p.fine"),
        ("?page=trainings", ".legend li"),
        ("?page=audit", ".audit tbody tr"),
    ],
)
def test_room__page_has_contrast_names_and_structure(visitor: Visitor, room: Any, view: str, shown: str) -> None:
    page = visitor.open(f"{room.url}/{view}")
    page.locator(shown).first.wait_for()
    page.wait_for_timeout(400)  # transitions of colors
    assert violations(page) == []


def test_room__filled_builder_has_contrast_names_and_structure(visitor: Visitor, room: Any) -> None:
    page = visitor.open(f"{room.url}/?page=builder")
    page.locator("#point-search").fill("core air temperature")
    page.locator(".point-results tbody button").first.click()
    page.get_by_role("button", name="List the default actuators").click()
    page.locator("input.bound").first.wait_for()
    page.get_by_role("button", name="Add a dimension").click()
    page.locator("#reward-kind").select_option("energy_cost")
    page.locator("details summary").click()
    page.locator(".check-errors li").first.wait_for()
    assert violations(page) == []


def test_room__answer_of_what_if_has_contrast_names_and_structure(visitor: Visitor, room: Any) -> None:
    page = visitor.open(f"{room.url}/?node=office&tab=what-if&try=controller")
    page.get_by_text("Parameters").click()
    page.get_by_text("Controllers that do not suit this node").click()
    page.locator("#hours").select_option("6")
    page.get_by_role("button", name="Simulate").click()
    page.locator("section[aria-labelledby=apply-controller]").wait_for()
    assert violations(page) == []


def test_room__dialogs_and_messages_have_contrast_names_and_structure(visitor: Visitor, room: Any) -> None:
    page = visitor.open(f"{room.url}/?node=office")
    page.get_by_role("button", name="Acknowledge warm").click()
    page.locator("dialog[open]").wait_for()
    assert violations(page) == []
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Record", exact=True).click()
    page.locator("#path").fill("relative.mcap")
    page.locator("dialog").get_by_role("button", name="Record").click()
    page.locator(".toast.error").wait_for()
    assert violations(page) == []
    page = visitor.open(f"{room.url}/?page=trainings")
    page.get_by_role("button", name="Replay ppo/run.mcap").click()
    page.locator("dialog[open]").wait_for()
    assert violations(page) == []


def test_room__sign_in_has_contrast_names_and_structure(browser: Any, room: Any) -> None:
    for scheme in ("light", "dark"):
        stranger = Visitor(browser, scheme=scheme)
        page = stranger.open(f"{room.url}/#token=wrong")
        page.locator(".sign-in [role=alert]").wait_for()
        assert violations(page) == []
        stranger.close()


def test_room__district_has_contrast_names_and_structure(browser: Any, scratch: Path) -> None:
    with (
        NodeProgram(scratch / "node", module="zenostat.cosim", district=str(DISTRICT), name="district") as node,
        control_room(node.endpoint) as server,
    ):
        for scheme in ("light", "dark"):
            visitor = Visitor(browser, scheme=scheme)
            visitor.open(server.room.link("ada")).locator(".card").wait_for()
            page = visitor.open(f"{server.url}/?node=district")
            page.locator(".district-panel svg").first.wait_for()
            assert violations(page) == []
            visitor.close()
