"""Totals, differences and the result in words."""

import re
from dataclasses import replace

import pytest
from support.trajectories import office, office_comparison, run

from zenostat.metrics.episode_metrics import EpisodeMetrics
from zenostat.views.report import Comparison, Run
from zenostat.views.report.page import page
from zenostat.views.report.runs import short_names
from zenostat.views.report.summary import summary
from zenostat.views.report.totals import Metric, difference, metrics, number, signed
from zenostat.views.report.totals_section import NONE, totals_section

ELECTRICITY = Metric("electricity_kwh", "Electricity", "kWh")
REWARD = Metric("reward", "Reward", "", 1)


def texts_of(comparison: Comparison) -> list[str]:
    """The result with plain spaces."""
    return [text.replace("\N{NO-BREAK SPACE}", " ") for text in summary(comparison)]


def with_electricity(of: Run, *amounts: float) -> Run:
    """The run with one episode for each amount of electricity."""
    results = tuple(replace(of.results[0], energy_kwh={"electricity": amount}) for amount in amounts)
    return replace(of, results=results, seeds=tuple(range(len(amounts))), weathers=of.weathers * len(amounts))


def changed(of: Run, **values: object) -> Run:
    metric: EpisodeMetrics = replace(of.results[0], **values)  # type: ignore[arg-type]
    return replace(of, results=(metric,))


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return office_comparison()


def test_report__difference_of_one_episode(comparison: Comparison) -> None:
    reference, other = comparison.runs
    change = difference(with_electricity(other, 90.0), with_electricity(reference, 100.0), ELECTRICITY)
    assert (change.mean, change.percent, change.half_width, change.verdict) == (-10.0, -10.0, None, "better")


def test_report__higher_reward_is_better_and_its_percent_has_the_sign_of_the_difference(comparison: Comparison) -> None:
    reference, other = comparison.runs
    change = difference(changed(other, reward=-50.0), changed(reference, reward=-100.0), REWARD)
    assert (change.mean, change.percent, change.verdict) == (50.0, 50.0, "better")


def test_report__differences_are_those_of_the_same_episodes(comparison: Comparison) -> None:
    # The episodes differ by far more than the controllers, but each time by the same 10 kWh.
    reference, other = comparison.runs
    change = difference(with_electricity(other, 90, 490, 890), with_electricity(reference, 100, 500, 900), ELECTRICITY)
    assert change.mean == -10.0
    assert change.half_width == pytest.approx(0.0)
    assert change.verdict == "better"


def test_report__interval_that_contains_zero_is_unclear(comparison: Comparison) -> None:
    pytest.importorskip("scipy")
    reference, other = comparison.runs
    change = difference(with_electricity(other, 90, 520, 880), with_electricity(reference, 100, 500, 900), ELECTRICITY)
    # Differences -10, 20, -20: mean -3.33, deviation 20.8, Student's t for two degrees of freedom 4.303.
    assert change.half_width == pytest.approx(4.3027 * 20.8167 / 3**0.5, rel=1e-4)
    assert change.verdict == "unclear"


@pytest.mark.parametrize(
    ("other", "text"),
    [
        ({"weather_names": ("Miami",) * 3}, "have different weather (Miami; Denver)"),
        ({"seeds": (7, 8, None)}, "have different seeds (7, 8, ?; 0, 1, 2)"),
    ],
)
def test_report__episodes_of_other_weather_or_seeds_are_not_paired(
    other: dict[str, object], text: str, comparison: Comparison
) -> None:
    reference, controlled = (replace(of, weather_names=("Denver",) * 3) for of in comparison.runs)
    reference, controlled = with_electricity(reference, 100, 500, 900), with_electricity(controlled, 90, 490, 890)
    controlled = replace(controlled, **other)  # type: ignore[arg-type]
    change = difference(controlled, reference, ELECTRICITY)
    assert (change.mean, change.half_width, change.verdict) == (-10.0, None, "")
    result = " ".join(texts_of(Comparison((reference, controlled))))
    assert f"The episodes of rbc and baseline {text}, which a difference between them contains." in result


def test_report__reference_of_zero_has_no_percent(comparison: Comparison) -> None:
    reference, other = comparison.runs
    change = difference(with_electricity(other, 5.0), with_electricity(reference, 0.0), ELECTRICITY)
    assert (change.percent, change.verdict) == (None, "worse")


def test_report__quantities_that_nobody_measures_have_no_row(comparison: Comparison) -> None:
    keys = [metric.key for metric in metrics(comparison)]
    assert keys[:4] == ["electricity_kwh", "hvac_electricity_kwh", "site_kwh_m2", "peak_kw"]
    assert "natural_gas_kwh" not in keys
    assert "late" not in keys
    assert keys[-3:] == ["reward", "reward.energy", "reward.comfort"]


def test_report__result_names_savings_and_the_zone_that_pays_for_them(comparison: Comparison) -> None:
    (text,) = texts_of(comparison)
    # 10 kW by day, 30 kW for ten hours: 440 kWh; the second controller uses a tenth less.
    assert text.startswith(
        "rbc used 10.0 % less electricity than baseline (396 instead of 440 kWh), with a peak 10.0 % lower"
    )
    assert "However, occupied zones were outside the comfort band by 20 K h" in text
    assert "the worst zone is South (20 K h too warm)" in text


def with_gas(of: Run, kwh: float) -> Run:
    return changed(of, energy_kwh={**of.results[0].energy_kwh, "natural_gas": kwh})


def test_report__result_names_fuels_that_count_besides_electricity(comparison: Comparison) -> None:
    reference, other = comparison.runs
    (text,) = texts_of(Comparison((with_gas(reference, 200.0), with_gas(other, 300.0))))
    assert "rbc used 10.0 % less electricity than baseline" in text
    assert "rbc used 50.0 % more natural gas than baseline (300 instead of 200 kWh)." in text
    assert "However" not in text  # less comfort, of one energy more and of another less
    (text,) = texts_of(Comparison((with_gas(reference, 300.0), with_gas(other, 200.0))))
    assert "However, occupied zones were outside the comfort band" in text
    (text,) = texts_of(Comparison((with_gas(reference, 0.3), with_gas(other, 0.2))))
    assert "gas" not in text
    (text,) = texts_of(Comparison((with_gas(other, 200.0),)))
    assert text.startswith("rbc used 396 kWh of electricity, with a peak of 27 kW, and 200 kWh of natural gas.")


def test_report__result_states_that_nothing_differs(comparison: Comparison) -> None:
    (text,) = texts_of(Comparison((comparison.runs[0], replace(comparison.runs[0], name="same"))))
    assert "same used as much electricity as baseline (440 kWh)" in text
    assert "Occupied zones were within the comfort band at all times, as under baseline." in text


@pytest.mark.parametrize(
    ("outside", "words"),
    [
        (998.0, "0.2 % less than under baseline"),
        (1000.6, "0.1 % more than under baseline"),
        (1000.4, "as much as under baseline"),
        (600.0, "40.0 % less than under baseline"),
    ],
)
def test_report__result_never_states_zero_percent_less(comparison: Comparison, outside: float, words: str) -> None:
    reference, other = comparison.runs
    metrics_of_both = (changed(reference, occupied_outside_kh=1000.0), changed(other, occupied_outside_kh=outside))
    (text,) = texts_of(Comparison(metrics_of_both))
    assert words in text
    assert " 0 %" not in text


@pytest.mark.parametrize(
    ("names", "short"),
    [
        (["baseline", "rbc"], ["baseline", "rbc"]),
        (["baseline", "experiments/mine.py:Mine"], ["baseline", "Mine"]),
        (["ppo:runs/1/model.zip", "ppo:runs/2/model.zip"], ["model.zip 1", "model.zip 2"]),
        (["baseline", "a/x.py:C", "rbc", "b/x.py:C"], ["baseline", "C 1", "rbc", "C 2"]),
        (["package.module:" + "Long" * 9], ["LongLongLongLongLongLongLon\N{HORIZONTAL ELLIPSIS}"]),
    ],
)
def test_report__long_names_are_shortened_and_stay_distinct(names: list[str], short: list[str]) -> None:
    assert short_names(names) == short


def test_report__result_of_one_controller_alone(comparison: Comparison) -> None:
    (text,) = texts_of(Comparison(comparison.runs[1:]))
    assert text.startswith("rbc used 396 kWh of electricity, with a peak of 27 kW.")
    assert "outside the comfort band by 20 K h" in text


def test_report__result_names_episodes_that_ended_early_and_commands_that_were_not_accepted(
    comparison: Comparison,
) -> None:
    reference, other = comparison.runs
    texts = texts_of(Comparison((reference, changed(other, terminated=True, steps=40, late=2, rejected=1))))
    assert any("ended 1 of 1 episodes early, after 40 of 96 timesteps" in text for text in texts)
    assert any("did not accept 3 messages of rbc" in text for text in texts)


def test_report__result_of_several_episodes_is_reported_and_what_is_not_clear(comparison: Comparison) -> None:
    pytest.importorskip("scipy")
    reference, other = comparison.runs
    pair = (with_electricity(reference, 100, 500, 900), with_electricity(other, 90, 520, 880))
    texts = texts_of(Comparison(pair))
    assert "rbc and baseline do not differ clearly in electricity" in texts[0]
    assert texts[-1] == "Numbers are means over 3 episodes."


@pytest.mark.parametrize(
    ("value", "text"),
    [(7695.94, "7,696"), (134.59, "134.6"), (8.351, "8.35"), (0.0667, "0.0667"),
        (0.5432, "0.543"), (0.0, "0"), (-0.00001, "\N{ALMOST EQUAL TO}\N{NO-BREAK SPACE}0"),
     (-383.26, "\N{MINUS SIGN}383.3"), (12.0, "12")],
)  # fmt: skip
def test_report__numbers_have_about_four_digits(value: float, text: str) -> None:
    assert number(value) == text


@pytest.mark.parametrize(("value", "text"), [(5.25, "+5.25"), (-5.25, "\N{MINUS SIGN}5.25"), (0.0, "0")])
def test_report__differences_have_a_sign(value: float, text: str) -> None:
    assert signed(value) == text


def test_report__episodes_of_different_length_are_not_rated(comparison: Comparison) -> None:
    reference, other = comparison.runs
    shorter = changed(other, steps=40, terminated=True)
    change = difference(shorter, reference, ELECTRICITY)
    assert change.verdict == ""
    pair = Comparison((reference, shorter))
    assert texts_of(pair)[0] == "The totals of rbc and baseline do not compare: their episodes differ in length."
    assert "steps" in [metric.key for metric in metrics(pair)]
    assert "steps" not in [metric.key for metric in metrics(comparison)]


def test_report__percents_of_nearly_nothing_are_left_out(comparison: Comparison) -> None:
    reference, other = comparison.runs
    change = difference(with_electricity(other, 5.0), with_electricity(reference, 1e-9), ELECTRICITY)
    assert (change.percent, change.verdict) == (None, "worse")
    (text,) = texts_of(Comparison((with_electricity(reference, 1e-9), with_electricity(other, 5.0))))
    assert text.startswith("rbc used more electricity than baseline (5 instead of")


def test_totals_section__several_controllers_have_a_column_each() -> None:
    """Their differences stand below the numbers, so that the table of four fits a page."""
    first, second = office_comparison().runs
    runs = (first, *(replace(second, name=name, short_name="") for name in ("rbc", "ppo", "sac")))
    html = totals_section(Comparison(runs))
    head = html[html.index("<thead>") : html.index("</thead>")]
    assert head.count("<th ") == 5
    (row,) = re.findall(r'<tr data-metric="electricity_kwh">.*?</tr>', html)
    assert row.count("<td") == 4
    assert row.count("\N{MINUS SIGN}10.0 %") == 3
    assert "Below each number: its difference to baseline." in html
    pair = totals_section(office_comparison())
    assert "Below each number" not in pair
    assert "rbc \N{MINUS SIGN} baseline" in pair


def test_report__total_without_all_values_is_not_known() -> None:
    of, nan = office(("core",), steps=4), float("nan")
    mild = [[24.0] * 4], [[0.0] * 4]
    whole, part = run("baseline", of, [10.0] * 4, *mild), run("rbc", of, [10.0, nan, 10.0, 10.0], *mild)
    for runs in ((part,), (whole, part), (part, whole)):
        comparison = Comparison(runs)
        assert "rbc lacks values of 1 of 4 timesteps; totals that need them are not known." in summary(comparison)
        (row,) = re.findall(r'<tr data-metric="electricity_kwh">(.*?)</tr>', totals_section(comparison))
        cells = re.findall(r'<td class="n">(.*?)</td>', row)
        assert cells[: len(runs)] == ["10" if run_ is whole else NONE for run_ in runs]
        assert "nan" not in page(comparison)


def test_report__result_names_lost_samples(comparison: Comparison) -> None:
    reference, other = comparison.runs
    texts = texts_of(Comparison((reference, changed(other, lost=7))))
    assert "7 samples of rbc were lost; its totals lack their timesteps." in texts


def test_report__reference_is_only_within_the_band_if_it_is(comparison: Comparison) -> None:
    reference, other = comparison.runs
    for before, words in ((0.05, "20 K h (under baseline by 0.0500 K h)"), (0.0, "under baseline they were within it")):
        runs = changed(reference, occupied_outside_kh=before), changed(other, occupied_outside_kh=20.0)
        (text,) = texts_of(Comparison(runs))
        assert words in text
        assert ("they were within it" in text) == (before == 0.0)
