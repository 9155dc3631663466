"""The points of a model, with any weather file that EnergyPlus can start with, and any run period of the model."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support.box_model import box_model

from zenostat.models.building.model import Building
from zenostat.models.catalog import find_weather
from zenostat.models.points.discovery import discover

DENVER = find_weather("USA_CO_Denver").path
AS_ACTUAL = {
    "RunPeriod": {
        "r": {
            "begin_month": 1,
            "begin_day_of_month": 1,
            "begin_year": 2018,
            "end_month": 1,
            "end_day_of_month": 2,
            "end_year": 2018,
            "treat_weather_as_actual": "Yes",
        }
    }
}


def rows(lines: list[str]) -> list[list[str]]:
    return [line.split(",") for line in lines]


def july(lines: list[str]) -> list[str]:
    return [line for line in lines if line.split(",")[1] == "7"]


def half_hours(lines: list[str]) -> list[str]:
    return [",".join([*row[:4], minute, *row[5:]]) for row in rows(lines) for minute in ("30", "60")]


def of_2018(lines: list[str]) -> list[str]:
    return [",".join(["2018", *row[1:]]) for row in rows(lines)]


def unchanged(lines: list[str]) -> list[str]:
    return lines


Change = Callable[[list[str]], list[str]]
CASES: dict[str, tuple[dict[str, Any], str, Change]] = {
    "a file of July": ({}, "1,1,Data,Saturday,7/1,7/31", july),
    "two records per hour": (
        {"Timestep": {"t": {"number_of_timesteps_per_hour": 5}}}, "1,2,Data,Sunday,1/1,12/31", half_hours,
    ),
    "a file of 2018, as actual": (AS_ACTUAL, "1,1,Data,Monday,1/1/2018,12/31/2018", of_2018),
    "timesteps that do not divide the hour": (
        {"Timestep": {"t": {"number_of_timesteps_per_hour": 7}}}, "1,1,Data,Sunday,1/1,12/31", unchanged,
    ),
}  # fmt: skip


@pytest.mark.process
@pytest.mark.parametrize("case", CASES)
def test_discover__any_weather_that_a_run_can_have(case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ZENOSTAT_CACHE", str(tmp_path / "cache"))
    more, periods, change = CASES[case]
    lines = DENVER.read_text("latin-1").splitlines()
    path = tmp_path / "mine.epw"
    lines = [*lines[:7], f"DATA PERIODS,{periods}", *change(lines[8:])]
    path.write_text("\r\n".join(lines) + "\r\n", encoding="latin-1")
    points = discover(Building("box", box_model() | more, f"box with {case}"), path)
    assert points == discover(Building("box", box_model(), "box"), DENVER)
