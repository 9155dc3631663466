"""A report in a real browser: Chromium of the system, driven by playwright. Skipped where one of them is missing."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.control_room import NEEDS_CHROMIUM
from support.run_cli import run_in_process
from support.trajectories import office, office_comparison, run

from zenostat.views.report import Comparison, write_report

pytest.importorskip("matplotlib")
pytestmark = [NEEDS_CHROMIUM, pytest.mark.process]

HOSTILE = "<script>document.title = 'taken'</script><img src=x onerror=\"document.title = 'taken'\">"


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report in which all names of users are HTML."""
    path = tmp_path_factory.mktemp("report") / "report.html"
    names = ("baseline", "<img src=x onerror=alert(1)>")
    write_report(office_comparison(names, building=HOSTILE, scenario=f"about: {HOSTILE}", command=HOSTILE), path)
    return path


@pytest.fixture
def opened(browser: Any, report: Path) -> Iterator[Any]:
    """Open the report; whatever it requests or complains about fails the test."""
    contexts, messages, requests = [], [], []

    def open_page(width: int = 1000, scheme: str = "light") -> Any:
        context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: messages.append(message.text))
        page.on("pageerror", lambda error: messages.append(str(error)))
        page.on("request", lambda request: requests.append(request.url))
        page.goto(report.as_uri())
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert messages == []
    assert {url for url in requests if not url.startswith("data:")} == {report.as_uri()}


def pixels(page: Any) -> np.ndarray:
    from io import BytesIO

    from matplotlib.image import imread

    picture: np.ndarray = imread(BytesIO(page.screenshot(full_page=True)))[..., :3]
    return picture


@pytest.mark.slow
def test_report__light_and_dark_pages_are_drawn_and_differ(opened: Any) -> None:
    light, dark = pixels(opened()), pixels(opened(scheme="dark"))
    assert light.mean() > 0.85
    assert dark.mean() < 0.35
    assert light.std() > 0.05
    assert dark.std() > 0.05


@pytest.mark.slow
def test_report__lines_and_texts_of_drawings_are_light_on_dark_pages(opened: Any) -> None:
    colors = "[...document.querySelectorAll('#load-duration-title')].map(e => getComputedStyle(e.closest('svg')"
    text = f"{colors}.querySelector('text')).fill)[0]"
    light, dark = opened().evaluate(text), opened(scheme="dark").evaluate(text)
    assert light != dark


@pytest.mark.slow
def test_report__names_of_users_do_not_run(opened: Any) -> None:
    page = opened()
    assert page.title().startswith("<script>")
    assert page.locator("h1").inner_text() == HOSTILE
    assert page.locator("img").count() == 0


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 768, 1400])
def test_report__page_does_not_scroll_sideways(opened: Any, width: int) -> None:
    page = opened(width)
    assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_report__no_two_labels_of_a_drawing_overlap(opened: Any) -> None:
    page = opened(1000)
    overlaps = page.evaluate(
        """() => [...document.querySelectorAll('figure svg')].flatMap(svg => {
          const texts = [...svg.querySelectorAll('text')].filter(t => t.textContent.trim());
          const boxes = texts.map(t => [t.textContent, t.getBoundingClientRect()]);
          return boxes.flatMap(([a, p], i) => boxes.slice(i + 1).filter(([b, q]) =>
            Math.min(p.right, q.right) - Math.max(p.left, q.left) > 1 &&
            Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top) > 4).map(([b]) => `${a} | ${b}`));
        })"""
    )
    assert overlaps == []


def test_report__labels_stay_within_their_drawings(opened: Any) -> None:
    page = opened(1000)
    outside = page.evaluate(
        """() => [...document.querySelectorAll('figure svg')].flatMap(svg => {
          const box = svg.getBoundingClientRect();
          return [...svg.querySelectorAll('text')].filter(t => t.textContent.trim()).filter(t => {
            const b = t.getBoundingClientRect(); return b.left < box.left - 2 || b.right > box.right + 2;
          }).map(t => t.textContent);
        })"""
    )
    assert outside == []


def test_report__printed_page_is_light_and_shows_the_scenario(opened: Any) -> None:
    page = opened(700, "dark")
    folded = page.locator("details.print pre")
    assert not folded.is_visible()
    page.emulate_media(media="print")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert folded.is_visible()
    assert not page.locator("nav").is_visible()
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert page.locator("details.print[open]").count() == 0


def test_report__links_lead_to_their_sections(opened: Any) -> None:
    page = opened()
    anchors = page.eval_on_selector_all("nav a", "links => links.map(a => a.getAttribute('href'))")
    assert len(anchors) >= 8
    assert all(page.locator(anchor).count() == 1 for anchor in anchors)


def drawing(page: Any, name: str) -> Any:
    return page.locator(f"svg[aria-labelledby^='{name}-title']")


def pointer(page: Any, name: str, share: float, height: float, panel: int = 0) -> tuple[float, float]:
    """Return the point of the window at these shares of a panel's width and height, from its lower left corner."""
    drawing(page, name).scroll_into_view_if_needed()
    box = drawing(page, name).evaluate(
        """(svg, panel) => {
          const box = svg.closest('figure').querySelector('script').textContent, r = svg.getBoundingClientRect();
          const k = r.width / svg.viewBox.baseVal.width;
          return JSON.parse(box)[panel].box.map((edge, place) => edge * k + (place % 2 ? r.top : r.left));
        }""",
        panel,
    )
    return box[0] + share * (box[2] - box[0]), box[3] - height * (box[3] - box[1])


def said_at(page: Any, name: str, share: float, height: float = 0.5, panel: int = 0) -> list[str]:
    page.mouse.move(*pointer(page, name, share, height, panel))
    return shown(page, name)


def shown(page: Any, name: str) -> list[str]:
    text: str = page.locator("figure", has=drawing(page, name)).locator(".tip").inner_text()
    return [part.replace("\N{NO-BREAK SPACE}", " ").strip() for part in text.splitlines() if part.strip()]


def drag(page: Any, name: str, begin: float, end: float) -> None:
    page.mouse.move(*pointer(page, name, begin, 0.5))
    page.mouse.down()
    page.mouse.move(*pointer(page, name, end, 0.5))
    page.mouse.up()


def ticks(page: Any, name: str) -> list[str]:
    texts: list[str] = drawing(page, name).evaluate(
        "svg => [...svg.querySelectorAll('.tick text, .zoomed text')].filter(t => t.getBoundingClientRect().width)"
        ".map(t => t.textContent)"
    )
    return texts


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("width", [390, 1400])
def test_report__values_at_the_pointer_are_those_of_the_data(opened: Any, width: int) -> None:
    page = opened(width)
    assert said_at(page, "load-duration", 0.2) == [
        said_at(page, "load-duration", 0.2)[0], "baseline", "30.00 kW", "<img src=x onerror=alert(1)>", "27.00 kW",
    ]  # fmt: skip
    assert said_at(page, "carpet-zone-1", 0.5, 14.5 / 24)[0] == "Mon 3 Jul, 14\N{EN DASH}15 h"
    assert said_at(page, "carpet-zone-1", 0.5, 14.5 / 24)[2::2] == ["0.00 K", "2.00 K"]
    assert said_at(page, "carpet-zone-1", 0.5, 7.5 / 24)[2::2] == ["0.00 K", "0.00 K"]
    assert said_at(page, "actuators", 0.26) == [
        said_at(page, "actuators", 0.26)[0], "baseline", "24.00 °C", "<img src=x onerror=alert(1)>", "24.00 °C",
    ]  # fmt: skip
    temperature = 10.0 + 20.0 * 5 / 23  # the sixth of 24 values that rise from 10 to 30
    assert said_at(page, "weather", 0.25) == ["Mon 3 Jul 06:00", "Outdoor temperature", f"{temperature:.2f} °C"]
    assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_pointer__shows_the_sources_of_actuator_values(opened: Any) -> None:
    texts = said_at(opened(1000), "actuators", 0.5, panel=1)
    assert texts[2::2] == ["set by the building's own control", "set by rbc"]


def test_report__values_disappear_with_the_pointer(opened: Any) -> None:
    page = opened()
    assert said_at(page, "weather", 0.5)
    page.mouse.move(5, 5)
    assert page.locator(".tip:visible").count() == page.locator(".marks > *").count() == 0


@pytest.mark.variants
@pytest.mark.parametrize("back", ["double click", "Escape"])
def test_report__dragging_zooms_in_time_and_out_again(opened: Any, back: str) -> None:
    page = opened()
    before = drawing(page, "weather").inner_html()
    labels = ticks(page, "weather")
    drag(page, "weather", 0.25, 0.5)
    assert {"07:00", "09:00", "11:00"} <= set(ticks(page, "weather")) != set(labels)
    assert said_at(page, "weather", 0.0)[0] == "Mon 3 Jul 06:00"
    assert said_at(page, "weather", 1.0)[0] == "Mon 3 Jul 12:00"
    if back == "Escape":
        page.keyboard.press("Escape")
    else:
        page.mouse.dblclick(*pointer(page, "weather", 0.5, 0.5))
        page.mouse.move(5, 5)
    assert ticks(page, "weather") == labels
    assert drawing(page, "weather").inner_html() == before


def test_report__zoomed_line_goes_through_its_values(opened: Any) -> None:
    page = opened()
    drag(page, "weather", 0.5, 0.75)
    gap = drawing(page, "weather").evaluate(
        """svg => {
          const line = svg.querySelector("path[style*='--warm']"), [entry] = JSON.parse(
            svg.closest('figure').querySelector('script').textContent), [left, top, right, bottom] = entry.box;
          const points = [...line.getAttribute('d').matchAll(/[ML] (\\S+) (\\S+)/g)].map(m => [+m[1], +m[2]]);
          const [a, b] = [points[0], points[points.length - 1]], slope = (b[1] - a[1]) / (b[0] - a[0]);
          const at = x => a[1] + slope * (x - a[0]);
          return [at(left), at(right), a[1], b[1]];
        }"""
    )
    degrees = [10.0 + (gap[2] - y) / (gap[2] - gap[3]) * 20.0 for y in gap[:2]]
    assert degrees == pytest.approx([10.0 + 20.0 * (hour - 1) / 23 for hour in (12, 18)], abs=0.1)


def test_report__figures_are_read_with_the_keyboard(opened: Any) -> None:
    page = opened()
    scroll = page.locator(".scroll", has=drawing(page, "weather"))
    scroll.focus()
    page.keyboard.press("ArrowRight")
    first = shown(page, "weather")
    page.keyboard.press("ArrowRight")
    assert first[0] == "Mon 3 Jul 12:00"
    assert shown(page, "weather")[0] == "Mon 3 Jul 13:00"
    page.keyboard.press("ArrowDown")
    assert shown(page, "weather")[1] == "Global horizontal radiation"
    page.keyboard.press("+")
    assert len(drawing(page, "weather").locator(".zoomed").all()) > 0
    page.keyboard.press("Escape")
    assert page.locator(".tip:visible").count() == drawing(page, "weather").locator(".zoomed").count() == 0


@pytest.mark.slow
def test_report__without_scripts_the_page_is_the_same_but_for_the_hint(browser: Any, report: Path, opened: Any) -> None:
    context = browser.new_context(viewport={"width": 1000, "height": 900}, java_script_enabled=False)
    try:
        plain = context.new_page()
        plain.goto(report.as_uri())
        assert not plain.locator("#hint").is_visible()
        still = pixels(plain)
    finally:
        context.close()
    page = opened()
    assert page.locator("#hint").is_visible()
    page.evaluate("document.getElementById('hint').hidden = true")
    np.testing.assert_array_equal(pixels(page), still)


def test_model_page__draws_the_building_and_names_the_zone_at_the_pointer(browser: Any, tmp_path: Path) -> None:
    path, messages, requests = tmp_path / "office.html", list[str](), list[str]()
    run_in_process("model", "ref-medium-office", "--html", str(path))
    page = browser.new_page(viewport={"width": 1000, "height": 900})
    page.on("console", lambda message: messages.append(message.text))
    page.on("pageerror", lambda error: messages.append(str(error)))
    page.on("request", lambda request: requests.append(request.url))
    page.goto(path.as_uri())
    canvas = page.locator("#view")
    whole = canvas.evaluate("canvas => canvas.toDataURL()")
    page.select_option("#storey", "0")
    assert canvas.evaluate("canvas => canvas.toDataURL()") != whole
    canvas.hover()  # its middle: the core of the lowest storey
    assert page.text_content("#label") == "Core_bottom: 984 m²"
    canvas.press("ArrowLeft")
    assert (messages, requests) == ([], [path.as_uri()])
    page.close()


@pytest.mark.slow
def test_report__small_values_at_the_pointer_have_three_digits(browser: Any, tmp_path: Path) -> None:
    of = office(steps=4)
    small = run("rbc", of, [0.004, 0.0031, 0.0022, 0.001], [[24.0] * 4] * 2, [[0.0] * 4] * 2)
    write_report(Comparison((small,)), tmp_path / "small.html")
    page = browser.new_page()
    page.goto((tmp_path / "small.html").as_uri())
    assert said_at(page, "load-duration", 0.3)[1:] == ["rbc", "0.00310 kW"]
    page.close()
