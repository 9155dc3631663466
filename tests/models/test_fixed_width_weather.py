"""Weather files with padded fields: the same values, and a layout that does not depend on them."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.weather_files import DRY_BULB, run

from zenostat.models.catalog import find_weather
from zenostat.models.run_period import date
from zenostat.models.weather.epw import COLUMNS, Weather, read
from zenostat.models.weather.fixed_width import FixedWidthWeather
from zenostat.models.weather.noise import ColumnNoise, with_noise
from zenostat.topics.errors import InvalidConfig, UnknownName

DENVER = find_weather("USA_CO_Denver").path


@pytest.fixture(scope="module")
def denver() -> Weather:
    return read(DENVER)


@pytest.fixture(scope="module")
def padded(denver: Weather) -> FixedWidthWeather:
    return FixedWidthWeather(denver)


def test_padded_file__has_the_same_values_header_and_text(
    denver: Weather, padded: FixedWidthWeather, folder: Path
) -> None:
    padded.write(folder / "padded.epw", {})
    again = read(folder / "padded.epw")
    assert np.array_equal(again.table, denver.table)
    assert (again.head, again.end, again.tail) == (denver.head, denver.end, denver.tail)
    for row, original in zip(again.rows, denver.rows, strict=True):
        assert [cell.strip() for cell in row.split(",")] == [cell.strip() for cell in original.split(",")]


def test_energyplus__reads_the_same_from_a_padded_file(padded: FixedWidthWeather, folder: Path) -> None:
    variables = [DRY_BULB, "Site Outdoor Air Relative Humidity", "Site Direct Solar Radiation Rate per Area"]
    padded.write(folder / "padded.epw", {})
    runs = []
    for name, weather in (("original", DENVER), ("padded", folder / "padded.epw")):
        (folder / name).mkdir()
        runs.append(run(folder / name, weather, date(2017, 7, 3), date(2017, 7, 5), variables=variables))
    assert np.array_equal(runs[0].values[0], runs[1].values[0])
    assert runs[0].values[0].any()


def test_layout__is_the_same_with_other_values(denver: Weather, padded: FixedWidthWeather, folder: Path) -> None:
    """Rows before the first changed one are equal byte for byte; the others have the new values."""
    noise = {"dry_bulb_temperature": ColumnNoise(sigma=40.0), "wind_speed": ColumnNoise(sigma=5.0)}
    noisy = with_noise(denver, noise, np.random.default_rng(1))
    first = 4000
    padded.write(folder / "noisy.epw", {name: values[first:] for name, values in noisy.columns.items()}, first)
    data = (folder / "noisy.epw").read_bytes()
    assert len(data) == len(padded.data)
    offset = int(padded.row_offsets[first])
    assert data[:offset] == padded.data[:offset]
    again = read(folder / "noisy.epw")
    assert set(noisy.columns) > set(noise)  # with dependent ones
    for name in COLUMNS:
        expected = denver.column(name).copy()
        expected[first:] = noisy.columns.get(name, expected)[first:]
        assert np.array_equal(again.column(name), expected), name
    assert all(data[start - 1 : start] == b"\n" for start in padded.row_offsets[:-1].tolist())


@given(st.lists(st.floats(-999_999.0, 999_999.0), min_size=1, max_size=50))
def test_numbers__have_four_decimals(padded: FixedWidthWeather, numbers: list[float]) -> None:
    texts = [bytes(row).decode() for row in padded._digits(np.array(numbers), "x")]
    for number, text in zip(numbers, texts, strict=True):
        assert (len(text), text.strip().partition(".")[2].isdigit()) == (12, True)
        assert float(text) == pytest.approx(number, abs=5.01e-5)
        assert text.lstrip() == f"{round(number * 1e4) / 1e4 + 0.0:.4f}"


def test_values__that_do_not_fit_and_unknown_columns_are_refused(padded: FixedWidthWeather, folder: Path) -> None:
    with pytest.raises(InvalidConfig, match=r"ceiling_height: 1e\+08 has too many digits"):
        padded.write(folder / "a.epw", {"ceiling_height": np.array([1e8])})
    with pytest.raises(UnknownName, match="dry_bulb"):
        padded.write(folder / "a.epw", {"drybulbs": np.zeros(3)})
