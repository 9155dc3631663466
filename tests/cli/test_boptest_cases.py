"""Test cases of the BOPTEST gateway by name, and the command's refusals before anything starts."""

import socket
from pathlib import Path

import pytest
from click.testing import CliRunner
from support import data_packs as packs

pytest.importorskip("fastapi", reason="fastapi is not installed")

import typer.main

from zenostat.cli.boptest_cases import BundledTestCases
from zenostat.cli.commands import app
from zenostat.models import catalog
from zenostat.topics.errors import InvalidConfig, UnknownName
from zenostat.topics.scenario_ids import BUILDINGS

SCENARIO = "building: office-small\nweather: [USA_FL_Miami, USA_CO_Denver]\nsteps_per_hour: 6\n"


def test_boptest_cases__bundled_building_has_its_own_weather_and_a_timestep_that_divides_15_minutes() -> None:
    cases = BundledTestCases()
    assert {*BUILDINGS} <= {*cases.names()}
    assert dict(cases.find("office-small").arguments) == {
        "building": "office-small", "weather": "USA_CO_Denver", "steps_per_hour": 4, "monitoring": True,
    }  # fmt: skip
    old = cases.find("ref-small-office").arguments  # whose model has 6 timesteps per hour
    assert (old["weather"], old["steps_per_hour"]) == ("USA_IL_Chicago", 4)
    assert cases.find("office-small-USA_FL_Miami").arguments["weather"] == "USA_FL_Miami"


def test_boptest_cases__scenarios_are_test_cases_without_noise_and_with_one_weather(tmp_path):
    packs.sinergym()
    file = tmp_path / "mine.yaml"
    file.write_text(SCENARIO)
    cases = BundledTestCases([file])
    assert cases.names()[0] == "mine"
    mine = cases.find("mine").arguments
    assert (mine["scenario"], mine["weather"], mine["weather_noise"], mine["steps_per_hour"]) == (
        str(file), "USA_FL_Miami", {}, 4,
    )  # fmt: skip
    assert "5zone-hot-continuous-v1" in cases.names()
    assert not any("stochastic" in name for name in cases.names())
    assert cases.find("5zone-hot-continuous-stochastic-v1").arguments["weather_noise"] == {}


def test_boptest_cases__days_are_kept_until_the_scenario_changes(tmp_path, monkeypatch):
    monkeypatch.setenv("ZENOSTAT_CACHE", str(tmp_path / "cache"))
    file = tmp_path / "mine.yaml"
    file.write_text(SCENARIO)
    cases = BundledTestCases([file])
    assert cases.find("mine").days is None
    cases.save_days(cases.find("mine"), {"peak_heat_day": 20})
    assert BundledTestCases([file]).find("mine").days == {"peak_heat_day": 20}
    file.write_text(SCENARIO.replace("office-small", "office-medium"))
    assert BundledTestCases([file]).find("mine").days is None


def test_boptest_cases__days_are_kept_until_the_model_or_the_weather_changes(tmp_path, monkeypatch):
    monkeypatch.setenv("ZENOSTAT_CACHE", str(tmp_path / "cache"))
    model, weather, file = tmp_path / "own.idf", tmp_path / "own.epw", tmp_path / "mine.yaml"
    model.write_bytes(catalog.find_building("ref-small-office").path.read_bytes())
    weather.write_bytes(catalog.find_weather("USA_FL_Miami").path.read_bytes())
    file.write_text("building: own.idf\nweather: own.epw\n")
    cases = BundledTestCases([file])
    for changed in (model, weather):
        cases.save_days(cases.find("mine"), {"peak_heat_day": 20})
        assert cases.find("mine").days == {"peak_heat_day": 20}
        changed.write_bytes(changed.read_bytes() + b"\n")
        assert cases.find("mine").days is None


def test_boptest_cases__file_with_the_name_of_a_bundled_building_takes_its_place_with_its_own_days(
    tmp_path, monkeypatch
):
    monkeypatch.setenv("ZENOSTAT_CACHE", str(tmp_path / "cache"))
    file = tmp_path / "office-small.yaml"
    file.write_text(SCENARIO)
    cases = BundledTestCases([file])
    assert cases.names().count("office-small") == 1
    assert cases.find("office-small").days is None
    assert BundledTestCases().find("office-small").days


def test_boptest_cases__files_of_one_name_are_refused(tmp_path):
    files = [tmp_path / folder / "mine.yaml" for folder in ("a", "b")]
    for file in files:
        file.parent.mkdir()
        file.write_text(SCENARIO)
    with pytest.raises(InvalidConfig, match=r"a/mine.yaml and .*b/mine.yaml have the same name"):
        BundledTestCases(files)


def test_boptest_cases__unknown_names_list_similar_ones_and_bad_files_are_refused(tmp_path: Path):
    with pytest.raises(UnknownName, match="office-small"):
        BundledTestCases().find("ofice-small")
    with pytest.raises(UnknownName, match="there is no file"):
        BundledTestCases([tmp_path / "none.yaml"])


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--address", "0.0.0.0:0"], "pass --expose to allow it"),
        (["--address", "8000"], "HOST:PORT expected"),
        (["--address", "127.0.0.1:70000"], "HOST:PORT expected"),
        (["--address", "127.0.0.1:²"], "HOST:PORT expected"),
        (["--address", f"{'a' * 70}.com:8000", "--expose"], "no valid host name"),
        (["--price", "gaz=1"], "no fuel 'gaz'"),
        (["--address", "127.0.0.1:0", "ofice-small"], "no test case 'ofice-small'"),
    ],
)
def test_boptest_cases__command_refuses_before_it_serves(arguments, text):
    result = CliRunner().invoke(typer.main.get_command(app), ["gateway", "boptest", *arguments])
    assert text in f"{result.exception}"


def test_boptest_cases__address_in_use_is_refused():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        result = CliRunner().invoke(typer.main.get_command(app), ["gateway", "boptest", "--address", address])
    assert f"another program listens on {address}" in f"{result.exception}"
