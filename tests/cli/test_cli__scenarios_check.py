"""`zenostat scenarios check` finds what would fail at the start, all of it in one go."""

import shutil
from pathlib import Path

import pytest
from support.nodes import SMALL
from typer.testing import CliRunner

from zenostat.cli.commands import app
from zenostat.models.catalog import find_weather
from zenostat.topics.errors import UsageError

HEAD = "building: ref-small-office\nbegin: 07-03\nend: 07-03\n"


def errors_of(file: Path) -> str:
    done = CliRunner().invoke(app, ["scenarios", "check", str(file)])
    assert isinstance(done.exception, UsageError), done.output
    return str(done.exception)


def scenario(folder: Path, text: str, weather: str = SMALL["weather"]) -> Path:
    file = folder / "mine.yaml"
    file.write_text(f"{HEAD}weather: {weather}\n{text}")
    return file


def truncated(folder: Path, *, cut_bytes: int) -> str:
    source = find_weather(SMALL["weather"]).path
    for path in source.parent.glob(f"{source.stem}.*"):
        shutil.copy(path, folder)
    data = source.read_bytes()
    (folder / source.name).write_bytes(data[: len(data) - cut_bytes])
    return str(folder / source.name)


@pytest.mark.process
def test_cli__points_of_the_reward_and_arguments_of_wrappers_are_checked_together(tmp_path: Path) -> None:
    text = errors_of(
        scenario(
            tmp_path,
            "reward: {kind: linear, temperatures: [offic, core_zn_air_temperature, outdoor_humidity], power: powr}\n"
            "wrappers: [{wrapper: ReducedObservation, keep: [core_air]}]\n",
        )
    )
    assert "the linear reward names 'offic', which the node does not have" in text
    assert "the linear reward needs a sensor in degC, which 'outdoor_humidity' is not" in text
    assert "the linear reward names 'powr', which the node does not have" in text
    assert "core_air" in text
    assert text.count("\n") == 3


@pytest.mark.process
@pytest.mark.parametrize(
    ("cut_bytes", "text"),
    [(200_000, "has 7,"), (20, "its last record is cut off")],
    ids=["hours missing", "last line cut"],
)
def test_cli__truncated_weather_file_is_found_beside_other_errors(tmp_path: Path, cut_bytes: int, text: str) -> None:
    weather = truncated(tmp_path, cut_bytes=cut_bytes)
    errors = errors_of(scenario(tmp_path, "reward: {kind: linear, power: powr}\n", weather))
    assert "is incomplete" in errors
    assert text in errors
    assert "names 'powr'" in errors


@pytest.mark.process
def test_cli__scenario_that_can_run_passes(tmp_path: Path) -> None:
    file = scenario(
        tmp_path,
        "time: [hour]\nreward: {kind: linear, temperatures: core_zn_air_temperature}\n"
        "wrappers: [{wrapper: CyclicTime, fields: [hour]}, {wrapper: RescaleAction, min_action: -1, max_action: 1}]\n",
    )
    done = CliRunner().invoke(app, ["scenarios", "check", str(file)])
    assert done.exit_code == 0, done.exception
    assert "96 timesteps" in done.output or "144 timesteps" in done.output
