"""All errors of a scenario file are reported together, whichever part detects them."""

import shlex
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest
from typer.testing import CliRunner

import zenostat  # noqa: F401  # registers the environments
from zenostat.cli.commands import app
from zenostat.eplus_node.config import read_config
from zenostat.eplus_node.plan import plan
from zenostat.topics.calendar import parse_day
from zenostat.topics.errors import InvalidConfig, UnknownName

MINE = """
building: offfice-small
wheather: USA_CO_Denver
begin: 13-01
end: 07-32
steps_per_hour: 7
reward:
  kind: liner
wrappers:
- {wrapper: CyclicTme}
- {wrapper: CyclicTime, fiels: [hour]}
"""
EXPECTED = (
    "wheather: there is no such field; did you mean 'weather'", "weather: it is missing",
    "no building 'offfice-small'; did you mean 'office-small'", "begin '13-01' is not a calendar date",
    "end '07-32' is not a calendar date", "steps_per_hour 7 does not divide the hour",
)  # fmt: skip
AGENT_ERRORS = (
    "no kind 'liner'; did you mean 'linear'",
    "wrappers[0]: there is no wrapper 'CyclicTme'; did you mean 'CyclicTime'",
    "wrappers[1]: CyclicTime has no argument 'fiels'; did you mean 'fields'",
)
"""Of fields that a node passes on to its agents."""


def _error_lines(path: Path) -> list[str]:
    with pytest.raises(InvalidConfig) as caught:
        plan(read_config({"scenario": str(path)}))
    return str(caught.value).splitlines()


def test_plan__reports_unknown_fields_names_and_dates_together(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(MINE)
    text = "\n".join(_error_lines(path))
    assert [words for words in EXPECTED if words not in text] == []


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"building": ""}, ["no building ''; there are: 'apartment-high-rise'"]),
        ({"weather": ""}, ["no weather ''; there are: "]),
        ({"weather": ["USA_CO_Denver", ""]}, ["no weather ''; there are: "]),
        ({"building": "", "weather": ""}, ["no building ''", "no weather ''"]),
    ],
)
def test_plan__empty_name_is_no_name(fields: dict[str, Any], expected: list[str]) -> None:
    settings = {"building": "office-small", "weather": "USA_CO_Denver", **fields}
    with pytest.raises(UnknownName) as caught:
        plan(read_config(settings))
    assert [words for words in expected if words not in str(caught.value)] == []


def test_make__reports_errors_of_reward_and_wrappers_as_well(scratch: Path) -> None:
    path = scratch / "mine.yaml"
    path.write_text(MINE)
    with pytest.raises(InvalidConfig) as caught:
        gym.make("zenostat/Scenario-v1", file=path, affinity="off")
    assert [words for words in (*EXPECTED, *AGENT_ERRORS) if words not in str(caught.value)] == []


@pytest.mark.parametrize("command", ["scenarios check {}", "scenarios show {}", "node --scenario {}"])
def test_command__reports_errors_of_reward_and_wrappers_as_well(tmp_path: Path, command: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(MINE)
    result = CliRunner().invoke(app, shlex.split(command.format(path)))
    assert isinstance(result.exception, InvalidConfig)
    assert [words for words in (*EXPECTED, *AGENT_ERRORS) if words not in str(result.exception)] == []


def test_plan__reports_no_consequences_of_another_error(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("building: [1]\nweather: USA_CO_Denver\ndiscret: 4\n")
    (line,) = _error_lines(path)
    assert "building:" in line
    assert "discret: there is no such field" in line


@pytest.mark.parametrize("day", ["13-01", "00-10", "02-30", "2018-04-31", "07-00"])
def test_parse_day__of_no_calendar_does_not_name_the_year(day: str) -> None:
    with pytest.raises(InvalidConfig, match="is not a calendar date; write it as MM-DD") as caught:
        parse_day(day, "begin", 2017)
    assert "2017" not in str(caught.value)


def test_parse_day__leap_day_names_the_common_year() -> None:
    with pytest.raises(InvalidConfig, match="'02-29' does not exist in 2017, the model's year; give another year"):
        parse_day("02-29", "begin", 2017)
