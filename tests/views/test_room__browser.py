"""The control room in a real browser, with a running building. Skipped where Chromium or playwright is missing."""

import json
import signal
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any
from urllib.parse import quote

import httpx
import pytest
from support.control_room import NEEDS_CHROMIUM, Visitor, control_room, violations
from support.nodes import SMALL, NodeProgram, free_port, next_step, nothing_left, until
from support.run_cli import ZENOSTAT

import zenostat

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
pytestmark = [NEEDS_CHROMIUM, pytest.mark.process]

HOSTILE = "<img src=x onerror=\"document.title='taken'\">"
API_TOKEN = "a-token-of-programs-of-the-tests-1"
SETPOINT = "core_zn_cooling_setpoint"
ALARMS = """
alarms:
  - name: warm
    points: [core_zn_air_temperature]
    high: 10.0
    unit: degC
    deadband: 0.5
    max_shelve_s: 7200
    priority: high
    text: Check the cooling.
"""
TANK = '''
class Tank:
    """A tank of one temperature; its heater has a power."""
    step_s = 60.0
    begin = "2026-01-12T00:00"
    duration_s = 86400.0
    sensors = {"level": ("m", 0.0, 10.0)}
    actuators = {"pump": ("W", 0.0, 100.0, 5.0)}

    def reset(self, seed):
        self.level = 1.0
        return {"level": self.level}

    def step(self, commands):
        self.level = min(10.0, self.level + 1e-4 * commands["pump"])
        return {"level": self.level}
'''


LONG_NAMES = """() => document.querySelectorAll(".crumb, .bar-time > .muted, .drawer h2, .drawer .code")
    .forEach(element => { element.textContent = "a_long_name".repeat(9); })"""


@pytest.fixture(scope="module")
def office(module_folder: Path) -> Iterator[NodeProgram]:
    rules = module_folder / "alarms.yaml"
    rules.write_text(ALARMS)
    with NodeProgram(module_folder / "node", **SMALL, alarms=str(rules)) as node:
        yield node


@pytest.fixture(scope="module")
def bus(office: NodeProgram) -> Iterator[zenostat.Bus]:
    """The bus of the office, which is paused after six hours."""
    with zenostat.connect(office.endpoint, affinity="off") as connected:
        connected.pause("office")
        connected.pace("office", mode="free")
        connected.step("office", 24)
        until(lambda: connected.status("office").step == [24], "24 timesteps are simulated")
        yield connected


@pytest.fixture(scope="module")
def room(office: NodeProgram, bus: zenostat.Bus) -> Iterator[Any]:
    with control_room(office.endpoint, api_token=API_TOKEN) as server:
        yield server


def events(bus: zenostat.Bus, room: Any) -> list[str]:
    """Texts of the events that the control room has."""
    return [event["text"] for event in room.room.watch.find("office").events()]


def test_room__link_signs_in_once_and_leaves_no_trace(ada: Visitor, room: Any, browser: Any) -> None:
    page = ada.open(room.url)
    assert page.locator(".card .name").inner_text() == "office"
    assert "token" not in page.evaluate("location.href + document.cookie")
    late = Visitor(browser)
    link = room.room.link("eve")
    try:
        late.open(link).locator(".card").wait_for()
        replay = Visitor(browser)
        page = replay.open(link)
        page.locator(".sign-in [role=alert]").wait_for()
        assert "used already" in page.locator(".sign-in").inner_text()
        assert page.locator(".card").count() == 0
        replay.close()
    finally:
        late.close()


def test_room__floor_plan_and_table_show_the_node_and_the_address_reproduces_it(
    ada: Visitor, room: Any, bus: zenostat.Bus
) -> None:
    page = ada.open(f"{room.url}/?node=office")
    page.locator(".zone[fill]").first.wait_for()
    sample = bus.read("office")
    shown = page.locator("table.zones tbody tr").evaluate_all("rows => rows.map(r => r.children[1].textContent)")
    zones = ("core", "perimeter_1", "perimeter_2", "perimeter_3", "perimeter_4")
    names = [f"{zone.replace('core', 'core_zn').replace('perimeter_', 'perimeter_zn_')}" for zone in zones]
    assert shown == [f"{sample[f'{name}_air_temperature']:.1f}" for name in names]
    core = page.locator(".zone[aria-label^='Core:']")
    assert f"{sample['core_zn_air_temperature']:.1f}" in core.get_attribute("aria-label")
    core.focus()
    page.keyboard.press("Enter")
    assert page.locator("tr.selected th").inner_text() == "Core"
    page.locator(".legend li").nth(2).wait_for()
    address = page.url
    assert "zone=0" in address
    page = ada.open(address)
    page.locator("tr.selected").wait_for()
    assert page.locator("tr.selected th").inner_text() == "Core"


def test_room__schematic_has_the_loops_of_the_model_and_their_values(
    ada: Visitor, room: Any, bus: zenostat.Bus
) -> None:
    page = ada.open(f"{room.url}/?node=office")
    described = bus.systems("office")
    page.locator(".schematic svg").wait_for()
    names = page.locator("#loop option").all_inner_texts()
    assert names == [loop.name for loop in described.loops]
    page.locator("#loop").select_option(label="PSZ-AC:1")
    (served,) = described.loops[names.index("PSZ-AC:1")].zones
    box = page.locator(".zone-box", has_text="Core")
    value = f"{bus.read('office')[f'{served.zone.lower()}_air_temperature']:.1f}"
    assert value in box.get_attribute("aria-label")
    fan = page.locator(".schematic .box[aria-label^='Fan']").first
    fan.focus()
    page.keyboard.press("Enter")
    page.locator(".component h3", has_text="Fan").wait_for()
    assert fan.get_attribute("aria-pressed") == "true"
    page = ada.open(page.url)  # the address has loop and component
    page.locator(".component h3", has_text="Fan").wait_for()
    assert page.locator(".schematic svg").get_attribute("aria-label") == "Air loop PSZ-AC:1"


def test_room__trends_have_the_history_from_before_the_page(ada: Visitor, room: Any, bus: zenostat.Bus) -> None:
    page = ada.open(f"{room.url}/?node=office&trend=core_zn_air_temperature&range=all")
    page.locator(".legend li").first.wait_for()
    page.locator(".trend-panel canvas").wait_for()
    with httpx.Client(cookies=cookies(page)) as client:
        query = {"point": "core_zn_air_temperature", "max": "1000", "band": "all"}
        answer = client.get(f"{room.url}/api/nodes/office/history", params=query).json()
    history = bus.history("office", ["core_zn_air_temperature"])
    assert answer["points"][0]["values"] == pytest.approx(history["core_zn_air_temperature"].tolist(), rel=1e-6)
    assert answer["band"] == {"low": [23.0] * len(history), "high": [26.0] * len(history)}
    assert answer["time_ms"] == history.time.astype("datetime64[ms]").astype(int).tolist()


def cookies(page: Any) -> dict[str, str]:
    return {cookie["name"]: cookie["value"] for cookie in page.context.cookies()}


def test_room__key_searches_where_the_zones_are_shown(ada: Visitor, room: Any) -> None:
    page = ada.open(f"{room.url}/?node=office")
    page.locator(".zone[fill]").first.wait_for()
    page.keyboard.press("/")
    page.keyboard.type("core cooling")
    assert page.locator("input[type=search]").input_value() == "core cooling"
    assert page.get_by_role("tab", name="All points").get_attribute("aria-selected") == "true"


def test_room__override_is_written_with_its_source_and_relinquished(ada: Visitor, room: Any, bus: zenostat.Bus) -> None:
    page, step = ada.open(f"{room.url}/?node=office&table=points"), bus.status("office").step[0]
    expiry = bus.manifest("office").time_at(step) + timedelta(hours=2)
    page.locator("input[type=search]").fill("core cooling")
    page.get_by_role("button", name="Core zone cooling setpoint", exact=True).click()
    page.locator("#override").fill("27.5")
    page.get_by_role("button", name="Override", exact=True).click()
    row = page.locator(".drawer tr.effective")
    row.get_by_text("ada").wait_for()
    assert row.inner_text().startswith("8 · manual operator")
    assert f"{expiry.day} Jul {expiry:%H:%M}" in row.inner_text()
    entry = bus.priorities("office")[SETPOINT][7]
    assert bus.remaining_durations("office")[SETPOINT] == {8: 7200.0}
    assert (entry.value, entry.source) == (27.5, "ada")
    page.locator("#override").fill("99")  # beyond the bounds: the browser does not send it
    page.get_by_role("button", name="Override", exact=True).click()
    assert not page.locator("#override").evaluate("input => input.checkValidity()")
    page.locator("#override").fill("")
    bus.step("office")
    page.get_by_text(f"step {step + 1} of 96").wait_for()
    assert page.locator("#override").input_value() == ""  # the present value is only its first one
    bus.write("office", SETPOINT, 26.0, priority=5)  # of somebody else, while the node is paused
    page.locator(".drawer tr.effective", has_text="5 · critical equipment").wait_for()
    bus.write("office", SETPOINT, None, priority=5)
    page.locator(".drawer tr.effective", has_text="8 · manual operator").wait_for()
    page.get_by_role("button", name="Relinquish priority 8").focus()
    bus.write("office", SETPOINT, 29.04, priority=12)
    page.locator(".drawer tr", has_text="29.04 °C").wait_for()
    page.keyboard.press("Space")
    page.locator(".drawer tr.effective", has_text="12").wait_for()
    assert bus.priorities("office")[SETPOINT][7].value is None
    page.keyboard.press("Space")  # the button is gone; it is no request to go on
    page.get_by_role("button", name="Relinquish priority 12").click()
    page.locator(".drawer tr.effective", has_text="baseline control").wait_for()
    assert bus.status("office").paused
    page.keyboard.press("Escape")
    page.locator(".drawer").wait_for(state="detached")


def test_room__pause_step_speed_and_reset(ada: Visitor, room: Any, bus: zenostat.Bus) -> None:
    page = ada.open(f"{room.url}/?node=office")
    before = bus.status("office").step[0]
    page.get_by_role("button", name="One timestep").click()
    page.get_by_text(f"step {before + 1} of 96").wait_for()
    page.locator("select[aria-label=Mode]").select_option("lockstep")
    until(lambda: bus.status("office").mode == "lockstep", "the mode is lockstep")
    page.locator("input[aria-label=Speed]").fill("9")
    until(lambda: (s := bus.status("office")).mode == "paced" and s.speed == 3600.0, "an hour each second")
    bus.pace("office", 450.0)  # between two speeds of the page
    page.locator(".speed", has_text="7.5 min/s").wait_for()
    for mode in ("lockstep", "paced"):
        page.locator("select[aria-label=Mode]").select_option(mode)
        until(lambda mode=mode: bus.status("office").mode == mode, f"the mode is {mode}")
    assert bus.status("office").speed == 450.0
    page.locator("select[aria-label=Mode]").select_option("free")
    until(lambda: bus.status("office").mode == "free", "the mode is free")
    episode = bus.status("office").episode[0]
    page.get_by_role("button", name="Reset").click()
    page.locator("dialog").get_by_role("button", name="Reset").click()
    page.get_by_text(f"step 0 of 96, episode {episode + 1}").wait_for()
    page.locator("main").focus()
    page.keyboard.press(".")
    page.get_by_text(f"step 1 of 96, episode {episode + 1}").wait_for()
    until(lambda: any("wall clock" in text for text in events(bus, room)), "the event of the pace has arrived")


def test_room__alarm_is_acknowledged_and_shelved(ada: Visitor, room: Any, bus: zenostat.Bus) -> None:
    page = ada.open(f"{room.url}/?node=office")
    page.get_by_role("button", name="Acknowledge warm").click()
    page.locator("#comment").fill("seen")
    page.locator("dialog").get_by_role("button", name="Acknowledge").click()
    page.locator(".alarms li", has_text="acknowledged by ada").wait_for()
    (alarm,) = bus.alarms("office").alarms
    assert (alarm.state, alarm.acknowledged_by, alarm.comment) == ("acknowledged", "ada", "seen")
    page.get_by_role("button", name="Shelve 2 h: warm").click()
    page.locator("dialog").get_by_role("button", name="Shelve").click()
    page.locator(".alarms li", has_text="shelved by ada").wait_for()
    page.get_by_role("button", name="Unshelve warm").click()
    until(lambda: bus.alarms("office").alarms[0].state == "active", "the alarm is not shelved any more")


def test_room__fault_is_injected_and_ended(ada: Visitor, room: Any, bus: zenostat.Bus) -> None:
    page = ada.open(f"{room.url}/?node=office&tab=faults")
    page.locator("#fault-point").fill("core_zn_air_temperature")
    page.locator("#fault-value").fill("3")
    page.get_by_role("button", name="Inject").click()
    page.locator(".toast", has_text="injected from the next sample on: bias 1").wait_for()
    bus.step("office")  # from the next sample on
    until(lambda: bus.status("office").faults == ["bias 1"], "the fault is active")
    page.get_by_text("Active now: bias 1", exact=True).wait_for()
    listed = page.locator("ul[aria-label='Injected faults'] li")
    assert "bias, core_zn_air_temperature, offset 3\u00a0K" in listed.inner_text()
    bus.faults(
        "office", {"faults": [{"kind": "stuck", "points": ["electricity_facility"], "value": 9e6}]}, source="bob"
    )
    page.locator("ul[aria-label='Injected faults'] li", has_text="stuck, electricity_facility, value 10.0").wait_for()
    page.get_by_role("button", name="End all faults").click()
    page.locator(".toast", has_text="no fault is injected any more").wait_for()
    bus.step("office")
    page.get_by_text("No injected fault is active.").wait_for()
    assert bus.status("office").faults == []


def test_room__recording_begins_and_ends(ada: Visitor, room: Any, bus: zenostat.Bus, module_folder: Path) -> None:
    page = ada.open(f"{room.url}/?node=office")
    page.get_by_role("button", name="Record", exact=True).click()
    page.locator("#path").fill(str(module_folder / "run.mcap"))
    page.locator("dialog").get_by_role("button", name="Record").click()
    page.get_by_role("button", name="Stop recording").click()
    page.get_by_role("button", name="Record", exact=True).wait_for()
    recording = bus.status("office").recording
    assert recording is not None
    assert Path(recording.path) == module_folder / "run.mcap"
    assert recording.state == "ended"


def test_room__what_if_saves_energy_and_is_applied(ada: Visitor, room: Any, bus: zenostat.Bus) -> None:
    page = ada.open(f"{room.url}/?node=office&tab=what-if")
    step = bus.status("office").step
    page.get_by_role("button", name="All cooling setpoints").click()
    page.get_by_role("spinbutton", name="All cooling setpoints").fill("30")
    page.get_by_role("button", name="Simulate").click()
    row = page.locator("table.totals tr", has_text="HVAC electricity")
    row.wait_for()
    as_is, changed = (float(row.locator("td").nth(place).inner_text()) for place in (0, 1))
    assert 0 < changed < as_is  # a day of July in Denver, cooled above 30 instead of 24 °C
    assert bus.status("office").step == step
    assert bus.status("office").branches == bus.status("office").snapshots == []
    assert [each.node for each in room.room.watch.watches()] == ["office"]
    page.get_by_role("button", name="Apply for 24 h").click()
    page.get_by_text("5 of 5 values applied").wait_for()
    entries = [array[7] for name, array in bus.priorities("office").items() if name.endswith("cooling_setpoint")]
    assert [(entry.value, entry.source) for entry in entries] == [(30.0, "ada")] * 5
    for name in bus.priorities("office"):
        bus.write("office", name, None)


@pytest.mark.slow
def test_room__what_if_tries_a_controller_and_shows_its_command(ada: Visitor, room: Any, bus: zenostat.Bus) -> None:
    page = ada.open(f"{room.url}/?node=office&tab=what-if")
    page.get_by_role("button", name="Another controller").focus()
    page.keyboard.press("Enter")
    assert "try=controller" in page.url
    page.get_by_label("Controller", exact=True).select_option("rbc")
    page.get_by_text("Controllers that do not suit this node").click()
    page.get_by_text("coordinator: ").wait_for()
    page.get_by_text("Parameters").click()
    page.get_by_label("Cooling margin").fill("0.5")
    page.locator("#hours").select_option("24")
    page.get_by_role("button", name="Simulate").click()
    row = page.locator("table.totals tr", has_text="HVAC electricity")
    row.wait_for()
    assert page.locator("table.totals thead").inner_text().split()[-2:] == ["rbc", "difference"]
    as_is, tried = (float(row.locator("td").nth(place).inner_text()) for place in (0, 1))
    assert 0 < tried != as_is > 0
    page.get_by_label("Command that starts the controller").wait_for()
    command = page.get_by_label("Command that starts the controller").inner_text()
    wanted = "zenostat run --node office --controller rbc --set cooling_margin=0.5 --priority 10 --connect"
    assert command.startswith(wanted)
    assert bus.status("office").branches == bus.status("office").snapshots == []
    assert bus.status("office").controllers == []
    page = ada.open(page.url)  # the address reproduces it
    assert page.get_by_role("button", name="Another controller").get_attribute("aria-pressed") == "true"
    page.get_by_label("Controller", exact=True).select_option("pid")
    page.get_by_role("button", name="Simulate").click()
    page.locator(".toast.error", has_text="pid needs setpoint").wait_for()
    page.get_by_label("Setpoint", exact=True).wait_for()


@pytest.mark.slow
def test_room__texts_with_markup_are_texts(ada: Visitor, room: Any, bus: zenostat.Bus) -> None:
    bus.shelve("office", "warm", 3600.0, source="mallory", comment=HOSTILE)
    page = ada.open(f"{room.url}/?node=office&search={quote(HOSTILE)}&table=points&tab=alarms&zone={quote(HOSTILE)}")
    page.locator(".alarms li", has_text=HOSTILE).wait_for()
    page = ada.open(f"{room.url}/?node=office&tab=events&search={quote(HOSTILE)}&table=points")
    page.locator(".tab-panel .log", has_text=HOSTILE).wait_for()
    assert page.locator("input[type=search]").input_value() == HOSTILE
    assert page.locator("img[src=x]").count() == 0
    assert page.title() == "office \N{EN DASH} Control room"
    bus.unshelve("office", "warm")


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("width", [320, 390, 700])
def test_room__page_does_not_scroll_sideways(browser: Any, room: Any, width: int) -> None:
    visitor = Visitor(browser, width=width, scheme="light")
    try:
        visitor.open(room.room.link("grace")).locator(".card").wait_for()
        for view in ("", "?node=office", f"?node=office&table=points&tab=what-if&point={SETPOINT}"):
            page = visitor.open(f"{room.url}/{view}")
            page.locator(".card, .zone[fill]").first.wait_for()
            page.evaluate(LONG_NAMES)
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            assert (
                page.evaluate("Math.max(0, ...[...document.querySelectorAll('.drawer')].map(e => e.scrollWidth))")
                <= width
            )
    finally:
        visitor.close()


def test_room__controls_have_names(ada: Visitor, room: Any) -> None:
    page = ada.open(f"{room.url}/?node=office&point={SETPOINT}&tab=faults")
    page.locator(".drawer tr.effective").wait_for()
    unnamed = page.evaluate(
        """() => [...document.querySelectorAll('button, a, input, select, [role=button]')]
          .filter(e => e.checkVisibility() && !(e.getAttribute('aria-label') || e.textContent.trim()))
          .filter(e => !e.labels?.length)
          .map(e => e.outerHTML)"""
    )
    assert unnamed == []


def test_room__overview_has_contrast_names_and_structure(ada: Visitor, room: Any) -> None:
    """The other pages, in light and dark, are in test_room__accessibility.py."""
    pytest.importorskip("axe_playwright_python", reason="pip install axe-playwright-python")
    page = ada.open(room.url)
    page.locator(".card").wait_for()
    assert violations(page) == []


def test_room__overview_keeps_the_focus_of_a_card_that_changes(ada: Visitor, room: Any, bus: zenostat.Bus) -> None:
    page = ada.open(room.url)
    link = page.get_by_role("link", name="office", exact=True)
    link.focus()
    bus.pause("office")
    page.locator(f"progress[aria-label^='Step {next_step(bus, 'office')} of']").wait_for()
    assert link.evaluate("link => link === document.activeElement")


def test_room__press_on_a_card_that_changes_is_a_click(ada: Visitor, room: Any, bus: zenostat.Bus) -> None:
    page = ada.open(room.url)
    page.get_by_role("link", name="office", exact=True).hover()
    page.mouse.down()
    page.locator(f"progress[aria-label^='Step {next_step(bus, 'office')} of']").wait_for()
    page.mouse.up()
    page.locator(".bar", has_text=f"{bus.manifest('office').building} · ").wait_for()
    assert "node=office" in page.url


@contextmanager
def hanging(room: Any) -> Iterator[None]:
    """The control room does not run: what is sent to it waits in buffers of the system."""
    hangs, end = threading.Event(), threading.Event()

    def hang() -> None:
        hangs.set()
        end.wait()

    room.room.updates._loop.call_soon_threadsafe(hang)
    hangs.wait()
    try:
        yield
    finally:
        end.set()


@pytest.fixture
def override(browser: Any, room: Any) -> Iterator[Any]:
    """A page of Eve's with its own clock, on which the override of a setpoint is open."""
    visitor = Visitor(browser)
    visitor.page.clock.install()
    visitor.open(room.room.link("eve")).locator(".card").wait_for()
    page = visitor.open(f"{room.url}/?node=office&point={SETPOINT}")
    page.locator("#override").fill("26")
    assert page.get_by_text("no connection").first.is_hidden()
    yield page
    visitor.close()


def writes(room: Any) -> list[dict[str, Any]]:
    """Entries of Eve's overrides in the audit log."""
    entries = room.room.audit.entries()
    return [each for each in entries if (each["operator"], each["operation"]) == ("eve", "write")]


def test_room__connection_that_is_silent_is_shown_and_nothing_is_sent(
    override: Any, room: Any, bus: zenostat.Bus
) -> None:
    page, before = override, len(writes(room))
    button = page.get_by_role("button", name="Override", exact=True)
    chip, note = (
        page.locator("header").get_by_text("no connection"),
        page.locator(".drawer").get_by_text("no connection"),
    )
    with hanging(room):
        page.clock.fast_forward(20_001)
        chip.wait_for()
        note.wait_for()  # the drawer covers the header
        opacity = "element => getComputedStyle(element).opacity"
        for selector in ("main", ".drawer > .override"):
            assert page.locator(selector).evaluate(opacity) == "0.5"
        button.click()
        page.locator(".toast", has_text="no connection to the control room: nothing was sent").wait_for()
    chip.wait_for(state="hidden")
    assert note.is_hidden()
    button.click()
    page.locator(".toast", has_text=f"{SETPOINT} = 26").wait_for()
    assert len(writes(room)) == before + 1
    bus.write("office", SETPOINT, None)


def test_room__change_that_arrives_late_is_refused(
    override: Any, room: Any, bus: zenostat.Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("zenostat.views.room.access.MAX_PAGE_AGE_S", -1.0)  # each change is late
    page, before = override, len(writes(room))
    button = page.get_by_role("button", name="Override", exact=True)
    with hanging(room):
        with page.expect_request("**/write"):
            button.click()
        page.clock.fast_forward(20_001)
        page.locator(".toast", has_text="what was sent may be carried out all the same").wait_for()
    page.locator("header").get_by_text("no connection").wait_for(state="hidden")
    button.click()
    page.locator(".toast", has_text="nothing was done: the page had received nothing for").wait_for()
    refused = writes(room)[before:]
    assert refused
    assert all(not each["accepted"] and "nothing was done" in each["outcome"] for each in refused)
    assert bus.priorities("office")[SETPOINT][7].value is None


def test_room__strangers_requests_are_rejected(ada: Visitor, room: Any, bus: zenostat.Bus) -> None:
    paused, own = bus.status("office").paused, cookies(ada.open(room.url))
    url, host = f"{room.url}/api/nodes/office/resume", room.url.removeprefix("http://")
    with httpx.Client(cookies=own) as client:
        for headers in (
            {},
            {"origin": "http://evil.example"},
            {"origin": room.url, "host": "evil.example"},
            {"origin": room.url, "sec-fetch-site": "cross-site"},
            {"origin": room.url, "content-type": "text/plain"},
        ):
            sent = {"content-type": "application/json", **headers}
            assert client.post(url, headers=sent, content="{}").status_code in (403, 415, 421)
        assert client.post(url, headers={"origin": room.url}, json={"x": 1}).status_code == 400
        large = client.post(url, headers={"origin": room.url}, json={"x": "x" * (2 << 20)})
        assert large.status_code == 413
        policy = client.get(room.url).headers["content-security-policy"]
        assert "unsafe" not in policy
    with httpx.Client() as client:
        assert client.post(url, headers={"origin": room.url}, json={}).status_code == 401
        assert client.get(f"{room.url}/api/stream").status_code == 401
        assert client.get(f"{room.url}/static/../app.py", headers={"host": host}).status_code in (401, 404)
        assert client.get(f"{room.url}/static/%2e%2e/app.py").status_code in (401, 404)
    assert bus.status("office").paused is paused is True


def test_room__prometheus_and_grafana_read_with_their_token(room: Any, bus: zenostat.Bus) -> None:
    headers = {"authorization": f"Bearer {API_TOKEN}"}
    with httpx.Client(headers=headers, base_url=room.url) as client:
        until(lambda: 'zenostat_node_up{node="office"} 1' in client.get("/metrics").text, "the node is followed")
        lines = client.get("/metrics").text.splitlines()
        values = {line.rpartition(" ")[0]: float(line.rpartition(" ")[2]) for line in lines if line[0] != "#"}
        assert values['zenostat_node_up{node="office"}'] == 1
        assert values['zenostat_node_paused{node="office"}'] == 1
        assert values['zenostat_node_speed_ratio{node="office"}'] == 0
        targets = client.post("/grafana/metrics", json={}).json()
        assert {"label": f"office/{SETPOINT}", "value": f"office/{SETPOINT}"} in targets
        query = {
            "range": {"from": "2017-07-03T00:00:00.000Z", "to": "2017-07-03T23:00:00.000Z"},
            "targets": [{"target": "office/outdoor_temperature", "refId": "A"}],
            "maxDataPoints": 500,
        }
        (series,) = client.post("/grafana/query", json=query).json()
        history = bus.history("office", ["outdoor_temperature"])
        assert [value for value, _ in series["datapoints"]] == pytest.approx(history.values[:, 0].tolist(), rel=1e-6)
        query["range"] = {"from": "2016-01-01T00:00:00Z", "to": "2016-01-02T00:00:00Z"}
        assert client.post("/grafana/query", json=query).json() == []


@pytest.mark.slow
def test_room__node_that_dies_and_comes_back(browser: Any, scratch: Path) -> None:
    (scratch / "tank.py").write_text(TANK)
    settings = {"plant": f"{scratch}/tank.py:Tank", "name": "tank", "listen": [f"tcp/127.0.0.1:{free_port()}"]}
    with NodeProgram(scratch / "first", **settings) as node, control_room(node.endpoint) as server:
        visitor = Visitor(browser)
        visitor.open(server.link).locator(".card").wait_for()
        page = visitor.open(f"{server.url}/?node=tank&table=points")  # a plant without zones and storeys
        page.locator("table.points", has_text="1 m").wait_for()
        node.kill()
        page.locator(".banner.problem", has_text="Not reachable").wait_for()
        with NodeProgram(scratch / "second", **settings):
            page.locator(".banner.problem").wait_for(state="hidden")
            page.get_by_role("button", name="Pump", exact=True).click()
            page.locator("#override").fill("50")
            page.get_by_role("button", name="Override", exact=True).click()
            page.locator(".drawer tr.effective", has_text="ada").wait_for()
            with zenostat.connect(settings["listen"][0], affinity="off") as bus:
                bus.stop("tank")
            page.get_by_text("The node has ended.").wait_for()
            page.locator(".bar .chip", has_text="ended").wait_for()
            assert visitor.complaints == []
            visitor.close()


@pytest.mark.slow
def test_room__command_waits_for_its_bus(scratch: Path) -> None:
    endpoint = f"unixsock-stream/{scratch}/bus"
    command = [*ZENOSTAT, "room", "--connect", endpoint, "--address", "127.0.0.1:0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
        try:
            assert program.stdout is not None
            assert "; waiting for it, press Ctrl-C to stop" in program.stdout.readline()
            (scratch / "tank.py").write_text(TANK)
            with NodeProgram(scratch / "node", plant=f"{scratch}/tank.py:Tank", name="tank", listen=[endpoint]):
                # while the node starts, the reason to wait may change
                assert any(line.startswith("ready: http://127.0.0.1:") for line in program.stdout)
                program.send_signal(signal.SIGTERM)
                assert program.wait() == 0
        finally:
            program.kill()


@pytest.mark.slow
def test_room__command_prints_a_link_and_ends_on_sigterm(office: NodeProgram, scratch: Path) -> None:
    with nothing_left(scratch):
        command = [*ZENOSTAT, "room", "--connect", office.endpoint]
        token = scratch / "token"
        options = ["--address", "127.0.0.1:0", "--operator", "ada", "--api-token-file", str(token)]
        program = subprocess.Popen([*command, *options], stdout=subprocess.PIPE, text=True)
        assert program.stdout is not None
        link = program.stdout.readline().removeprefix("ready: ").strip()
        url, _, secret = link.partition("/#token=")
        assert token.stat().st_mode & 0o777 == 0o600
        with httpx.Client(base_url=url, headers={"origin": url}) as client:
            assert client.post("/api/session", json={"token": secret}).json() == {"operator": "ada"}
            with client.stream("GET", "/api/stream?node=office") as stream:
                lines = stream.iter_lines()
                state = next(json.loads(line[6:]) for line in lines if line.startswith('data: {"node":"office"'))
                assert state["online"]
                program.send_signal(signal.SIGTERM)
                assert program.wait() == 0
        token.unlink()
        program.stdout.close()
