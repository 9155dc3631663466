"""Controls that a user who only watches is offered, in a real browser over TLS: none that the server would refuse."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.control_room import NEEDS_CHROMIUM, control_room, violations, write_training
from support.nodes import NodeProgram, free_port, until
from support.tank_plant import TANK

import zenostat
from zenostat.topics.keys import Role

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")

from zenostat.views.room.app import RoomSettings
from zenostat.views.room.users import PageTls

pytestmark = [NEEDS_CHROMIUM, pytest.mark.process, pytest.mark.slow]

ALARMS = """
alarms:
  - {name: empty, points: [level], low: 5.0, unit: m, priority: high}
  - {name: low, points: [level], low: 6.0, unit: m}
"""
VIEWS = [
    ("", ".card"),
    ("?node=tank&tab=alarms&table=points", ".tab-panel .alarms li"),
    ("?node=tank&tab=events", "[role=tabpanel][aria-label=Events]"),
    ("?node=tank&tab=what-if", "[role=tabpanel][aria-label='What if'] > *"),
    ("?node=tank&tab=controllers", ".tab-panel .facts"),
    ("?node=tank&tab=faults", "[role=tabpanel][aria-label=Faults] > *"),
    ("?node=tank&point=pump", ".drawer tr.effective"),
    ("?page=trainings", ".legend li"),
]
"""Pages and tabs of every user, and what they have shown when they are complete."""

REFUSED = "wall may only read; changes need an operator."


def training(folder: Path) -> None:
    write_training(folder)
    (folder / "scenario.yaml").write_text("")
    (folder / "run.mcap").write_bytes(b"")


@pytest.fixture(scope="module")
def room(module_folder: Path, keys: Path) -> Iterator[Any]:
    """A control room with TLS, trainings and scenarios; its node is paused, with an alarm and an override."""
    (module_folder / "alarms.yaml").write_text(ALARMS)
    (module_folder / "scenarios").mkdir()
    training(module_folder / "runs" / "ppo")
    settings = {"plant": TANK, "name": "tank", "keys": str(keys)}
    settings |= {"listen": [f"tls/127.0.0.1:{free_port()}"], "alarms": str(module_folder / "alarms.yaml")}
    with (
        NodeProgram(module_folder / "node", **settings) as node,
        zenostat.connect(node.endpoint, affinity="off", keys=keys, role=Role.OPERATOR) as bus,
        control_room(
            node.endpoint,
            keys=keys,
            role=Role.GATEWAY,
            tls=PageTls(keys / "room.pem", keys / "room.key", keys),
            settings=RoomSettings(scenarios=module_folder / "scenarios", trainings=module_folder / "runs"),
        ) as server,
    ):
        bus.pause("tank")
        bus.pace("tank", mode="free")
        bus.step("tank", 3)
        bus.write("tank", "pump", 20.0)
        until(lambda: bus.status("tank").step == [3], "it is simulated")
        server.bus = bus
        yield server


class User:
    """A browser with the certificate of a name.

    Attributes:
        page: its page.
        changes: requests that it has sent to change something, with the status of each answer.
    """

    def __init__(self, browser: Any, room: Any, keys: Path, name: str, **options: Any) -> None:
        self.url = f"https://localhost:{room.url.rpartition(':')[2]}"
        files = {"certPath": str(keys / f"{name}.pem"), "keyPath": str(keys / f"{name}.key"), "origin": self.url}
        self._context = browser.new_context(ignore_https_errors=True, client_certificates=[files], **options)
        self._context.set_default_timeout(60_000)
        self.page = self._context.new_page()
        self.changes: list[tuple[str, int]] = []
        self.page.on("response", self._on_response)

    def _on_response(self, response: Any) -> None:
        if response.request.method != "GET" or response.status == 403:
            self.changes.append((response.url, response.status))

    def open(self, view: str, shown: str) -> Any:
        self.page.goto("about:blank")
        self.page.goto(f"{self.url}/{view}")
        self.page.locator(shown).first.wait_for()
        return self.page

    def close(self) -> None:
        self._context.close()


@pytest.fixture
def wall(browser: Any, room: Any, keys: Path) -> Iterator[User]:
    user = User(browser, room, keys, "wall")
    yield user
    user.close()


@pytest.mark.parametrize(("view", "shown"), VIEWS)
def test_room__monitor_is_offered_nothing_that_the_server_refuses(wall: User, view: str, shown: str) -> None:
    page = wall.open(view, shown)
    page.wait_for_timeout(500)  # what follows a first sample
    roots = ["#drawer"] if page.locator("#drawer > *").count() else ["main", "#header"]
    kinds = ("button", "select", "input")
    controls = page.locator(", ".join(f"{root} {kind}:enabled" for root in roots for kind in kinds))
    for place in range(controls.count()):
        control = controls.nth(place)
        if not control.is_visible():
            continue
        kind = control.evaluate("each => each.tagName + (each.type ?? '')")
        if kind.startswith("SELECT"):
            control.select_option(index=control.locator("option").count() - 1)
        elif kind == "INPUTcheckbox":
            control.click()
        elif kind.startswith("INPUT"):
            control.fill("pump")
            control.press("Enter")
        else:
            control.click()
        if page.locator("dialog[open]").count():
            page.keyboard.press("Escape")
            page.locator("dialog[open]").wait_for(state="detached")
    page.locator("body").press(" ")
    page.locator("body").press(".")
    page.wait_for_timeout(300)
    assert wall.changes == []
    assert page.locator(".toast.error").count() == 0


@pytest.mark.parametrize(
    ("view", "shown", "names"),
    [
        (*VIEWS[1], ["Resume", "One timestep", "Mode", "Speed", "Record", "Reset", "Acknowledge empty"]),
        (*VIEWS[6], ["Relinquish priority 8"]),
        (*VIEWS[7], ["Make a report of ppo", "Watch ppo on a node", "Replay ppo/run.mcap"]),
    ],
)
def test_room__monitor_sees_why_a_control_is_disabled(wall: User, view: str, shown: str, names: list[str]) -> None:
    page = wall.open(view, shown)
    for name in names:
        control = page.get_by_label(name, exact=True)
        assert control.is_disabled(), name
        assert control.get_attribute("title") == control.get_attribute("aria-description") == REFUSED


@pytest.mark.parametrize("place", [3, 5, 6])
def test_room__monitor_sees_a_reason_in_place_of_a_form(wall: User, place: int) -> None:
    page = wall.open(*VIEWS[place])
    page.locator("p:visible", has_text=REFUSED).first.wait_for()
    assert page.locator("form:visible").count() == 0


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_room__pages_of_a_monitor_have_contrast_names_and_structure(
    browser: Any, room: Any, keys: Path, scheme: str
) -> None:
    pytest.importorskip("axe_playwright_python", reason="pip install axe-playwright-python")
    user = User(browser, room, keys, "wall", color_scheme=scheme)
    for view, shown in VIEWS:
        page = user.open(view, shown)
        page.wait_for_timeout(400)  # transitions of colors
        assert violations(page) == [], view
    user.close()


def test_room__operator_is_offered_all_controls(browser: Any, room: Any, keys: Path) -> None:
    ada = User(browser, room, keys, "ada")
    for view, shown in VIEWS:
        page = ada.open(view, shown)
        assert page.get_by_text("who changes nothing").count() == 0
        assert page.locator("[aria-description]").count() == 0
    page = ada.open(*VIEWS[1])
    page.get_by_label("Acknowledge low", exact=True).click()
    with page.expect_response(lambda response: response.request.method == "POST"):
        page.locator("dialog").get_by_role("button", name="Acknowledge").click()
    until(lambda: room.bus.alarms("tank").alarms[1].state == "acknowledged", "it is acknowledged")
    assert [status for _, status in ada.changes] == [200]
    ada.close()
