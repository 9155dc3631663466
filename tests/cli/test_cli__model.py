"""`zenostat model`: as text, as JSON and as a page, from the file alone."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from support.run_cli import plain, run_in_process

from zenostat.models import energyplus
from zenostat.models.building.model import read_building
from zenostat.models.catalog import find_building
from zenostat.views.report.model_page import model_page


@pytest.fixture
def no_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever starts EnergyPlus fails the test."""
    read_building(find_building("warehouse"))  # converted once
    monkeypatch.setattr(energyplus, "call", None)


@pytest.mark.usefixtures("no_engine")
def test_model__tells_systems_zones_and_controls_without_energyplus() -> None:
    result = run_in_process("model", "warehouse", columns=300)
    assert result.returncode == 0
    text = plain(result.stdout)
    for words in (
        "EnergyPlus version of the file: 25.2",
        "PSZ-Office (AirLoopHVAC)",
        "Zone1 Office Direct Air (AirTerminal:SingleDuct:ConstantVolume:NoReheat)",
        "heating setpoint of zone Zone1 Office (schedule Office Heating Schedule)",
    ):
        assert words in text, words


@pytest.mark.usefixtures("no_engine")
def test_model__json_has_the_same(tmp_path: Path) -> None:
    data = json.loads(run_in_process("model", "warehouse", "--json").stdout)
    assert [zone["name"] for zone in data["zones"]] == ["Zone1 Office", "Zone2 Fine Storage", "Zone3 Bulk Storage"]
    assert data["air_loops"][0]["parts"]
    assert data["surfaces"] > 50
    assert data["diagnostics"] == []


@pytest.mark.usefixtures("no_engine")
def test_model__page_is_one_file_that_loads_nothing(tmp_path: Path) -> None:
    page = tmp_path / "warehouse.html"
    result = run_in_process("model", "warehouse", "--html", str(page), "--json")
    assert f"page: {page}" in result.stderr
    assert json.loads(result.stdout)["surfaces"] > 50
    text = page.read_text()
    assert "default-src 'none'" in text.replace("&#x27;", "'")
    assert not re.search(r"(src|href)=[\"']?(?!#|data:)", text)
    data = json.loads(re.search(r'id="surfaces">(.*?)</script>', text)[1])  # type: ignore[index]
    assert {zone["name"] for zone in data["zones"]} == {"Zone1 Office", "Zone2 Fine Storage", "Zone3 Bulk Storage"}
    run_in_process("model", "warehouse", "--html", str(page))
    assert page.read_text() == text


def test_model_page__names_of_users_are_shown_as_text() -> None:
    hostile = "<script>alert(1)</script>"
    text = model_page(hostile, [("File", hostile)], None, [hostile], [], [("T", ("c",), [(hostile,)])])
    assert "<script>alert" not in text
    assert text.count("&lt;script&gt;alert(1)&lt;/script&gt;") == 5  # title, heading, fact, note, cell


def test_model__page_of_another_suffix_is_refused() -> None:
    result = run_in_process("model", "warehouse", "--html", "page.pdf")
    assert result.returncode != 0
    assert "expected an .html file" in plain(result.stderr)


@pytest.mark.process
def test_model__errors_of_a_file_have_their_lines(tmp_path: Path) -> None:
    own = find_building("warehouse").path.read_text("latin-1").splitlines()
    at = next(i for i, line in enumerate(own) if "!- Schedule Name" in line and "LIGHT" in line.upper())
    own[at] = own[at].replace(",", "_TYPO,", 1)
    path = tmp_path / "mine.idf"
    path.write_text("\n".join(own), encoding="latin-1")
    result = run_in_process("model", str(path), columns=300)
    assert result.returncode == 1
    assert f"error: line {at + 1}: Lights " in result.stdout
    assert "Zone1 Office (Zone)" in result.stdout  # the rest is told all the same
    assert f"{path} has 1 error" in plain(result.stderr)


def written(path: Path, change: Callable[[str], str]) -> Path:
    """Write a changed copy of a bundled model; a replaced text is in it."""
    own = find_building("ref-small-office").path.read_text("latin-1")
    changed = change(own)
    assert changed != own
    path.write_text(changed, encoding="latin-1")
    return path


UNREADABLE: dict[str, tuple[str, Callable[[str], str], str]] = {
    "unknown type": ("a.idf", lambda text: text.replace("  Zone,", "  Zonne,", 1), "no object type 'Zonne'"),
    "number out of range": (
        "b.idf",
        lambda text: re.sub(r"(Timestep,\s*)6", r"\g<1>600", text),
        "number_of_timesteps_per_hour is 600; expected an integer at least 1 and at most 60",
    ),
    "earlier version": (
        "c.idf",
        lambda text: re.sub(r"(Version,\s*)25\.2", r"\g<1>25.1", text).replace("  Zone,", "  Zonne,", 1),
        "no object type 'Zonne'",
    ),
    "encoding": ("d.idf", lambda text: text.replace("Ref Bldg", "R\xe9f Bldg", 1), "the byte 0xE9 is not UTF-8"),
    "JSON": ("e.epJSON", lambda _: '{"Version": {},\n"Building": ', "Expecting value"),
}


@pytest.mark.variants
@pytest.mark.parametrize("case", UNREADABLE)
def test_model__errors_of_a_file_that_cannot_be_read_are_shown_alike(case: str, tmp_path: Path) -> None:
    name, change, reason = UNREADABLE[case]
    path = written(tmp_path / name, change)
    text = run_in_process("model", str(path), columns=500)
    assert text.returncode == 1
    shown = re.search(rf"^error: line (\d+): (.*{re.escape(reason)}.*)$", text.stdout, re.MULTILINE)
    assert shown is not None, text.stdout
    assert plain(text.stderr).strip() == f"error: {path} has 1 error"
    result = run_in_process("model", str(path), "--json")
    assert result.returncode == 1
    data = json.loads(result.stdout)
    assert data["file"] == str(path)
    (each,) = data["diagnostics"]
    assert (each["severity"], each["line"], each["text"]) == ("error", int(shown[1]), shown[2])


def test_model__missing_file_is_an_error_of_the_command(tmp_path: Path) -> None:
    result = run_in_process("model", str(tmp_path / "none.idf"), "--json")
    assert (result.returncode, result.stdout) == (2, "")


@pytest.mark.slow
@pytest.mark.process
def test_model__brick_file_of_an_own_building_has_its_zones_and_points(tmp_path: Path) -> None:
    path = written(
        tmp_path / "mine.idf", lambda text: text.replace("Core_ZN", 'Core "1" <b>é'.encode().decode("latin-1"))
    )
    file, tags = tmp_path / "mine.ttl", tmp_path / "mine.zinc"
    result = run_in_process("model", str(path), "--brick", str(file), "--haystack", str(tags), "--node", "office")
    assert result.returncode == 0, result.stderr
    assert not result.stdout
    assert f"semantic model: {file.name}" in plain(result.stderr).replace("\n", "").replace(f"{tmp_path}/", "")
    text = file.read_text()
    assert 'rdfs:label "Core \\"1\\" <b>' in text
    key = '"zenostat/v3/office/actuator/*/perimeter_zn_1_cooling_setpoint"'
    assert key in text
    assert key in tags.read_text()
    assert '"Core \\"1\\" <b>' in tags.read_text()


def test_model__of_a_recording_writes_its_semantic_model_only() -> None:
    for options in ([], ["--json"], ["--brick", "a.ttl", "--html", "a.html"]):
        result = run_in_process("model", "run.mcap", *options, columns=300)
        assert result.returncode == 2
        assert "run.mcap: of a recording, only the semantic model is written: --brick FILE.ttl or" in plain(
            result.stderr
        )


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--brick", "a.json"], "--brick a.json: expected a .ttl file"),
        (["--haystack", "a.ttl"], "--haystack a.ttl: expected a .zinc, .trio or .json file"),
        (["--brick", "a.ttl", "--node", "a/b"], "the node's name 'a/b' is not valid in a topic"),
        *(
            ([option, f"none/a{suffix}"], f"{option} none/a{suffix}: there is no folder ")
            for option, suffix in (("--html", ".html"), ("--brick", ".ttl"), ("--haystack", ".zinc"))
        ),
    ],
)
def test_model__output_options_are_checked_first(arguments: list[str], reason: str) -> None:
    result = run_in_process("model", "no-such-building", *arguments, columns=300)
    assert result.returncode == 2
    assert reason in plain(result.stderr)
