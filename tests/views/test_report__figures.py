"""The data behind a report's figures, against numbers worked out by hand."""

from dataclasses import replace
from datetime import datetime

import numpy as np
import pytest
from support.builders import actuator
from support.trajectories import J_PER_KWH, SHARES, office, office_comparison, run

from zenostat.metrics.episode_weather import EpisodeWeather
from zenostat.views.report.figures import actuators, carpets, comfort, energy, months, reward, weather
from zenostat.views.report.figures.base import Curve
from zenostat.views.report.quantities import Quantities, by_hour, by_period, load_duration
from zenostat.views.report.readings import readings
from zenostat.views.report.sections import sections

pytest.importorskip("matplotlib")

MIDNIGHT = np.datetime64("2017-07-03T00:00:00")


def begins(steps: int, minutes: int, first: np.datetime64 = MIDNIGHT) -> np.ndarray:
    return first + np.arange(steps) * np.timedelta64(minutes * 60, "s")


def test_report__load_duration_falls_and_its_area_is_the_energy() -> None:
    power = np.random.default_rng(1).uniform(5.0, 50.0, 96)
    share, falling = load_duration(power)
    assert falling[0] == power.max()
    assert (np.diff(falling) <= 0).all()
    assert (share[0], share[-1]) == (0.0, 100.0)
    hours = np.diff(share) / 100.0 * 24.0
    assert (falling[:-1] * hours).sum() == pytest.approx(power.sum() / 4)


def test_report__cell_of_a_carpet_is_the_mean_of_that_hour() -> None:
    values = np.arange(2 * 96, dtype=float)
    days, grid = by_hour(values, begins(2 * 96, 15), 900.0)
    assert [str(day) for day in days] == ["2017-07-03", "2017-07-04"]
    assert grid.shape == (2, 24)
    assert grid[0, 0] == np.mean([0, 1, 2, 3])
    assert grid[1, 23] == np.mean([188, 189, 190, 191])


def test_report__carpet_of_a_run_that_begins_at_noon_is_blank_before() -> None:
    days, grid = by_hour(np.ones(13), begins(13, 60, MIDNIGHT + np.timedelta64(12, "h")), 3600.0)
    assert len(days) == 2
    assert np.isnan(grid[0, :12]).all()
    assert (grid[0, 12:] == 1.0).all()
    assert grid[1, 0] == 1.0
    assert np.isnan(grid[1, 1:]).all()


def test_report__timestep_of_six_hours_counts_for_each_of_them() -> None:
    _, grid = by_hour(np.array([1.0, 2.0, 3.0, 4.0]), begins(4, 360), 6 * 3600.0)
    assert grid[0].tolist() == [1.0] * 6 + [2.0] * 6 + [3.0] * 6 + [4.0] * 6


def test_report__timestep_counts_for_each_hour_by_its_part_of_it() -> None:
    _, grid = by_hour(np.array([1.0, 3.0, 5.0]), begins(3, 150), 150 * 60.0)
    assert grid[0, :8] == pytest.approx([1.0, 1.0, 2.0, 3.0, 3.0, 5.0, 5.0, 5.0])
    assert np.isnan(grid[0, 8:]).all()
    days, grid = by_hour(np.array([1.0, 3.0]), begins(2, 120, MIDNIGHT + np.timedelta64(1410, "m")), 7200.0)
    assert (len(days), grid[0, 23]) == (2, 1.0)
    assert grid[1, :4] == pytest.approx([1.0, 2.0, 3.0, 3.0])


def test_report__sums_are_by_day_for_weeks_and_by_month_for_longer_runs() -> None:
    days, sums = by_period(np.ones(14 * 24), begins(14 * 24, 60))
    assert sums.tolist() == [24.0] * 14
    assert str(days[-1]) == "2017-07-16"
    months, sums = by_period(np.ones(92 * 24), begins(92 * 24, 60, np.datetime64("2017-07-01T00:00:00")))
    assert [str(month) for month in months] == ["2017-07", "2017-08", "2017-09"]
    assert sums.tolist() == [31 * 24.0, 31 * 24.0, 30 * 24.0]


def test_report__end_uses_add_up_to_the_electricity() -> None:
    comparison = office_comparison()
    figure = energy.end_uses(comparison.curves)
    total = comparison.runs[0].results[0].energy_kwh["electricity"]
    assert figure is not None
    assert sorted(figure.data["baseline (kWh)"]) == pytest.approx(sorted(share * total for share in SHARES))
    assert "other electricity" not in figure.data["end use"]


def test_report__what_the_meter_counts_beyond_the_end_uses_is_shown_as_other() -> None:
    of = office(("core",), steps=4)
    part = run("rbc", of, [10.0] * 4, [[24.0] * 4], [[0.0] * 4])
    part.trajectory.values[:, -3:] *= 0.5  # half of all end uses is not metered
    figure = energy.end_uses([Curve("rbc", 0, part.quantities)])
    assert figure.data["end use"][-1] == "other electricity"
    assert figure.data["rbc (kWh)"][-1] == pytest.approx(5.0)


def test_report__energy_by_day_is_that_of_the_metrics() -> None:
    comparison = office_comparison()
    figure = energy.periods(comparison.curves)
    assert figure.name == "energy-by-day"
    for each in comparison.runs:
        (sums,) = figure.data[f"{each.name}: electricity (kWh)"]
        assert sums == pytest.approx(each.results[0].energy_kwh["electricity"])


@pytest.mark.parametrize("kw", [0.0004, 2.0, 70_000.0])
def test_report__labels_of_energy_state_the_values_at_which_they_are(kw: float) -> None:
    of = office(("core",), steps=192)
    curves = [Curve("rbc", 0, run("rbc", of, [kw] * 192, [[24.0] * 192], [[0.0] * 192]).quantities)]
    for figure in (energy.periods(curves), months.end_uses_by_period(curves)):
        axis = figure.drawing.axes[0].yaxis
        labels = [axis.get_major_formatter()(tick, place) for place, tick in enumerate(axis.get_majorticklocs())]
        values = [float(label.replace(",", "").replace("\N{MINUS SIGN}", "-")) for label in labels]
        assert values == pytest.approx(axis.get_majorticklocs())
    (total,) = [text.get_text() for text in energy.end_uses(curves).drawing.axes[0].texts if "kWh" in text.get_text()]
    assert float(total.replace(",", "").removesuffix(" kWh")) == pytest.approx(48.0 * kw, rel=0.005)


def test_end_uses_by_period__add_up_to_those_of_the_run() -> None:
    of = office(("core",), steps=96 * 50)  # 50 days: by month
    kw = np.random.default_rng(0).uniform(1.0, 9.0, of.steps)
    one = run("rbc", of, kw, [np.full(of.steps, 24.0)], [np.ones(of.steps)])
    figure = months.end_uses_by_period([Curve("rbc", 0, one.quantities)])
    assert figure.data["month"] == ["2017-07", "2017-08"]
    july = begins(of.steps, 15) < np.datetime64("2017-08-01")
    for use, share in zip(("cooling", "fans", "interior lights"), SHARES, strict=True):
        expected = [share * kw[july].sum() / 4, share * kw[~july].sum() / 4]
        assert figure.data[f"rbc: {use} (kWh)"] == pytest.approx(expected)


def test_peak_time__is_the_end_of_the_timestep_with_the_highest_power() -> None:
    of = office(("core",), steps=8)
    one = run("rbc", of, [1.0, 5.0, 9.0, 2.0, 9.0, 1.0, 1.0, 1.0], [[24.0] * 8], [[0.0] * 8])
    assert one.quantities.peak_time == datetime(2017, 7, 3, 0, 45)


def test_report__degree_hours_by_zone_add_up_to_the_metric_and_the_worst_zone_is_first() -> None:
    comparison = office_comparison()
    figure = comfort.degree_hours(comparison.curves)
    assert list(figure.data["zone"]) == ["South", "Core"]
    assert figure.data["rbc: above (K h)"] == [pytest.approx(2.0 * 10.0), 0.0]  # 28 degC for ten hours, limit 26
    assert figure.data["rbc: below (K h)"] == [0.0, 0.0]
    assert sum(figure.data["rbc: above (K h)"]) == pytest.approx(comparison.runs[1].results[0].occupied_outside_kh)


def test_report__cold_zones_count_below_and_empty_ones_not_at_all() -> None:
    of = office(("core", "south"), steps=8)
    cold, nobody = [20.0] * 8, [0.0] * 8
    part = run("rbc", of, [1.0] * 8, [cold, cold], [[1.0] * 8, nobody])
    above, below = part.quantities.degree_hours or ([], [])
    assert list(above) == [0.0, 0.0]
    assert list(below) == [pytest.approx(3.0 * 2.0), 0.0]  # the band of July begins at 23 degC


def test_report__zone_that_is_always_comfortable_is_not_drawn() -> None:
    of = office(("core",), steps=8)
    part = run("rbc", of, [1.0] * 8, [[24.0] * 8], [[1.0] * 8])
    figure = comfort.degree_hours([Curve("rbc", 0, part.quantities)])
    assert figure.drawing is None
    assert "within the comfort band" in figure.caption


def test_report__carpet_of_a_zone_has_its_deviation() -> None:
    figure = carpets.zone(office_comparison().curves, "South", 1)
    hours = dict(zip(figure.data["hour"], figure.data["rbc (K)"], strict=True))
    assert hours["2017-07-03 07:00"] == 0.0
    assert hours["2017-07-03 08:00"] == pytest.approx(2.0)


@pytest.mark.slow
def test_report__hours_of_a_year_without_occupants_are_fainter() -> None:
    steps = 365 * 24
    hours = np.arange(steps)
    is_open = (hours % 24 >= 8) & (hours % 24 < 18) & (hours // 24 % 7 < 5)
    of = office(("core",), steps=steps, begin="2017-01-02T00:00:00").model_copy(update={"step_s": 3600.0})
    warm = run("rbc", of, [10.0] * steps, [[29.0] * steps], [is_open.astype(float)])
    figure = carpets.zone([Curve("rbc", 0, warm.quantities)], "Core", 1)
    (image,) = figure.drawing.axes[0].get_images()
    opacity = np.asarray(image.get_array())[..., 3].T.ravel()
    assert opacity[is_open] == pytest.approx(1.0)
    assert opacity[~is_open] == pytest.approx(0.35)
    assert "Faint: nobody there." in figure.caption


def test_report__hours_within_the_band_are_blank_and_others_the_stronger_the_farther() -> None:
    alpha = carpets.tint(np.array([0.0, 0.1, 1.0, 2.0, 6.0, -0.1, -2.0]))[:, 3]
    assert alpha[0] == 0.0
    assert 0.0 < alpha[1] < alpha[2] < alpha[3] == alpha[4] == 1.0
    assert (alpha[5], alpha[6]) == (alpha[1], alpha[3])
    warm, cold = carpets.tint(np.array([2.0, -2.0]))[:, :3]
    assert warm[0] > warm[2]  # red
    assert cold[2] > cold[0]  # blue


def test_timeline__has_setpoints_and_their_sources() -> None:
    curves = office_comparison().curves
    figure = actuators.timeline(curves)
    assert set(figure.data["rbc: Cooling setpoints, mean (°C)"]) == {24.0}
    assert {name: share.mean() for name, share in actuators.source_shares(curves[1]).items()} == {"rbc": 1.0}
    assert {name: share.mean() for name, share in actuators.source_shares(curves[0]).items()} == {"": 1.0}


@pytest.mark.parametrize("days", [1, 30])
def test_timeline__has_actuators_whose_values_are_known_only_while_they_are_commanded(days: int) -> None:
    steps = 96 * days
    alike = [actuator(name, 0.0, 1.0) for name in ("fan", "valve", "pump")]
    kinds = tuple(each.model_copy(update={"control_type": each.name}) for each in alike)
    of = office(steps=steps).model_copy(update={"actuators": kinds})
    part = run("rbc", of, [10.0] * steps, [[24.0] * steps] * 2, [[0.0] * steps] * 2).trajectory
    part.effective[:, 0] = 0.5
    part.effective[1 : steps // 2, 0] = np.nan
    part.effective[:, 1] = np.nan
    never = replace(part, effective=np.full_like(part.effective, np.nan))
    figure = actuators.timeline([Curve("rbc", 0, Quantities(part)), Curve("baseline", 1, Quantities(never))])
    fan = np.array(figure.data["rbc: Fan (°C)"])
    assert np.isnan(fan[: steps // 2 - 1]).all()
    assert set(fan[steps // 2 - 1 :]) == {0.5}
    assert set(figure.data) == {"begin", "rbc: Fan (°C)", "rbc: Pump (°C)"}
    assert "Left out where no value is known: Fan, Valve, Pump." in figure.caption
    assert "Left out" not in actuators.timeline(office_comparison().curves).caption


def test_timeline__range_is_that_of_the_known_values() -> None:
    of = office(("a", "b", "c"), steps=2)
    part = run("rbc", of, [10.0] * 2, [[24.0] * 2] * 3, [[0.0] * 2] * 3).trajectory
    part.effective[1:] = [[20.0, 24.0, np.nan], [np.nan, np.nan, np.nan]]
    data = actuators.timeline([Curve("rbc", 0, Quantities(part))]).data
    values = [data[f"rbc: Cooling setpoints, {kind} (°C)"] for kind in ("lowest", "mean", "highest")]
    np.testing.assert_array_equal(np.transpose(values), [[20.0, 22.0, 24.0], [np.nan] * 3])


def test_report__rewards_add_up() -> None:
    comparison = office_comparison()
    figure = reward.reward(comparison.curves)
    assert figure.data["rbc: reward"][-1] == pytest.approx(comparison.runs[1].results[0].reward)
    assert figure.data["rbc: comfort"][-1] == pytest.approx(-96.0)


def test_report__term_named_reward_is_not_the_total() -> None:
    terms = {"reward": -1.0, "penalty": -2.0}
    of = run("rbc", office(("core",), steps=4), [10.0] * 4, [[24.0] * 4], [[0.0] * 4], terms=terms)
    figure = reward.reward([Curve("rbc", 0, of.quantities)])
    assert figure.data["rbc: reward"] == [-3.0, -6.0, -9.0, -12.0]
    assert figure.data["rbc: reward term"] == [-1.0, -2.0, -3.0, -4.0]
    assert "rbc -12.0" in figure.alt


def test_report__legends_show_names_that_begin_with_an_underscore() -> None:
    names = ("_baseline", "_mine")
    comparison = office_comparison(names)
    figures = [figure for section in sections(comparison) for figure in section.figures if figure.name != "weather"]
    for figure in figures:
        drawing = figure.drawing
        legends = [*drawing.legends, *(axis.get_legend() for axis in drawing.axes)]
        texts = [text.get_text() for legend in legends if legend is not None for text in legend.get_texts()]
        if figure.name in ("load-duration", "actuators", "energy-by-day", "degree-hours", "reward"):
            assert all(any(name in text for text in texts) for name in names), figure.name
    (duration,) = (figure for figure in figures if figure.name == "load-duration")
    assert '"label":"_mine"' in readings(duration.drawing)


@pytest.mark.filterwarnings("error")
def test_report__run_without_power_is_drawn_without_a_warning() -> None:
    of = office(("core",), steps=4)
    zero = run("rbc", of, [0.0] * 4, [[24.0] * 4], [[0.0] * 4])
    figure = energy.duration([Curve("rbc", 0, zero.quantities)])
    figure.drawing.draw_without_rendering()
    unknown = run("rbc", of, [np.nan] * 4, [[24.0] * 4], [[0.0] * 4])
    assert energy.duration([Curve("rbc", 0, unknown.quantities)]) is None


def test_report__episodes_with_the_same_weather_are_drawn_once() -> None:
    of = office_comparison().runs[0]
    same = of.weathers[0]
    assert same is not None
    figure = weather.weather([("episode 1", same), ("episode 2", same)], MIDNIGHT)
    assert figure is not None
    assert [name for name in figure.data if "temperature" in name] == [
        "episode 1, episode 2: outdoor temperature (degC)"
    ]
    assert figure.caption.startswith("Of the whole run period")


@pytest.mark.parametrize("names", [("USA_NY_New.York-J.F.Kennedy.Intl.AP",), tuple("ab"), ("x" * 90,)])
def test_weather__axes_keep_their_width_with_many_stochastic_episodes(names: tuple[str, ...]) -> None:
    traces = [EpisodeWeather(3600.0, np.linspace(k, 20.0 + k, 48), np.linspace(0.0, 900.0, 48)) for k in range(6)]
    labels = [f"episode {place + 1}, {names[place % len(names)]}" for place in range(6)]
    figure = weather.weather(list(zip(labels, traces, strict=True)), MIDNIGHT)
    figure.drawing.draw_without_rendering()
    width, height = figure.drawing.get_size_inches() * figure.drawing.dpi
    above, below = (axis.get_window_extent() for axis in figure.drawing.axes)
    assert min(above.width, below.width) > 0.85 * width
    assert min(above.height, below.height) > 0.2 * height
    legend = figure.drawing.axes[0].get_legend().get_window_extent()
    title = figure.drawing.axes[0].title
    assert legend.x1 <= width
    assert not legend.overlaps(
        next(text for text in (title, figure.drawing.axes[0]._left_title) if text.get_text()).get_window_extent()
    )


def test_report__without_points_there_are_no_figures() -> None:
    of = office(("core",), steps=4).model_copy(update={"sensors": (), "meters": (), "actuators": ()})
    nothing = run("rbc", office(("core",), steps=4), [1.0] * 4, [[24.0] * 4], [[0.0] * 4])
    trajectory = nothing.trajectory
    empty = replace(
        trajectory, manifest=of, values=trajectory.values[:, :0], fault_free_values=trajectory.values[:, :0],
        effective=trajectory.effective[:, :0], sources=("",), terms={},
    )  # fmt: skip
    curves = [Curve("rbc", 0, type(nothing.quantities)(empty))]
    assert energy.end_uses(curves) is energy.duration(curves) is energy.periods(curves) is None
    assert carpets.electricity(curves) is comfort.degree_hours(curves) is actuators.timeline(curves) is None
    assert reward.reward(curves) is None


def test_report__joules_of_the_made_up_office_are_its_power() -> None:
    part = run("rbc", office(("core",), steps=4), [10.0] * 4, [[24.0] * 4], [[0.0] * 4])
    assert part.results[0].energy_kwh["electricity"] == pytest.approx(10.0)
    assert part.trajectory.values[1, 2] == pytest.approx(2.5 * J_PER_KWH)
