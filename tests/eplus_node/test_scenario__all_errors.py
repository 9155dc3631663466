"""All that is wrong with a scenario file is said at once, whichever part checks it."""

from __future__ import annotations

from pathlib import Path

import gymnasium as gym
import pytest

import agent_sdk  # noqa: F401  # registers the environments
from eplus_node.config import plan, read_config
from models.scenario.run_period import parse_day
from topics.errors import InvalidConfig

MINE = """
building: offfice-small
wheather: USA_CO_Denver
begin: 13-01
end: 07-32
steps_per_hour: 7
reward:
  kind: liner
"""
WORDS = (
    "wheather: there is no such field; near names: 'weather'",
    "weather: it is missing",
    "no building 'offfice-small'; near names: 'office-small'",
    "begin '13-01' is not a calendar date",
    "end '07-32' is not a calendar date",
    "steps_per_hour 7 does not divide the hour",
)


def _told(path: Path) -> list[str]:
    with pytest.raises(InvalidConfig) as caught:
        plan(read_config({"scenario": str(path)}))
    return str(caught.value).splitlines()


def test_unknown_fields_wrong_names_and_wrong_days_are_told_together(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(MINE)
    text = "\n".join(_told(path))
    assert [words for words in WORDS if words not in text] == []


def test_so_are_those_of_the_reward(scratch: Path) -> None:
    path = scratch / "mine.yaml"
    path.write_text(MINE)
    with pytest.raises(InvalidConfig) as caught:
        gym.make("zenostat/Scenario-v1", file=path, affinity="off")
    assert [words for words in (*WORDS, "no kind 'liner'") if words not in str(caught.value)] == []


def test_nothing_is_told_that_follows_from_another_error(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("building: [1]\nweather: USA_CO_Denver\ndiscret: 4\n")
    (line,) = _told(path)
    assert "building:" in line
    assert "discret: there is no such field" in line


@pytest.mark.parametrize("day", ["13-01", "00-10", "02-30", "2018-04-31", "07-00"])
def test_a_day_of_no_year_does_not_blame_the_year(day: str) -> None:
    with pytest.raises(InvalidConfig, match="is not a calendar date; write it as MM-DD") as caught:
        parse_day(day, "begin", 2017)
    assert "2017" not in str(caught.value)


def test_a_leap_day_of_a_common_year_blames_the_year() -> None:
    with pytest.raises(InvalidConfig, match="'02-29' does not exist in 2017, the model's year; give another year"):
        parse_day("02-29", "begin", 2017)
