"""A report in a real browser: Chromium of the system, driven by playwright. Skipped where one of them is missing."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.traces import office_comparison

from agent_sdk.report import write_report

pytest.importorskip("matplotlib")
playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="the system has no Chromium"),
    pytest.mark.process,
]

HOSTILE = "<script>document.title = 'taken'</script><img src=x onerror=\"document.title = 'taken'\">"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as driver:
        options = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
        started = driver.chromium.launch(executable_path=CHROMIUM, args=options)
        yield started
        started.close()


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


def test_light_and_dark_pages_are_drawn_and_differ(opened: Any) -> None:
    light, dark = pixels(opened()), pixels(opened(scheme="dark"))
    assert light.mean() > 0.85
    assert dark.mean() < 0.35
    assert light.std() > 0.05
    assert dark.std() > 0.05


def test_lines_and_texts_of_drawings_are_light_on_dark_pages(opened: Any) -> None:
    colors = "[...document.querySelectorAll('#load-duration-title')].map(e => getComputedStyle(e.closest('svg')"
    text = f"{colors}.querySelector('text')).fill)[0]"
    light, dark = opened().evaluate(text), opened(scheme="dark").evaluate(text)
    assert light != dark


def test_names_of_users_do_not_run(opened: Any) -> None:
    page = opened()
    assert page.title().startswith("<script>")
    assert page.locator("h1").inner_text() == HOSTILE
    assert page.locator("img").count() == 0


@pytest.mark.parametrize("width", [390, 768, 1400])
def test_the_page_does_not_scroll_sideways(opened: Any, width: int) -> None:
    page = opened(width)
    assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_no_two_labels_of_a_drawing_overlap(opened: Any) -> None:
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


def test_labels_stay_within_their_drawings(opened: Any) -> None:
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


def test_the_printed_page_is_light_and_shows_the_scenario(opened: Any) -> None:
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


def test_links_lead_to_their_sections(opened: Any) -> None:
    page = opened()
    anchors = page.eval_on_selector_all("nav a", "links => links.map(a => a.getAttribute('href'))")
    assert len(anchors) >= 8
    assert all(page.locator(anchor).count() == 1 for anchor in anchors)
