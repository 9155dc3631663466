"""The HTML page of a report, as text."""

import re
from collections.abc import Iterator
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.trajectories import SHARES, office, office_comparison, run

from zenostat.lab.evaluate import Evaluation
from zenostat.metrics.episode_weather import EpisodeWeather
from zenostat.metrics.trajectory import Trajectory
from zenostat.topics.errors import InvalidConfig
from zenostat.views.display.colors import contrast
from zenostat.views.report import Comparison, Run, write_figures, write_report
from zenostat.views.report.figures.base import Figure
from zenostat.views.report.page import page
from zenostat.views.report.sections import sections
from zenostat.views.report.theme import DARK, LIGHT
from zenostat.views.report.totals import difference, kpis, metrics, number, total
from zenostat.views.report.totals_section import totals_section

pytest.importorskip("matplotlib")

VOID = {"meta", "br", "hr", "img", "input", "link"}


class Document(HTMLParser):
    """Elements of a page with their texts, and a check that tags are closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[tuple[str, ...], str]] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if data.strip():
            self.texts.append((tuple(self.open), data))

    def attributes(self, name: str) -> Iterator[str]:
        return (attributes[name] or "" for _, attributes in self.elements if name in attributes)


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return office_comparison(scenario="building: office", command="zenostat evaluate office --report a.html")


@pytest.fixture(scope="module")
def text(comparison: Comparison) -> str:
    return page(comparison)


@pytest.mark.slow
def test_report__totals_are_those_of_the_evaluation(comparison: Comparison, text: str) -> None:
    rows = dict(re.findall(r'<tr data-metric="([^"]+)">(.*?)</tr>', text))
    assert "03 Jul 08:15" in rows.pop("peak_time")
    assert list(rows) == [metric.key for metric in (*metrics(comparison), *kpis(comparison))]
    assert "kpi.tdis_tot" in rows
    reference, other = comparison.runs
    for metric in (*metrics(comparison), *kpis(comparison)):
        cells = [re.sub(r"<[^>]+>", "", cell) for cell in re.findall(r"<td.*?</td>", rows[metric.key])]
        for cell, each in zip(cells, comparison.runs, strict=False):
            value = total(each, metric.key)
            assert value.mean == each.results[0].metrics()[metric.key]
            assert cell == number(value.mean)
        change = difference(other, reference, metric)
        assert change.verdict in cells[-1]  # in words, not by color alone


@pytest.mark.slow
def test_report__document_is_well_formed_and_its_ids_are_unique(text: str) -> None:
    document = Document(text)
    ids = list(document.attributes("id"))
    assert len(ids) == len(set(ids))
    references = set(re.findall(r'(?:href="#|url\(#)([^")]+)', text))
    assert references <= set(ids)
    assert references


def test_report__each_drawing_and_table_has_a_name(text: str) -> None:
    document = Document(text)
    drawings = [attributes for tag, attributes in document.elements if tag == "svg"]
    ids = set(document.attributes("id"))
    assert len(drawings) >= 8
    for attributes in drawings:
        assert attributes["role"] == "img"
        assert set((attributes["aria-labelledby"] or "").split()) <= ids
    assert all("scope" in attributes for tag, attributes in document.elements if tag == "th")


def test_report__headings_are_in_order(text: str) -> None:
    levels = [int(tag[1]) for tag, _ in Document(text).elements if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(later <= earlier + 1 for earlier, later in pairwise(levels))


def test_report__nothing_is_loaded_from_anywhere(text: str) -> None:
    document = Document(text)
    (policy,) = (a["content"] or "" for tag, a in document.elements if a.get("http-equiv") == "Content-Security-Policy")
    assert policy.startswith("default-src 'none'; img-src data:;")
    for name in ("src", "href", "xlink:href", "srcset", "action", "poster", "data"):
        for value in document.attributes(name):
            assert value.startswith(("#", "data:image/png;base64,"))
    assert "@import" not in text
    assert {tag for tag, _ in document.elements} & {"link", "iframe", "object", "embed", "base"} == set()
    urls = re.findall(r"https?://[^\s\"'<]+", text)
    assert set(urls) <= {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}


HOSTILE = "<script>alert(1)</script>\"'&"
HOSTILE_NAMES = ("$a_1$ & $b$", "<img src=x onerror=alert(1)>")
"""Names of controllers, short enough for figures."""


@pytest.mark.slow
def test_report__names_of_users_are_text() -> None:
    hostile = office_comparison(HOSTILE_NAMES, building=HOSTILE, scenario=f"id: {HOSTILE}", command=HOSTILE)
    hostile = Comparison(hostile.runs, hostile.scenario, hostile.command, {HOSTILE: HOSTILE}, {"peak_kw": HOSTILE})
    text = page(hostile)
    document = Document(text)
    tags = [tag for tag, _ in document.elements]
    assert [dict(attributes) for tag, attributes in document.elements if tag == "script"].count({}) == 1  # its own
    assert {attributes.get("type") for tag, attributes in document.elements if tag == "script"} == {
        None,
        "application/json",
    }
    assert "img" not in tags
    assert text.count("<script>alert(1)") == text.count("<img") == 0
    shown = [data for _, data in document.texts]
    assert f"{HOSTILE} was skipped: {HOSTILE}" in "".join(shown)
    for name in HOSTILE_NAMES:  # in tables, legends, and what screen readers say
        assert f"{name}, peak 27.0 kW" in shown or f"{name}, peak 30.0 kW" in shown
        assert any("Stacked bars" in data and name in data for data in shown)


@pytest.mark.slow
def test_report__same_input_gives_the_same_bytes(comparison: Comparison, text: str) -> None:
    assert page(office_comparison(scenario=comparison.scenario, command=comparison.command)) == text


def test_report__what_is_not_measured_is_named() -> None:
    of = office(("core",), steps=8).model_copy(update={"meters": ()})
    whole = run("rbc", office(("core",), steps=8), [1.0] * 8, [[24.0] * 8], [[1.0] * 8])
    trajectory = whole.trajectory
    object.__setattr__(trajectory, "manifest", of)
    text = page(Comparison((whole,)))
    assert "Not measured: electricity, electricity of the HVAC, end uses, reward, cost (no price) and emissions" in text
    assert 'id="end-use"' not in text


def test_report__several_episodes_have_intervals_and_state_which_one_is_drawn() -> None:
    pytest.importorskip("scipy")
    of = office(("core",), steps=8)
    runs = tuple(run(name, of, [10.0] * 8, [[24.0] * 8], [[1.0] * 8], episodes=3) for name in ("baseline", "rbc"))
    text = totals_section(Comparison(runs))
    assert "All figures show the first episode." in text
    assert "20 ± 0" in text


@pytest.mark.slow
def test_report__year_of_two_controllers_is_below_a_megabyte_though_nothing_repeats() -> None:
    of = office([f"zone_{number}" for number in range(26)], steps=35040, begin="2017-01-01T00:00:00")
    hours = np.arange(35040) / 4
    random = np.random.default_rng(5)
    warm = [24.0 + 3.0 * np.sin(hours * 2 * np.pi / 24 + place) + random.normal(0, 0.5, 35040) for place in range(26)]
    people = [(hours % 24 > 8).astype(float)] * 26
    joules = 9e5 * (40.0 + 30.0 * np.sin(hours * 2 * np.pi / 24) + random.normal(0.0, 3.0, 35040))
    table = np.column_stack([*warm, *people, joules, 0.6 * joules, *(share * joules for share in SHARES)])
    values = np.vstack([table[:1], table])
    assert values.shape[1] == len(of.names) > 55
    effective = np.where(random.random((35041, 26)) < 0.2, 26.0, 24.0)
    source = random.integers(0, 2, (35041, 26)).astype(np.uint16)
    short = office_comparison().runs[0]
    runs = []
    for name, factor in (("baseline", 1.0), ("rbc", 0.99)):
        terms = {"energy": -random.random(35040), "comfort": -random.random(35040)}
        trajectory = Trajectory(
            of, np.arange(35041), values * factor, effective * factor, source, ("", name), terms=terms
        )
        weather = EpisodeWeather(3600.0, random.normal(10.0, 9.0, 8760), random.uniform(0.0, 900.0, 8760))
        runs.append(Run(name, short.results, trajectory, (0,), ("Denver",), (weather,)))
    assert len(page(Comparison(tuple(runs))).encode()) < 1_000_000


@pytest.mark.parametrize("colors", [LIGHT, DARK])
def test_report__texts_and_lines_have_contrast(colors: dict[str, str]) -> None:
    def rgb(name: str) -> list[int]:
        return [int(colors[name][place : place + 2], 16) for place in (1, 3, 5)]

    for name in ("ink", "muted", "series-4", "warm", "series-2"):  # texts
        assert contrast(rgb(name), rgb("page")) >= 4.5
        assert contrast(rgb(name), rgb("panel")) >= 4.5 or name != "ink"
    for name in colors:
        if name.startswith("series"):
            assert contrast(rgb(name), rgb("page")) >= 3.0
    assert len(set(colors.values())) == len(colors)  # the color tells the variable


@pytest.mark.slow
def test_report__figures_for_papers(comparison: Comparison, tmp_path: Path) -> None:
    from matplotlib.image import imread

    files = write_figures(comparison, tmp_path / "figures")
    names = {path.stem for path in files}
    assert {"end-uses", "load-duration", "carpet-electricity", "degree-hours", "actuators", "weather"} <= names
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {path.name for path in files}
    assert {path.suffix for path in files} == {".png", ".svg", ".csv"}
    picture = imread(tmp_path / "figures" / "end-uses.png")
    assert picture.shape[1] == round(8.6 * 300)
    assert picture.std() > 0.05
    svg = (tmp_path / "figures" / "end-uses.svg").read_text()
    assert "var(--" not in svg  # colors for papers
    lines = (tmp_path / "figures" / "energy-by-day.csv").read_text().splitlines()
    assert lines[0] == "day,baseline: electricity (kWh),rbc: electricity (kWh)"
    assert [float(cell) for cell in lines[1].split(",")[1:]] == pytest.approx([440.0, 396.0])


def test_report__drawings_of_a_comparison_are_made_once(comparison: Comparison) -> None:
    def drawings(of: Any) -> list[Figure]:
        return [figure for section in sections(of) for figure in section.figures]

    assert all(one is other for one, other in zip(drawings(comparison), drawings(comparison), strict=True))


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("report.txt", "expected an .html file"),
        ("nowhere/report.html", "there is no folder"),
        ("d.html", "is a folder"),
    ],
)
def test_report__path_that_cannot_be_written_is_named(
    path: str, message: str, comparison: Comparison, tmp_path: Path
) -> None:
    (tmp_path / "d.html").mkdir()
    with pytest.raises(InvalidConfig, match=message):
        write_report(comparison, tmp_path / path)


def test_report__figures_need_a_folder(comparison: Comparison, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InvalidConfig, match="this is a file"):
        write_figures(comparison, tmp_path / "file")
    with pytest.raises(InvalidConfig, match="there is no folder"):
        write_figures(comparison, tmp_path / "nowhere" / "figures")


def test_report__evaluation_without_recordings_has_no_report(tmp_path: Path) -> None:
    with pytest.raises(InvalidConfig, match="trace=True"):
        Evaluation((), {}).report(tmp_path / "a.html")
