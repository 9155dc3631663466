"""The benchmark: scores by hand, results that are read back, episodes that are run again."""

import dataclasses
import json
import math
import multiprocessing
import threading
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from support import benchmark_page
from typer.testing import CliRunner

from zenostat.cli.commands import app
from zenostat.lab.benchmark import (
    SETS,
    Results,
    Row,
    Selection,
    check,
    definition,
    interquartile_mean,
    load_results,
    prepared,
    relative_score,
    rerun,
    run_benchmark,
    score_rows,
)
from zenostat.lab.benchmark.episodes import Job
from zenostat.lab.benchmark.page import write_page
from zenostat.lab.benchmark.results_file import rows_digest
from zenostat.lab.benchmark.run import stale_trainings
from zenostat.lab.benchmark.scores import bootstrap_interval, relative_linear
from zenostat.lab.benchmark.tables import tables
from zenostat.lab.workers import worker_pool
from zenostat.models.catalog import find_building, find_weather
from zenostat.topics.errors import InvalidConfig, UnknownName, UsageError
from zenostat.topics.file_lock import locked

OFFICE, WAREHOUSE = SETS["smoke"].buildings
TRAINING = {"configuration": "00"}


def row(
    controller: str, building: str = OFFICE, seed: int = 1, reward: float = -10.0, linear: float = -5.0,
    training_seed: int | None = None,
) -> Row:  # fmt: skip
    metrics = {"occupied_outside_kh": 1.5}
    terms = {"cost": reward + 3.0, "gas": 0.0, "peak": -2.0, "comfort": -1.0}
    return Row(controller, building, "summer", "USA_IL_Chicago", seed, reward, terms, linear, metrics, training_seed)


# Scores


def test_benchmark__score_is_the_share_of_the_baseline_that_is_saved() -> None:
    assert relative_score(-10.0, -10.0) == 0.0
    assert relative_score(-7.5, -10.0) == 0.25
    assert relative_score(-15.0, -10.0) == -0.5
    assert relative_score(0.0, -10.0) == 1.0
    assert relative_score(2.0, 1.0) == 1.0  # a negative price: the larger reward is still the better one
    assert relative_score(-1.0, 0.0) is None


def test_benchmark__interquartile_mean_ignores_the_outer_quarters() -> None:
    assert interquartile_mean([8.0, 1e6, 3.0, 4.0, 5.0, 6.0, 2.0, -1e6]) == pytest.approx((3 + 4 + 5 + 6) / 4)
    assert interquartile_mean([1.0, 2.0, 6.0]) == 3.0  # a quarter of three, rounded down, is none


def width(*strata: NDArray[np.float64]) -> float:
    interval = bootstrap_interval(strata)
    return interval.high - interval.low


def test_benchmark__bootstrap_resamples_within_strata() -> None:
    """With no variance within the strata there is none in the result, however much the strata differ."""
    same = bootstrap_interval([np.zeros((1, 3, 3)), np.ones((1, 3, 3))])
    assert dataclasses.astuple(same) == (0.5, 0.5, 0.5, 18)
    differing = np.arange(9.0).reshape(1, 3, 3)
    mixed = bootstrap_interval([differing, differing])
    assert mixed.low < mixed.value == 4.0 < mixed.high
    assert mixed == bootstrap_interval([differing, differing])


def test_benchmark__interval_of_normal_weather_is_that_of_theory() -> None:
    """The mean of the middle half of n normal values has a variance of about 1.2/n (Stigler 1973).

    With three seeds that do not matter, Student's t has two degrees of freedom, and its quantile is 4.303.
    """
    weathers = np.random.default_rng(5).normal(size=(1, 200, 1)).repeat(3, axis=2)
    assert width(weathers) == pytest.approx(2 * 4.303 * np.sqrt(3 / 2) * np.sqrt(1.2 / 200), rel=0.15)


def test_benchmark__interval_contains_the_variance_between_trainings() -> None:
    """125 rows of five trainings are not 125 independent ones."""
    random = np.random.default_rng(1)
    scores = random.normal(size=(5, 1, 1)) + 0.01 * random.normal(size=(1, 5, 5))
    assert bootstrap_interval([scores]).rows == 125
    assert width(scores) > 10.0 * width(scores.mean(axis=0, keepdims=True))


def test_benchmark__interval_contains_what_weather_and_seeds_do_in_all_strata() -> None:
    """Another stratum with the same weather is no further evidence on other weather."""
    random = np.random.default_rng(2)
    for shape in ((1, 5, 1), (1, 1, 5)):
        common = random.normal(size=shape) * np.ones((1, 5, 5))
        assert width(common, common, common) == pytest.approx(width(common))
        others = [random.normal(size=(1, 5, 5)) for _ in range(3)]
        assert width(*others) < width(common)


@pytest.mark.slow
@pytest.mark.parametrize(("strata", "trainings"), [(3, 1), (3, 5), (15, 5)])
def test_benchmark__intervals_contain_the_true_mean_at_least_as_often_as_they_say(
    strata: int, trainings: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With crossed effects of weather and seeds, half of their variance common to all strata."""
    monkeypatch.setattr("zenostat.lab.benchmark.scores.RESAMPLES", 500)
    random = np.random.default_rng(strata + trainings)
    means = random.normal(size=(strata, 1, 1, 1))

    def drawn(trainings: int, weathers: int, seeds: int) -> NDArray[np.float64]:
        parts = (
            (0.35, (1, 1, weathers, 1)), (0.35, (strata, 1, weathers, 1)), (0.1, (1, 1, 1, seeds)),
            (0.1, (strata, 1, 1, seeds)), (0.1, (strata, 1, weathers, seeds)), (0.1, (strata, trainings, 1, 1)),
        )  # fmt: skip
        whole = sum((variance**0.5 * random.normal(size=shape) for variance, shape in parts), means)
        return np.asarray(np.broadcast_to(whole, (strata, trainings, weathers, seeds)))

    truth = np.mean([interquartile_mean(drawn(6, 200, 40).ravel()) for _ in range(8)])
    intervals = [bootstrap_interval(list(drawn(trainings, 5, 5))) for _ in range(150)]
    assert np.mean([interval.low <= truth <= interval.high for interval in intervals]) >= 0.94


def test_benchmark__few_or_missing_episodes_have_no_interval() -> None:
    whole = np.arange(9.0).reshape(1, 3, 3)
    assert bootstrap_interval([whole]).low < bootstrap_interval([whole]).high
    for few in (whole[:, :2], whole[:, :, :2], whole[:, :1, :1]):
        interval = bootstrap_interval([few])
        assert np.isnan(interval.low)
        assert interval.value == interquartile_mean(few.ravel())
    missing = whole.copy()
    missing[0, 1, 1] = np.nan
    interval = bootstrap_interval([missing])
    assert (np.isnan(interval.high), interval.rows) == (True, 8)


def test_benchmark__trainings_of_an_episode_are_scored_together() -> None:
    rows = [row("baseline", seed=seed) for seed in (1, 2)]
    rows += [
        row("ppo", seed=seed, reward=-9.0 + training, training_seed=training) for seed in (1, 2) for training in (0, 1)
    ]
    scores = score_rows(rows)[0]
    assert (scores.controller, scores.overall.rows) == ("ppo", 4)
    assert scores.strata[(OFFICE, "summer")] == pytest.approx(np.array([[[0.1, 0.1]], [[0.2, 0.2]]]))
    assert score_rows(rows[:-1])[0].overall.rows == 2  # the second episode lacks a training


def test_benchmark__strata_with_fewer_trainings_are_left_out_and_named() -> None:
    """Pooled, the warehouse would count five times as much as the office."""
    results = Results("smoke")
    for building, reward, trainings in ((OFFICE, -9.5, 1), (WAREHOUSE, -8.0, 5)):
        results.add([row("baseline", building)])
        results.add([row("ppo", building, reward=reward, training_seed=number) for number in range(trainings)])
    ppo = score_rows(results.rows.values())[0]
    assert (list(ppo.buildings), ppo.overall.value, ppo.overall.rows) == ([WAREHOUSE], pytest.approx(0.2), 5)
    lacking = f"over 1 episodes; 1 more lack rows, such as ppo/{OFFICE}/summer/USA_IL_Chicago/1/1"
    assert tables(results)[0].title.endswith(lacking)
    results.add([row("ppo", OFFICE, reward=-9.5, training_seed=number) for number in range(1, 5)])
    assert score_rows(results.rows.values())[0].overall.value == pytest.approx((0.05 + 0.2) / 2)
    assert "lack" not in tables(results)[0].title


def test_benchmark__only_episodes_of_all_controllers_are_compared() -> None:
    rows = [row("baseline"), row("baseline", seed=2), row("rbc", reward=-8.0), row("fixed", reward=-12.0)]
    rows += [row("fixed", seed=2, reward=-1.0)]
    scores = score_rows(rows)
    assert [(of.controller, of.overall.value, of.overall.rows) for of in scores] == [
        ("rbc", pytest.approx(0.2), 1), ("baseline", 0.0, 1), ("fixed", pytest.approx(-0.2), 1),
    ]  # fmt: skip
    assert score_rows(rows, relative_linear)[0].overall.value == 0.0


def test_benchmark__scores_need_the_baseline_control_and_common_episodes() -> None:
    with pytest.raises(InvalidConfig, match="run the controller 'baseline' too"):
        score_rows([row("rbc")])
    with pytest.raises(InvalidConfig, match="no episode has rows of all controllers"):
        score_rows([row("baseline"), row("rbc", seed=2)])
    with pytest.raises(InvalidConfig, match=rf"run the rest, such as ppo/{OFFICE}/summer/USA_IL_Chicago/1/1, or"):
        score_rows(
            [row("baseline"), row("baseline", seed=2), row("ppo", training_seed=0), row("ppo", seed=2, training_seed=1)]
        )
    with pytest.raises(InvalidConfig, match="reward of 0 in every episode"):
        score_rows([row("baseline", reward=0.0)])


def test_benchmark__processor_time_has_no_sum_where_no_time_is_known() -> None:
    """Two episodes of 1,800 s each, and trainings of 3,600 s and of an unknown time, for which the mean counts."""
    names = ["baseline", "ppo", "tuned"]
    results = Results("smoke")
    results.add([dataclasses.replace(row(name, seed=seed), processor_s=1800.0) for name in names for seed in (1, 2)])
    results.add([dataclasses.replace(row("rbc", seed=seed), processor_s=None) for seed in (1, 2)])
    times = {"ppo/a/summer/0": 3600.0, "ppo/a/summer/1": None, "tuned/a/summer": None}
    results.trainings = {name: {**TRAINING, "processor_s": of} for name, of in times.items()}
    lines = {line[0]: line[1:] for line in tables(results)[3].rows}
    assert lines == {
        "baseline": ("1800.0", "", "", "1.0"),
        "ppo": ("1800.0", "2", "3600.0", "3.0"),
        "tuned": ("1800.0", "1", "", ""),
        "rbc": ("", "", "", ""),
    }


# The definition


def test_benchmark__what_is_scored_was_not_trained_on() -> None:
    assert not set(definition.TRAINING_WEATHERS) & set(definition.HELD_OUT_WEATHERS)
    for benchmark_set in SETS.values():
        assert set(benchmark_set.weathers) <= set(definition.HELD_OUT_WEATHERS)
        lowest = min(benchmark_set.seeds)
        for algorithm, number in product(benchmark_set.training_steps, benchmark_set.training_seeds):
            training = benchmark_set.training(algorithm, OFFICE, "summer", number)
            assert training["arguments"]["weather"] == list(definition.TRAINING_WEATHERS)
            assert training["seed"] + training.get("slots", 1) < lowest
        tuning = benchmark_set.tuning_arguments(OFFICE, "summer")
        assert tuning["weathers"] == list(definition.TRAINING_WEATHERS)
        assert max(tuning["seeds"]) < lowest


def test_benchmark__trainings_share_no_seed() -> None:
    """The slots of a training have its seed, one more, and so on."""
    full = SETS["full"]
    for algorithm in full.training_steps:
        fields = [full.training(algorithm, OFFICE, "summer", number) for number in full.training_seeds]
        seeds = [seed for of in fields for seed in range(of["seed"], of["seed"] + of.get("slots", 1))]
        assert len(set(seeds)) == len(seeds)


def test_benchmark__all_names_exist() -> None:
    assert len(definition.BUILDINGS) == 5
    assert {find_building(name).name for name in definition.BUILDINGS} == set(definition.BUILDINGS)
    weathers = {*definition.TRAINING_WEATHERS, *definition.HELD_OUT_WEATHERS}
    assert {find_weather(name).name for name in weathers} == weathers


@pytest.mark.slow
def test_benchmark__trainings_of_all_sets_are_valid() -> None:
    from zenostat.lab.training import read_training
    from zenostat.lab.training.run import check_training

    for benchmark_set in SETS.values():
        for algorithm in benchmark_set.training_steps:
            for building in benchmark_set.buildings:
                for season in benchmark_set.seasons:
                    fields = benchmark_set.training(algorithm, building, season, 0)
                    check_training(read_training({**fields, "output": "nowhere/at-all"}))


# Files


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    results = Results("smoke", hashes={OFFICE: "ab"})
    for building in (OFFICE, WAREHOUSE):
        for seed in (1, 2):
            results.add([row("baseline", building, seed), row("rbc", building, seed, -9.0 + seed / 7)])
    results.save(tmp_path / "results.json")
    return tmp_path / "results.json"


def test_benchmark__results_are_read_back(saved: Path) -> None:
    text, results = saved.read_text(), load_results(saved)
    results.save(saved)
    assert saved.read_text() == text
    assert results.rows[("rbc", OFFICE, "summer", "USA_IL_Chicago", 2, -1)].reward == -9.0 + 2 / 7


def test_benchmark__order_of_runs_does_not_matter(saved: Path, tmp_path: Path) -> None:
    results = load_results(saved)
    again = Results("smoke", hashes={OFFICE: "ab"})
    again.add(reversed(list(results.rows.values())))
    again.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_text() == saved.read_text()


def test_benchmark__edited_or_foreign_results_are_refused(saved: Path, tmp_path: Path) -> None:
    content = json.loads(saved.read_text())
    bare = {**content["rows"][0], "metrics": {}}
    for change, text in (
        ({"rows": [*content["rows"][:-1]]}, "their hash differs"),
        ({"version": 99}, "results of version 99 of the benchmark; this is version 2"),
        ({"definition": "00"}, "another definition of the set 'smoke'"),
        ({"rows": [{**content["rows"][0], "reward": "much"}]}, "does not have the form of results: rows.0.reward"),
        ({"extra": 1}, "does not have the form of results: extra"),
        ({"trainings": {"foo": TRAINING}}, r"'foo' is no training or tuning of the set 'smoke'"),
        ({"trainings": {"ppo/nobuilding/summer/0": TRAINING}}, "'ppo/nobuilding/summer/0' is no training"),
        ({"trainings": {f"ppo/{OFFICE}/summer/first": TRAINING}}, "summer/first' is no training"),
        ({"trainings": {f"ppo/{OFFICE}/summer": TRAINING}}, "summer' is no training"),
        ({"trainings": {f"tuned/{OFFICE}/summer/0": TRAINING}}, "summer/0' is no training"),
        ({"rows": [bare], "rows_hash": rows_digest([bare])}, "baseline/.* has no metric occupied_outside_kh"),
        ({"format": "else"}, "a file that `zenostat benchmark` wrote expected"),
    ):
        saved.write_text(json.dumps(content | change))
        with pytest.raises(InvalidConfig, match=text):
            load_results(saved)
    for text in ("{", "[" * 200_000):
        saved.write_text(text)
        with pytest.raises(InvalidConfig, match="has no results of a benchmark"):
            load_results(saved)
    with pytest.raises(UnknownName, match="there is no file"):
        load_results(tmp_path / "none.json")


def test_benchmark__rows_of_other_versions_or_files_are_not_mixed(saved: Path) -> None:
    with pytest.raises(InvalidConfig, match=f"rows of another file {OFFICE}"):
        run_benchmark("smoke", saved, ["rbc"], hashes={OFFICE: "cd"})
    with pytest.raises(InvalidConfig, match="results of the set 'smoke'"):
        run_benchmark("quick", saved, ["rbc"])
    results = load_results(saved)
    results.versions["numpy"] = "1.0"
    results.save(saved)
    with pytest.raises(InvalidConfig, match=r"other versions \(numpy 1.0, now"):
        run_benchmark("smoke", saved, ["rbc"])


def test_benchmark__unknown_names_are_refused_before_anything_starts(tmp_path: Path) -> None:
    with pytest.raises(UnknownName, match="no set 'quik'; did you mean"):
        run_benchmark("quik", tmp_path / "r.json")
    with pytest.raises(UnknownName, match="no controller 'rcb'"):
        run_benchmark("smoke", tmp_path / "r.json", ["rcb"])
    with pytest.raises(InvalidConfig, match="there is no folder"):
        run_benchmark("smoke", tmp_path / "no" / "r.json", ["rbc"])
    assert not list(tmp_path.iterdir())


def test_benchmark__results_are_written_by_one_process_at_a_time(saved: Path) -> None:
    former = saved.read_bytes()
    refusal = r"results\.json: another process is writing results there"
    with locked(saved.with_name(f".{saved.name}.lock"), "not raised"), pytest.raises(InvalidConfig, match=refusal):
        run_benchmark("smoke", saved, ["rbc"])
    assert saved.read_bytes() == former
    with pytest.raises(InvalidConfig, match="another --out for 'quick'"):
        run_benchmark("quick", saved, ["rbc"])
    assert sorted(path.name for path in saved.parent.iterdir()) == [saved.name]


@pytest.mark.slow
def test_benchmark__page_has_tables_and_figures(saved: Path, tmp_path: Path) -> None:
    results = load_results(saved)
    results.add([row("awful", building, seed, -90.0) for building in (OFFICE, WAREHOUSE) for seed in (1, 2)])
    figures = write_page(results, tmp_path / "page.md")
    text = (tmp_path / "page.md").read_text()
    for figure in figures:
        assert figure.is_file()
        assert f"({figure.parent.name}/{figure.stem}.svg)" in text
    assert tables(results)[0].markdown() in text
    assert "-8.0" in (tmp_path / "page" / "scores.svg").read_text()  # far below the axis, so as a number


def test_benchmark__command_shows_results_and_names_what_is_missing(saved: Path) -> None:
    shown = CliRunner().invoke(app, ["benchmark", "--show", str(saved)])
    assert shown.exit_code == 0
    assert "rbc" in shown.output
    missing = CliRunner().invoke(app, ["benchmark"])
    assert isinstance(missing.exception, InvalidConfig)
    assert "--out, --check, --show and --submit-check" in str(missing.exception)
    page = CliRunner().invoke(app, ["benchmark", "--show", str(saved), "--page", "x.html"])
    assert "expected a .md file" in str(page.exception)
    (saved.parent / "page.md").mkdir()
    folder = CliRunner().invoke(app, ["benchmark", "--show", str(saved), "--page", str(saved.parent / "page.md")])
    assert "page.md: expected a file, but this is a folder" in str(folder.exception)


def test_benchmark__check_runs_the_selected_rows_and_prints_its_progress_without_a_terminal(
    saved: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    episodes: list[tuple[str, str, int]] = []

    def run_again(job: Job) -> tuple[list[Row], list[str]]:
        episodes.extend((one.controller, one.task.building, one.seed) for one in job.episodes)
        rows = load_results(saved).rows
        return [rows[one.key] for one in job.episodes], []

    monkeypatch.setattr(rerun, "run_job", run_again)
    monkeypatch.setattr("zenostat.cli.benchmark.file_hashes", lambda _: {})
    options = ["--controllers", "rbc", "--building", f"{OFFICE},{WAREHOUSE}", "--season", "summer", "--seed", "1"]
    done = CliRunner().invoke(app, ["benchmark", "--check", str(saved), *options])
    assert done.exit_code == 0, done.output
    expected = [one for one in load_results(saved).sorted_rows() if (one.controller, one.seed) == ("rbc", 1)]
    assert sorted(episodes) == sorted((one.controller, one.building, one.seed) for one in expected)
    assert "episodes: 0 of 2" in done.output
    assert "episodes: 2 of 2" in done.output
    assert f"{len(expected)} rows are equal to the bit" in done.output


def test_benchmark__check_names_the_numbers_that_differ(saved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def run_again(job: Job) -> tuple[list[Row], list[str]]:
        rows = [load_results(saved).rows[one.key] for one in job.episodes]
        other = {"metrics": {"occupied_outside_kh": 2.25}, "linear": math.nextafter(rows[0].linear, 0.0)}
        return [dataclasses.replace(one, **other) for one in rows], []

    monkeypatch.setattr(rerun, "run_job", run_again)
    chosen = Selection(controller=["rbc"], building=[OFFICE], seed=[1])
    (row,) = rerun.selected_rows(load_results(saved), chosen, "")
    (before,) = row.metrics.values()
    linear = f"linear {row.linear!r}, now {math.nextafter(row.linear, 0.0)!r}"
    (difference,) = rerun.check(saved, chosen)
    assert difference.endswith(f": {linear}; occupied_outside_kh {before!r}, now 2.25")
    close = rerun.check_rows(load_results(saved), [row], cache=saved.parent, but_for_rounding=True)
    assert [one.rpartition(": ")[2] for one in close] == [f"occupied_outside_kh {before!r}, now 2.25"]


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--building", "ref-warehous"], "has no rows of the building 'ref-warehous'; did you mean 'ref-warehouse'"),
        (["--season", "winter"], "has no rows of the season 'winter'; there are: 'summer'"),
        (["--seed", "one"], "--seed one: numbers separated by commas expected"),
        (["--seed", "7", "--weather", "Paris"], "no rows of the seed 7"),
    ],
)
def test_benchmark__selection_without_rows_is_refused(saved: Path, options: list[str], text: str) -> None:
    done = CliRunner().invoke(app, ["benchmark", "--check", str(saved), *options])
    assert isinstance(done.exception, UsageError)
    assert text in str(done.exception)


@pytest.mark.parametrize(
    ("options", "texts"),
    [
        (["--show", "r", "--season", "summer"], ["--season: only with --check or --out, not with --show"]),
        (["--show", "r", "--check", "r"], ["--show: not with --check"]),
        (["--check", "r", "--out", "r"], ["--out: not with --check"]),
        (["--merge", "r", "--out", "r", "--controllers", "rbc"], ["--controllers: only with", "not with --merge"]),
        (["--merge", "r"], ["--merge: only with --out"]),
        (
            ["--check", "r", "--page", "p.md", "--bounds", "b", "--json"],
            [f"{name}: only with --show or --merge or --out, not with --check" for name in ("--page", "--bounds")],
        ),
        (["--submit-check", "r", "--page", "p.md"], ["--page: only with", "not with --submit-check"]),
        (["--submit-check", "r", "--controllers", "rbc"], ["--controllers: only with --sample or"]),
        (["--show", "r", "--json", "--bounds", "b"], ["--bounds: not with --json"]),
        (["--out", "r", "--sample", "2"], ["--sample: only with --submit-check"]),
        (["--out", "r", "--reference", "r"], ["--reference: only with --sample or --submit-check, not with --out"]),
        (["--schema", "--workers", "1"], ["--workers: only with", "not with --schema"]),
        (["--out", "r", "--controllers", ""], ["--controllers '': names separated by commas expected"]),
        (["--out", "r", "--seed", ","], ["--seed ',': names separated by commas expected"]),
    ],
)
def test_benchmark__options_without_effect_are_named(options: list[str], texts: list[str]) -> None:
    done = CliRunner().invoke(app, ["benchmark", *options])
    assert isinstance(done.exception, InvalidConfig)
    assert [text for text in texts if text not in str(done.exception)] == []


# What is published


@pytest.mark.slow
def test_benchmark__published_tables_and_figures_are_those_of_the_published_rows() -> None:
    for path, renewed in (
        (benchmark_page.PAGE, benchmark_page.page),
        (benchmark_page.PLANNING, benchmark_page.planning_page),
    ):
        text = path.read_text(encoding="utf-8")
        assert renewed(text) == text, "python tests/support/benchmark_page.py"


def test_benchmark__published_trainings_of_two_sets_have_their_times_in_both() -> None:
    full, quick = (load_results(benchmark_page.PUBLISHED[name]) for name in ("full", "quick"))
    shared = full.trainings.keys() & quick.trainings
    assert [name for name in shared if full.trainings[name]["processor_s"] is None] == []


@pytest.mark.parametrize("name", SETS)
def test_benchmark__published_rows_are_of_this_definition(name: str) -> None:
    results = benchmark_page.published(name)
    if results is None:
        pytest.skip(f"no published rows of the set {name!r} yet")
    assert stale_trainings(results) == []
    of_set = SETS[name]
    assert set(results.hashes) == {*of_set.buildings, *of_set.weathers, *definition.TRAINING_WEATHERS}
    assert results.missing(["baseline"]) == []


# Episodes


def wait_for_ever_after_the_first(item: int) -> int:
    if item:
        threading.Event().wait()
    return item


def interrupt_after_the_first() -> None:
    with worker_pool(2) as run_all:
        for _ in run_all(wait_for_ever_after_the_first, [0, 1], "episodes", None, []):
            raise KeyboardInterrupt


@pytest.mark.slow
@pytest.mark.process
def test_benchmark__workers_end_with_an_error_or_signal() -> None:
    """Without waiting for their present episodes."""
    before = multiprocessing.active_children()
    with pytest.raises(KeyboardInterrupt):
        interrupt_after_the_first()
    assert multiprocessing.active_children() == before


@pytest.fixture
def small_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SETS, "smoke", dataclasses.replace(SETS["smoke"], buildings=(OFFICE,)))


CONTROLLERS = """
class Warm:
    def __init__(self, manifest): self.names = [a.name for a in manifest.actuators]
    def act(self, sample): return {name: 21.0 if "heating" in name else 27.0 for name in self.names}
class Failing(Warm):
    def act(self, sample): return super().act(sample) if sample.step < 9 else 1 / 0
"""


@pytest.mark.slow
@pytest.mark.process
@pytest.mark.usefixtures("small_set")
def test_benchmark__episodes_are_resumed_and_run_again_to_the_bit(tmp_path: Path) -> None:
    path, stages = tmp_path / "results.json", list[str]()
    (tmp_path / "mine.py").write_text(CONTROLLERS)
    mine, failing = f"{tmp_path}/mine.py:Warm", f"{tmp_path}/mine.py:Failing"
    results, errors = run_benchmark("smoke", path, ["fixed", mine, failing, "random"])
    assert results.names() == ["baseline", "fixed", mine, "random"]
    assert len(errors) == 1
    assert errors[0].endswith(f"Failing/{OFFICE}/summer/USA_IL_Chicago/20001: ZeroDivisionError: division by zero")
    for one in results.rows.values():
        assert one.reward == pytest.approx(sum(one.terms.values()))
        assert set(one.terms) == {"cost", "gas", "peak", "comfort"}
        assert one.terms["peak"] == pytest.approx(-3.0 * one.metrics["peak_kw"])  # EUR/kW of the facility's peak
        assert one.linear < 0.0
    former = path.read_text()
    run_benchmark("smoke", path, ["fixed", mine, "random"], progress=lambda stage, *_: stages.append(stage))
    assert stages == []
    assert path.read_text() == former
    with pytest.raises(
        InvalidConfig, match="not part of the benchmark: name the controllers to run with --controllers"
    ):
        check(path)
    everything = Selection(controller=results.names())
    assert check(path, everything) == []
    alone, _ = run_benchmark("smoke", tmp_path / "alone.json", ["random"])
    assert all(one.same(results.rows[key]) for key, one in alone.rows.items())
    wrong = next(one for one in results.rows.values() if one.controller == "fixed")
    results.add([dataclasses.replace(wrong, reward=float(np.nextafter(wrong.reward, 0.0)))])
    results.save(path)
    differences = check(path, Selection(controller=["fixed", "baseline"]))
    assert [text.split(":")[0] for text in differences] == [f"fixed/{OFFICE}/summer/USA_IL_Chicago/20001"]


@pytest.mark.slow
@pytest.mark.process
@pytest.mark.timeout(1200)
@pytest.mark.usefixtures("small_set")
def test_benchmark__trained_controllers_workers_and_policies_give_the_same_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    policies, stages = tmp_path / "policies", list[str]()
    one, errors = run_benchmark(
        "smoke", tmp_path / "one.json", ["ppo", "tuned"], workers=2, policies=policies,
        progress=lambda stage, *_: stages.append(stage),
    )  # fmt: skip
    assert errors == []
    assert list(dict.fromkeys(stages)) == ["tuning", "training", "episodes"]
    assert [path.name for path in sorted(policies.iterdir())] == [
        f"ppo-{OFFICE}-summer-0.npz", f"tuned-{OFFICE}-summer.json",
    ]  # fmt: skip
    trained, tuned = one.trainings[f"ppo/{OFFICE}/summer/0"], one.trainings[f"tuned/{OFFICE}/summer"]
    assert trained["parameters"] == tuned["parameters"]
    assert trained["processor_s"] > 0.0 < tuned["processor_s"]
    assert trained["curve"].keys() == {"steps", "rewards"}
    assert trained["evaluations"]["steps"][0] == 0

    def train_again(_: object) -> None:
        raise AssertionError("the folder of policies has it")

    for name in ("_train", "_tune"):
        monkeypatch.setattr(prepared, name, train_again)
    two, errors = run_benchmark("smoke", tmp_path / "two.json", ["tuned", "ppo"], policies=policies)
    assert errors == []
    assert [a.same(b) for a, b in zip(one.sorted_rows(), two.sorted_rows(), strict=True)] == [True] * len(one.rows)
    assert check(tmp_path / "one.json", policies=policies, cache=tmp_path / "cache") == []
