"""Episodes: what is drawn, and the files that EnergyPlus reads."""

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from datetime import date, timedelta
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.weather_files import STEPS_PER_HOUR
from support.weather_files import run as run_outdoors

from zenostat.models.building.model import Building, read_building
from zenostat.models.catalog import find_building, find_weather
from zenostat.models.run_period import Period
from zenostat.models.scenario.episode_weather import (
    EpisodeFactory,
    EpisodeFiles,
    WeatherDraw,
    WeatherSampler,
    WeatherSource,
    check_years,
    series,
)
from zenostat.models.weather import design_days, epw
from zenostat.models.weather.header import read_header
from zenostat.models.weather.noise import ColumnNoise, Variability
from zenostat.models.weather.records import missing_values
from zenostat.topics.errors import InvalidConfig

SEEDS = st.integers(0, 2**64)
ORDERS = ("random", "sequence")


def draws(sampler: WeatherSampler, count: int, seed: int | None = None) -> list[WeatherDraw]:
    return [sampler.draw(seed if number == 0 else None) for number in range(count)]


def seeded(sources: int, order: Any, seed: int | None, count: int, *, noisy: bool = True) -> list[WeatherDraw]:
    return draws(WeatherSampler(sources, order, noisy=noisy), count, seed)


# Draws


@given(SEEDS, st.integers(1, 20), st.sampled_from(ORDERS), st.booleans(), st.integers(0, 9))
def test_episode_files__seed_begins_the_same_draws_anew(
    seed: int, sources: int, order: str, noisy: bool, before: int
) -> None:
    sampler = WeatherSampler(sources, order, noisy=noisy)  # type: ignore[arg-type]
    first = draws(sampler, 10, seed)
    draws(sampler, before)
    assert draws(sampler, 10, seed) == first
    assert seeded(sources, order, seed, 10, noisy=noisy) == first


def test_episode_files__without_a_seed_the_draws_differ_from_run_to_run() -> None:
    """Two noise seeds of 63 bits are the same once in 10^19 times."""
    one, other = (WeatherSampler(1, "random", noisy=True) for _ in range(2))
    assert draws(one, 1) != draws(other, 1)


def test_episode_files__seeds_and_episodes_each_have_a_noise_of_their_own() -> None:
    """20,000 seeds of 63 bits: two are the same with a chance of 2e8 / 2^63 = 2e-11, and these are fixed."""
    noises = [draw.noise for seed in range(1000) for draw in seeded(3, "random", seed, 20)]
    assert len(set(noises)) == len(noises)
    assert all(0 <= noise < 2**63 for noise in noises)


@given(SEEDS, st.integers(1, 9))
def test_episode_files__sequence_goes_round_and_a_seed_begins_it_anew(seed: int, sources: int) -> None:
    sampler = WeatherSampler(sources, "sequence", noisy=True)
    round_and_round = [k % sources for k in range(3 * sources + 1)]
    assert [draw.source for draw in draws(sampler, 3 * sources + 1, seed)] == round_and_round
    assert [draw.source for draw in draws(sampler, sources + 1, seed + 1)] == round_and_round[: sources + 1]


@pytest.mark.parametrize("order", ORDERS)
def test_episode_files__draws_go_on_from_episode_to_episode(order: str) -> None:
    """The noise of no two of a hundred episodes is the same: a chance of 5e-16 that it were."""
    assert len({draw.noise for draw in seeded(4, order, 0, 100)}) == 100


def within_five_deviations(counts: Counter[int], sources: int, total: int) -> bool:
    """Each count is binomial; with 5 standard deviations one in 1.7 million of fair ones is refused."""
    mean, deviation = total / sources, np.sqrt(total * (1 / sources) * (1 - 1 / sources))
    return all(abs(counts[k] - mean) <= 5 * deviation for k in range(sources))


@pytest.mark.variants
@pytest.mark.parametrize("sources", [2, 3, 7, 16])
def test_episode_files__random_draws_reach_all_sources_alike(sources: int) -> None:
    """Within the episodes of one seed, and as the first episode of many seeds."""
    total = 4000
    one = Counter(draw.source for draw in seeded(sources, "random", 1, total))
    many = Counter(seeded(sources, "random", seed, 1)[0].source for seed in range(total))
    assert set(one) == set(many) == set(range(sources))
    assert within_five_deviations(one, sources, total)
    assert within_five_deviations(many, sources, total)


def test_episode_files__random_draws_do_not_follow_from_the_one_before() -> None:
    """Nine pairs of three sources, alike within 5 standard deviations."""
    drawn = [draw.source for draw in seeded(3, "random", 2, 9001)]
    pairs = Counter(3 * before + after for before, after in pairwise(drawn))
    assert within_five_deviations(pairs, 9, 9000)


@pytest.mark.parametrize("order", ORDERS)
def test_episode_files__without_noise_there_is_no_noise_seed(order: str) -> None:
    assert {draw.noise for draw in seeded(3, order, 5, 20, noisy=False)} == {0}


@given(SEEDS, st.integers(1, 9))
def test_episode_files__noise_does_not_change_which_weather_is_drawn(seed: int, sources: int) -> None:
    with_noise, without = (seeded(sources, "random", seed, 10, noisy=noisy) for noisy in (True, False))
    assert [draw.source for draw in with_noise] == [draw.source for draw in without]


@given(SEEDS, st.integers(1, 9))
def test_episode_files__order_of_the_weathers_does_not_change_the_noise(seed: int, sources: int) -> None:
    random, sequence = (seeded(sources, order, seed, 10) for order in ORDERS)
    assert [draw.noise for draw in random] == [draw.noise for draw in sequence]


@pytest.mark.parametrize(("few", "more"), list(combinations((1, 2, 3, 5, 16), 2)))
def test_episode_files__number_of_weathers_does_not_change_the_noise(few: int, more: int) -> None:
    for seed in range(20):
        one, other = (seeded(sources, "random", seed, 10) for sources in (few, more))
        assert [draw.noise for draw in one] == [draw.noise for draw in other]


# Files

SMALL = "ref-small-office"
DENVER, MIAMI = "USA_CO_Denver", "USA_FL_Miami"
NOISE: Variability = {"dry_bulb_temperature": ColumnNoise(sigma=(1.0, 2.0), tau_h=12.0)}


@pytest.fixture(scope="module")
def small() -> Building:
    return read_building(find_building(SMALL))


def source(name: str, sizing: str = "weather") -> WeatherSource:
    path = find_weather(name).path
    header = read_header(path)
    return WeatherSource(name, path, header, design_days.site(path, header) if sizing == "weather" else None)


def episodes(
    building: Building, sources: Sequence[WeatherSource], weather_noise: Variability | None = None
) -> EpisodeFactory:
    return EpisodeFactory(building, building.period("07-03", "07-04", 4), sources, weather_noise or {}, outputs=False)


def prepared(of: EpisodeFactory, draw: WeatherDraw, folder: Path) -> EpisodeFiles:
    folder.mkdir()
    return of.prepare(draw, folder, folder / "in.epw")


def objects(files: EpisodeFiles) -> dict[str, Any]:
    return dict(json.loads(files.model.read_text()))


def test_episode_files__same_draw_gives_the_same_files(small: Building, tmp_path: Path) -> None:
    """Also from other episodes, and after others: nothing but the draw counts."""
    used, fresh = (episodes(small, [source(DENVER), source(MIAMI)], NOISE) for _ in range(2))
    first = prepared(used, WeatherDraw(1, 12345), tmp_path / "first")
    prepared(used, WeatherDraw(0, 7), tmp_path / "between")
    prepared(fresh, WeatherDraw(0, 12345), tmp_path / "before")
    again, elsewhere = (
        prepared(used, WeatherDraw(1, 12345), tmp_path / "b"),
        prepared(fresh, WeatherDraw(1, 12345), tmp_path / "c"),
    )
    for other in (again, elsewhere):
        assert other.weather.read_bytes() == first.weather.read_bytes()
        assert other.model.read_bytes() == first.model.read_bytes()
        assert other.noise_parameters == first.noise_parameters


def test_episode_files__noise_is_put_on_the_weather_that_was_drawn(small: Building, tmp_path: Path) -> None:
    """Miami is some 14 K warmer than Denver; noise of mean 0 shifts a year's mean by less than 1 K."""
    sources = [source(DENVER), source(MIAMI)]
    factory = episodes(small, sources, NOISE)
    for number, drawn in enumerate((1, 0, 1)):
        noisy, own = (
            epw.read(prepared(factory, WeatherDraw(drawn, number), tmp_path / str(number)).weather),
            sources[drawn],
        )
        assert noisy.header.place == own.header.place
        shift = noisy.column("dry_bulb_temperature") - epw.read(own.path).column("dry_bulb_temperature")
        assert abs(np.mean(shift)) < 1.0


def test_episode_files__another_noise_is_another_weather_and_the_same_model(small: Building, tmp_path: Path) -> None:
    factory = episodes(small, [source(DENVER)], NOISE)
    one, other = (
        prepared(factory, WeatherDraw(0, 1), tmp_path / "one"),
        prepared(factory, WeatherDraw(0, 2), tmp_path / "other"),
    )
    assert one.weather.read_bytes() != other.weather.read_bytes()
    assert one.noise_parameters != other.noise_parameters
    assert one.model.read_bytes() == other.model.read_bytes()


def test_episode_files__noise_changes_the_weather_by_about_what_was_drawn(small: Building, tmp_path: Path) -> None:
    """8760 hours with a correlation of 12 h are some 365 independent ones: the deviation is known to 4 %.

    Its error is sigma / sqrt(2 * 365), that of the mean sigma / sqrt(365); five of either are allowed.
    """
    files = prepared(episodes(small, [source(DENVER)], NOISE), WeatherDraw(0, 3), tmp_path / "noisy")
    before, after = (epw.read(path).column("dry_bulb_temperature") for path in (source(DENVER).path, files.weather))
    sigma = files.noise_parameters["dry_bulb_temperature.sigma"]
    assert 1.0 <= sigma <= 2.0
    assert files.noise_parameters["dry_bulb_temperature.tau_h"] == 12.0
    assert files.noise_parameters["dry_bulb_temperature.mu"] == 0.0
    assert np.std(after - before) == pytest.approx(sigma, rel=5 / np.sqrt(2 * 365))
    assert abs(np.mean(after - before)) < 5 * sigma / np.sqrt(365)


def two_years(folder: Path) -> Path:
    """A file of 2017 and 2018 whose temperature has another value in each row: 250 times 40 more is its number."""
    lines = find_weather(DENVER).path.read_text("latin-1").splitlines()
    lines[7] = "DATA PERIODS,1,1,Data,Sunday,1/1/2017,12/31/2018"
    cells = [[str(year), *line.split(",")[1:]] for year in (2017, 2018) for line in lines[8:]]
    for row, each in enumerate(cells):
        each[6] = f"{-40 + row / 250:.3f}"
    path = folder / "two.epw"
    path.write_text("\n".join([*lines[:8], *(",".join(each) for each in cells), ""]), encoding="latin-1")
    return path


@pytest.mark.parametrize(
    ("begin", "end", "rows", "by_year"),
    [
        (date(2017, 7, 3), date(2017, 7, 3), [*range(4392, 4392 + 8 * 24)], False),
        (date(2018, 7, 3), date(2018, 7, 3), [*range(4392, 4392 + 8 * 24)], False),  # no account of the year
        (date(2017, 12, 30), date(2018, 1, 2), [*range(8712, 8712 + 11 * 24)], False),
        (date(2017, 12, 30), date(2018, 12, 30), [*range(8712, 17520), *range(6 * 24)], False),
        (date(2017, 7, 3), date(2017, 7, 3), [*range(4392, 4392 + 8 * 24)], True),
        (date(2018, 7, 3), date(2018, 7, 3), [*range(8760 + 4392, 8760 + 4392 + 8 * 24)], True),
        (date(2017, 12, 30), date(2018, 12, 30), [*range(8712, 17520)], True),  # and nothing after it
    ],
)
def test_series__of_a_file_of_two_years_is_what_energyplus_reads(
    begin: date, end: date, rows: list[int], by_year: bool, tmp_path: Path
) -> None:
    path = two_years(tmp_path)
    values, step_s = series(path, Period(begin, end, 4, by_year), ["dry_bulb"])
    assert (step_s, np.rint((values[:, 0] + 40) * 250).astype(int).tolist()) == (3600.0, rows)
    actual = {"treat_weather_as_actual": "Yes"} if by_year else {}
    ran = run_outdoors(tmp_path / "run", path, begin, min(end, begin + timedelta(days=3)), run_period=actual)
    measured = ran.values[0][STEPS_PER_HOUR - 1 :: STEPS_PER_HOUR, 0]
    assert np.array_equal(measured, values[: len(measured), 0])


def test_check_years__names_the_years_of_the_file(tmp_path: Path) -> None:
    path = two_years(tmp_path)
    check_years(path, "two", Period(date(2018, 7, 3), date(2018, 7, 4), 4, by_year=True))
    check_years(path, "two", Period(date(2019, 7, 3), date(2019, 7, 4), 4))
    for begin, end in ((date(2016, 12, 30), date(2017, 1, 2)), (date(2018, 12, 30), date(2019, 1, 2))):
        with pytest.raises(InvalidConfig, match=r"weather file two has no .*from 2017-01-01 to 2018-12-31; write the"):
            check_years(path, "two", Period(begin, end, 4, by_year=True))


def test_building__run_period_by_year_is_that_of_the_model(small: Building) -> None:
    objects = {**small.objects, "RunPeriod": {"r": {"treat_weather_as_actual": "Yes"}}}
    assert replace(small, objects=objects).period("07-03", "07-04", None).by_year
    assert not small.period("07-03", "07-04", None).by_year


def test_building__own_run_period_of_several_years_ends_in_its_last_one(small: Building) -> None:
    days = {"begin_month": 1, "begin_day_of_month": 1, "begin_year": 2016, "end_month": 12, "end_day_of_month": 31}
    model = replace(small, objects={**small.objects, "RunPeriod": {"r": days | {"end_year": 2018}}})
    assert model.period("03-01", None, None) == Period(date(2016, 3, 1), date(2018, 12, 31), model.steps_per_hour)
    assert model.period("2017-03-01", None, None).end == date(2018, 12, 31)
    assert model.period("2018-03-01", None, None).end == date(2018, 12, 31)
    assert model.period("2020-03-01", None, None).end == date(2020, 12, 31)
    assert model.period("03-01", "03-02", None).end == date(2016, 3, 2)


def with_gaps(path: Path, cells: dict[tuple[int, str], str]) -> Path:
    """Write Denver's weather with other cells on 3 July, by row of the day and column."""
    lines = find_weather(DENVER).path.read_text("latin-1").splitlines()
    for (row, column), text in cells.items():
        row_cells = lines[8 + 4392 + row].split(",")
        row_cells[epw.COLUMNS[column].index] = text
        lines[8 + 4392 + row] = ",".join(row_cells)
    path.write_text("\n".join([*lines, ""]), encoding="latin-1")
    return path


def test_series__missing_values_are_those_that_energyplus_takes(tmp_path: Path) -> None:
    """The last one before it, of the temperature; none, of global radiation, which is not used."""
    gaps = {"dry_bulb_temperature": "99.9", "global_horizontal_radiation": "9999"}
    path = with_gaps(tmp_path / "gap.epw", {(row, column): gaps[column] for column in gaps for row in range(5, 9)})
    day = date(2017, 7, 3)
    values, _ = series(path, Period(day, day, 4), ["dry_bulb", "global_horizontal_radiation"])
    assert np.flatnonzero(np.isnan(values[:, 1])).tolist() == [5, 6, 7, 8]
    assert values[5:9, 0].tolist() == [values[4, 0]] * 4 != [values[9, 0]] * 4
    measured = run_outdoors(tmp_path / "run", path, day, day).values[0][STEPS_PER_HOUR - 1 :: STEPS_PER_HOUR, 0]
    assert np.array_equal(measured, values[: len(measured), 0])


@pytest.mark.parametrize(
    ("column", "variable"),
    [
        ("dry_bulb_temperature", "Site Outdoor Air Drybulb Temperature"),
        ("dew_point_temperature", "Site Outdoor Air Dewpoint Temperature"),
        ("relative_humidity", "Site Outdoor Air Relative Humidity"),
        ("atmospheric_station_pressure", "Site Outdoor Air Barometric Pressure"),
        ("wind_direction", "Site Wind Direction"),
        ("wind_speed", "Site Wind Speed"),
    ],
)
def test_series__values_missing_at_the_beginning_are_those_that_energyplus_takes(
    column: str, variable: str, tmp_path: Path
) -> None:
    day, at = date(2017, 7, 3), epw.COLUMNS[column]
    path = with_gaps(tmp_path / "gap.epw", {(row, column): f"{at.missing:g}" for row in range(3)})
    values, _ = series(path, Period(day, day, 4), [column])
    ran = run_outdoors(tmp_path / "run", path, day, day, variables=[variable])
    measured = ran.values[0][STEPS_PER_HOUR - 1 :: STEPS_PER_HOUR, 0]
    assert measured[:4] == pytest.approx(values[:4, 0], rel=1e-6)
    (sentence,) = missing_values(path, "gap")
    assert f"at the beginning of a run {values[0, 0]:g} {at.unit}" in sentence


MISSING_AT_NOON = {
    "direct_normal_radiation": "Site Direct Solar Radiation Rate per Area",
    "diffuse_horizontal_radiation": "Site Diffuse Solar Radiation Rate per Area",
    "horizontal_infrared_radiation_intensity": "Site Horizontal Infrared Radiation Rate per Area",
    "total_sky_cover": "Site Total Sky Cover",
    "opaque_sky_cover": "Site Opaque Sky Cover",
    "relative_humidity": "Site Outdoor Air Relative Humidity",
}


def test_series__gap_of_a_logger_is_what_energyplus_simulates(tmp_path: Path) -> None:
    """No sun, the infrared radiation of a computed sky, and the humidity of the hour before in whole percent."""
    day, gap, infrared = date(2017, 7, 3), range(10, 14), "horizontal_infrared_radiation_intensity"
    cells = {(row, column): f"{epw.COLUMNS[column].missing:g}" for column in MISSING_AT_NOON for row in gap}
    cells |= {(gap[0] - 1, "relative_humidity"): "37.6", (gap[-1] + 2, infrared): "0"}
    path = with_gaps(tmp_path / "gap.epw", cells)
    values, _ = series(path, Period(day, day, STEPS_PER_HOUR), list(MISSING_AT_NOON))
    ran = run_outdoors(tmp_path / "run", path, day, day, variables=list(MISSING_AT_NOON.values()))
    hours = ran.values[0].reshape(24, STEPS_PER_HOUR, -1)
    # EnergyPlus takes a row of the sun at the middle of its hour, other rows at the end.
    measured = np.column_stack([hours[:, STEPS_PER_HOUR // 2 - 1, :2], hours[:, -1, 2:]])
    assert measured[8:18] == pytest.approx(values[8:18], rel=1e-6)
    assert not values[gap, :2].any()
    assert values[gap, 5].tolist() == [38.0] * len(gap)
    (sentence,) = missing_values(path, "gap")
    assert "direct_normal_radiation (4), diffuse_horizontal_radiation (4); " in sentence
    assert f"{infrared} (5), " in sentence
    assert "no sun (0 W/m2)" in sentence
    assert "at the beginning of a run 50 %;" in sentence


def test_series__global_radiation_is_zero_only_without_any_sun(tmp_path: Path) -> None:
    radiation = [f"{kind}_radiation" for kind in ("global_horizontal", "direct_normal", "diffuse_horizontal")]
    cells = dict.fromkeys([(10, radiation[0]), *((12, column) for column in radiation)], "9999")
    path, day = with_gaps(tmp_path / "gap.epw", cells), date(2017, 7, 3)
    values, _ = series(path, Period(day, day, STEPS_PER_HOUR), radiation)
    assert np.isnan(values[10, 0])
    assert values[12].tolist() == [0.0, 0.0, 0.0]


def late_noise(begin: date, end: date, path: Path) -> list[tuple[int, int]]:
    """Write the weather of an episode with noise from its third day on, and return the days with noise."""
    of = EpisodeFactory(Building("b", {}, ""), Period(begin, end, 4), [source(DENVER)], NOISE, outputs=False,
                        noise_start="third_day")  # fmt: skip
    of.write_noise(WeatherDraw(0, 5), path)
    plain, noisy = (epw.read(each) for each in (find_weather(DENVER).path, path))
    differs = plain.column("dry_bulb") != noisy.column("dry_bulb")
    return list(dict.fromkeys((month, day) for _, month, day, _, _ in plain.times[differs].tolist()))


def test_late_noise__goes_on_after_new_year(tmp_path: Path) -> None:
    days = late_noise(date(2017, 12, 22), date(2018, 1, 10), tmp_path / "over.epw")
    assert days == [(1, day) for day in range(1, 18)] + [(12, day) for day in range(24, 32)]
    before = late_noise(date(2017, 12, 22), date(2017, 12, 24), tmp_path / "before.epw")
    assert before == [(12, day) for day in range(24, 32)]
    december = [path.read_bytes()[-20_000:] for path in (tmp_path / "over.epw", tmp_path / "before.epw")]
    assert december[0] == december[1]


def test_late_noise__period_that_begins_at_the_end_of_the_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidConfig, match=r"begins on 12-30: the weather file .* ends before the third day"):
        late_noise(date(2017, 12, 30), date(2018, 1, 10), tmp_path / "late.epw")


def test_episode_files__noisy_weather_is_written_beside_the_model_and_the_original_is_left_alone(
    small: Building, tmp_path: Path
) -> None:
    original = source(DENVER).path
    before = original.read_bytes()
    files = prepared(episodes(small, [source(DENVER)], NOISE), WeatherDraw(0, 3), tmp_path / "noisy")
    assert files.weather.parent == files.model.parent == tmp_path / "noisy"
    assert files.weather != original
    assert original.read_bytes() == before


def test_episode_files__without_variability_the_file_itself_is_read(small: Building, tmp_path: Path) -> None:
    factory = episodes(small, [source(DENVER), source(MIAMI)])
    prepared_files = [prepared(factory, WeatherDraw(k, 0), tmp_path / str(k)) for k in range(2)]
    assert [files.weather for files in prepared_files] == [find_weather(name).path for name in (DENVER, MIAMI)]
    assert [files.noise_parameters for files in prepared_files] == [{}, {}]
    assert [file.name for file in (tmp_path / "0").iterdir()] == ["in.epJSON"]


def test_episode_files__location_and_design_days_follow_the_weather(small: Building, tmp_path: Path) -> None:
    """Denver lies at 39.7 degrees north and 1.7 km up, Miami at 25.8 degrees and at the sea."""
    factory = episodes(small, [source(DENVER), source(MIAMI)])
    denver, miami = (objects(prepared(factory, WeatherDraw(k), tmp_path / str(k))) for k in range(2))
    (high,), (low,) = (model["Site:Location"].values() for model in (denver, miami))
    assert (high["latitude"], low["latitude"]) == pytest.approx((39.7, 25.8), abs=0.2)
    assert high["elevation"] > 1500
    assert low["elevation"] < 20
    coldest = [
        min(day["maximum_dry_bulb_temperature"] for day in model["SizingPeriod:DesignDay"].values())
        for model in (denver, miami)
    ]
    assert coldest[0] < -10
    assert coldest[1] > 0


def test_design_days_model__keeps_the_models_location_and_days(small: Building, tmp_path: Path) -> None:
    model = objects(prepared(episodes(small, [source(MIAMI, "model")]), WeatherDraw(), tmp_path / "own"))
    for kind in ("Site:Location", "SizingPeriod:DesignDay"):
        assert model[kind] == small.objects[kind]


def test_episode_files__run_period_is_that_of_the_episode(small: Building, tmp_path: Path) -> None:
    model = objects(prepared(episodes(small, [source(DENVER)]), WeatherDraw(), tmp_path / "own"))
    (run,) = model["RunPeriod"].values()
    days = [run[f"{end}_{part}"] for end in ("begin", "end") for part in ("month", "day_of_month")]
    assert days == [7, 3, 7, 4]
    (timestep,) = model["Timestep"].values()
    assert timestep["number_of_timesteps_per_hour"] == 4
