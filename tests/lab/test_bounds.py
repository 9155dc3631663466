"""Bounds of the benchmark: moves and recombination by hand, a search on a toy, files, and real episodes run again."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.benchmark_page import FOLDER as PUBLISHED
from support.examples import examples
from typer.testing import CliRunner

from zenostat.cli.commands import app
from zenostat.lab.benchmark import SETS, Results, Row, Task, bound_search, load_results, run_benchmark
from zenostat.lab.benchmark.bound_file import Bound, bound_path, definition_of, load_bound, load_bounds, packed
from zenostat.lab.benchmark.bound_moves import Actions, SequenceSpace, Windows, changed, changed_plans, combine
from zenostat.lab.benchmark.bound_search import BATCH, Best, Simulated, search
from zenostat.lab.benchmark.bounds import BoundTask, check_bound, improve_bound, tasks_of
from zenostat.lab.benchmark.gap import gap_share, gap_table, tables_with_gap
from zenostat.lab.benchmark.tables import tables
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig, SimulatorError, UnknownName

DAY = 24
SPACE = SequenceSpace(np.array([15.0, 20.0]), np.array([25.0, 30.0]), 7, DAY, ((0, 1),))
START = np.tile(np.float32([20.0, 25.0]), (SPACE.timesteps, 1))
OFFICE = SETS["smoke"].buildings[0]
TASK = Task(OFFICE, "summer", "USA_IL_Chicago")
SEED = 20_001


class Toy:
    """A building of which each timestep costs the squared distance to a target, and the highest demand is charged.

    The demand is what the heating setpoint is above 15.
    """

    def __init__(self, charge: float = 0.0, fails_above: float = np.inf) -> None:
        hours = np.arange(SPACE.timesteps) % DAY
        self.target = np.where((hours >= 8) & (hours < 18), 22.0, 16.0)
        self.charge, self.fails_above = charge, fails_above
        self.batches: list[int] = []
        self.timestep, self.peak, self.timesteps = 0, 0.0, 0

    def begin(self) -> None:
        self.timestep, self.peak = 0, 0.0

    def compare(self, plans: Actions) -> Floats:
        rewards, demand = self._rewards(plans, self.timestep)
        return rewards.sum(axis=1) - self.charge * np.maximum(demand.max(axis=1) - self.peak, 0.0)

    def advance(self, actions: Actions) -> float:
        value = float(self.compare(actions[None])[0])
        self.peak = max(self.peak, float(actions[:, 0].max()) - 15.0)
        self.timestep += len(actions)
        return value

    def _rewards(self, sequences: Actions, first: int) -> tuple[Floats, Floats]:
        actions = sequences.astype(float)
        assert (actions >= SPACE.low).all()
        assert (actions <= SPACE.high).all()
        assert (actions[..., 0] <= actions[..., 1]).all()
        self.batches.append(len(actions))
        self.timesteps += actions.shape[0] * actions.shape[1]
        if actions.max() > self.fails_above:
            raise SimulatorError("it stopped")
        target = self.target[first : first + actions.shape[1]]
        return -((actions[..., 0] - target) ** 2) - (actions[..., 1] - 27.0) ** 2, actions[..., 0] - 15.0

    def simulate(self, sequences: Sequence[Actions]) -> Simulated:
        rewards, demand = self._rewards(np.stack(sequences), 0)
        returns = rewards.sum(axis=1) - self.charge * demand.max(axis=1)
        return Simulated(returns, rewards, demand, self.charge)

    def best_of(self, actions: Actions, simulations: int = 0) -> Best:
        return Best(actions, float(self.simulate([actions]).returns[0]), simulations)


# Parametrization and moves


def test_sequence_space__clips_and_parts_crossed_setpoints() -> None:
    allowed = SPACE.allowed(np.array([[24.0, 22.0], [10.0, 40.0]]))
    assert allowed.dtype == np.float32
    assert allowed.tolist() == [[23.0, 23.0], [15.0, 30.0]]


@given(phase=st.integers(0, 2 * DAY - 1), days=st.integers(1, 7))
def test_windows__cover_the_episode_and_are_a_day_apart(phase: int, days: int) -> None:
    space = dataclasses.replace(SPACE, days=days)
    windows = Windows.at(space, phase)
    assert windows.bounds[0] == 0
    assert windows.bounds[-1] == space.timesteps
    assert list(windows.bounds) == sorted(set(windows.bounds))
    for (first, end), (begin, until) in zip(itertools.pairwise(windows.bounds), windows.changing, strict=True):
        assert first <= begin <= until <= end
        assert until - begin <= DAY
        assert end == space.timesteps or until <= max(begin, end - DAY)  # what it costs shows for a day
    rewards = np.random.default_rng(phase).normal(size=(3, space.timesteps))
    assert windows.costs(rewards).sum(axis=1) == pytest.approx(-rewards.sum(axis=1))
    assert windows.peaks(rewards).max(axis=1) == pytest.approx(rewards.max(axis=1))


@settings(max_examples=examples(50))
@given(seed=st.integers(0, 10_000))
def test_changed__stays_in_windows_and_bounds(seed: int) -> None:
    random = np.random.default_rng(seed)
    windows = Windows.at(SPACE, int(random.integers(2 * DAY)))
    actions = SPACE.allowed(random.uniform(10.0, 35.0, START.shape))
    variant = changed(actions, windows, SPACE, random)
    assert (SPACE.allowed(variant) == variant).all()
    outside = np.ones(len(variant), bool)
    for first, end in windows.changing:
        outside[first:end] = False
    assert (variant[outside] == actions[outside]).all()


def test_changed_plans__begin_with_the_sequence_itself() -> None:
    plans = changed_plans(START, 30, 42, 20, SPACE, np.random.default_rng(0))
    assert plans.shape == (21, 12, 2)
    assert (plans[0] == START[30:42]).all()
    assert (SPACE.allowed(plans) == plans).all()
    assert (plans[1:] != START[30:42]).any(axis=(1, 2)).sum() > 10


@settings(max_examples=examples(100))
@given(seed=st.integers(0, 10_000), charge=st.floats(0.0, 5.0))
def test_combine__is_the_best_of_all_combinations(seed: int, charge: float) -> None:
    random = np.random.default_rng(seed)
    costs, peaks = random.normal(size=(3, 4)), random.uniform(size=(3, 4))
    parts = np.arange(4)

    def total(chosen: Sequence[int]) -> float:
        return float(costs[list(chosen), parts].sum() + charge * peaks[list(chosen), parts].max())

    chosen = combine(costs, peaks, charge)
    assert total(chosen.tolist()) == pytest.approx(min(map(total, itertools.product(range(3), repeat=4))))


def test_combine__keeps_the_first_of_equals() -> None:
    assert combine(np.zeros((3, 2)), np.zeros((3, 2)), 1.0).tolist() == [0, 0]


# The search


@pytest.mark.variants
@pytest.mark.parametrize("charge", [0.0, 28.0])
def test_search__finds_the_optimum_of_a_toy_and_counts_the_charge(charge: float) -> None:
    """Heating x below the target in the 70 hours by day costs 70 x² and saves the charge times x: x is charge / 140."""
    toy = Toy(charge)
    assert (toy.target == 22.0).sum() == 70
    optimum = np.full_like(START, 27.0)
    optimum[:, 0] = np.minimum(toy.target, 22.0 - charge / 140.0)
    start, most = toy.best_of(START), toy.best_of(optimum).value
    stages = list(search(SPACE, toy, start, simulations=480, seed=1))
    values = [start.value, *(best.value for best in stages)]
    assert values == sorted(values)
    best = stages[-1]
    assert best.simulations == 480
    assert toy.timesteps <= 483 * SPACE.timesteps
    assert toy.best_of(best.actions).value == pytest.approx(best.value)
    assert [value for _, value in best.curve] == sorted(value for _, value in best.curve)
    assert best.curve[-1][1] == best.value
    assert start.value + 0.9 * (most - start.value) < best.value <= most
    assert max(toy.batches) == BATCH


@pytest.mark.slow
def test_search__continues_as_if_it_had_not_been_interrupted() -> None:
    toy = Toy(2.0)
    whole = list(search(SPACE, toy, toy.best_of(START), simulations=440, seed=3))
    best = toy.best_of(START)
    for _ in whole:
        best = next(search(SPACE, toy, best, simulations=440, seed=3))
    assert best.actions.tobytes() == whole[-1].actions.tobytes()
    assert dataclasses.astuple(best)[1:] == dataclasses.astuple(whole[-1])[1:]
    assert best.simulations == 440
    again = list(search(SPACE, toy, toy.best_of(START), simulations=440, seed=4))
    assert again[-1].actions.tobytes() != best.actions.tobytes()


def test_search__goes_on_after_sequences_that_fail() -> None:
    toy = Toy(fails_above=28.0)
    start = toy.best_of(START)
    *_, best = search(SPACE, toy, start, simulations=400, seed=0)
    assert best.value > start.value
    assert best.actions.max() <= 28.0


# Files


def example(actions: Actions = START, **changes: object) -> Bound:
    fields = {
        "definition": definition_of("smoke", TASK), "building": OFFICE, "season": "summer",
        "weather": "USA_IL_Chicago", "seed": SEED, "relative_k": 8.0, "reward": -8.0, "terms": {"cost": -8.0},
        "linear": -1.0, "starts": {"baseline (relative)": -10.0}, "simulations": 5, "stages": 0, "search_seed": 0,
        "curve": ((5, -8.0),), **packed(actions),
    }  # fmt: skip
    return Bound(**(fields | changes))


def test_bound__is_read_back_to_the_bit(tmp_path: Path) -> None:
    actions = np.random.default_rng(0).uniform(15.0, 25.0, (672, 2)).astype(np.float32)
    bound = example(actions, reward=-1.0 / 3.0)
    path = bound.save(tmp_path)
    (tmp_path / f".1.{path.name}").write_text("what another process is writing")
    assert path == bound_path(tmp_path, TASK, SEED)
    assert path.stat().st_size < 10_000
    assert load_bound(path, "smoke") == bound
    assert load_bound(path, "smoke").sequence().tobytes() == actions.tobytes()
    assert load_bounds(tmp_path, "smoke") == {(OFFICE, "summer", "USA_IL_Chicago", SEED): bound}


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ('"zenostat bound"', '"something"', "is not a file that `zenostat bounds` wrote"),
        ('"reward":', '"rewards":', "is not a file that `zenostat bounds` wrote"),
        ('-8.0,\n "terms"', 'NaN,\n "terms"', "is not a file that `zenostat bounds` wrote"),
        ('"version": ', '"version": 9', "version 9"),
        ('"definition": "', '"definition": "0', "another definition of the set 'smoke'"),
        ('"actions": "', '"actions": "!', "cannot be read"),
        ('"actions_hash": "', '"actions_hash": "0', "their hash differs"),
        (" 168,", " 169,", "bytes of actions"),
        (" 168,", " 1680000000,", "at most"),
    ],
)  # fmt: skip
def test_bound__damaged_or_foreign_file_is_refused(tmp_path: Path, old: str, new: str, text: str) -> None:
    path = example().save(tmp_path)
    content = path.read_text()
    assert old in content
    path.write_text(content.replace(old, new, 1))
    with pytest.raises(InvalidConfig, match=text):
        load_bound(path, "smoke")


def test_bound__compressed_actions_cannot_fill_the_memory(tmp_path: Path) -> None:
    bound = example(np.zeros((1_000_000, 1), np.float32))
    small = bound.model_copy(update={"shape": (168, 2)})
    with pytest.raises(InvalidConfig, match="their hash differs"):
        load_bound(small.save(tmp_path), "smoke")


def test_bounds__folder_without_bounds_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnknownName, match="has no bounds"):
        load_bounds(tmp_path, "smoke")
    with pytest.raises(UnknownName, match="there is no folder"):
        load_bounds(tmp_path / "none", "smoke")


def test_bounds__two_files_of_one_task_and_seed_are_refused(tmp_path: Path) -> None:
    path = example().save(tmp_path)
    (tmp_path / "zz.json").write_text(path.read_text())
    with pytest.raises(InvalidConfig, match=f"zz.json has a bound of {TASK}/{SEED}, as another file there"):
        load_bounds(tmp_path, "smoke")


def test_bounds__tasks_are_chosen_by_name() -> None:
    assert tasks_of("smoke", building=[OFFICE], seed=None) == [(TASK, SEED)]
    assert len(tasks_of("quick")) == 30
    with pytest.raises(UnknownName, match="no rows of the season 'autumn'"):
        tasks_of("quick", season=["autumn"])
    with pytest.raises(UnknownName, match="no set 'slow'"):
        tasks_of("slow")


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--controllers", "tuned"], "tuned/ref-small-office/summer: no folder of policies is named"),
        (["--controllers", "baseline,ppo", "--policies", "none"], "ppo/ref-small-office/summer/0: there is no file"),
        (["--controllers", "rbk"], "no controller 'rbk'"),
    ],
)
def test_bounds__start_that_is_missing_is_refused_before_any_search(
    tmp_path: Path, arguments: list[str], text: str
) -> None:
    chosen = ["--set", "smoke", "--building", OFFICE, "--workers", "2"]
    result = CliRunner().invoke(app, ["bounds", str(tmp_path / "bounds"), *chosen, *arguments])
    assert isinstance(result.exception, UnknownName | InvalidConfig)
    assert text in str(result.exception)
    assert not (tmp_path / "bounds").exists()


def test_bounds__tasks_go_on_after_one_that_fails(tmp_path: Path) -> None:
    other = dataclasses.replace(TASK, building=SETS["smoke"].buildings[1])
    failing = example(versions={"numpy": "1.0"})
    saved = example(building=other.building, definition=definition_of("smoke", other), reward=-7.0, simulations=9)
    for bound in (failing, saved):
        bound.save(tmp_path)
    command = ["bounds", str(tmp_path), "--set", "smoke", "--simulations", "3"]
    done = CliRunner().invoke(app, [*command, "--search-seed", "9"])
    assert done.exit_code == 1
    assert f"failed: {TASK}/{SEED}: " in done.output
    assert "numpy 1.0, now " in done.output
    assert f"{other}/{SEED}: 9 of 9 simulations, -7.00" in done.output
    assert "--search-seed: of new searches alone; 2 of 2 tasks have a file" in " ".join(done.output.split())
    unknown = CliRunner().invoke(app, [*command, "--controllers", "nonsense"])
    assert isinstance(unknown.exception, UnknownName)


def test_bounds__options_of_a_search_are_refused_with_check(tmp_path: Path) -> None:
    example().save(tmp_path)
    options = ["--simulations", "3", "--controllers", "nonsense", "--policies", "none", "--search-seed", "9"]
    done = CliRunner().invoke(app, ["bounds", str(tmp_path), "--set", "smoke", "--check", *options])
    assert isinstance(done.exception, InvalidConfig)
    assert [line.partition(":")[0] for line in str(done.exception).splitlines()] == options[::2]


# Shares of the gap


def test_gap__share_by_hand() -> None:
    assert gap_share(-9.0, -10.0, -8.0) == 0.5
    assert gap_share(-10.0, -10.0, -8.0) == 0.0
    assert gap_share(-8.0, -10.0, -8.0) == 1.0
    assert gap_share(-7.0, -10.0, -8.0) == 1.5
    assert gap_share(-14.0, -10.0, -8.0) == -2.0
    assert gap_share(-9.0, -10.0, -10.0) is None
    assert gap_share(-9.0, -10.0, -11.0) is None


def row(controller: str, seed: int, reward: float) -> Row:
    metrics, terms = {"occupied_outside_kh": 1.5}, {"cost": reward}
    return Row(controller, OFFICE, "summer", "USA_IL_Chicago", seed, reward, terms, reward, metrics)


def test_gap__table_has_the_bound_and_leaves_out_episodes_without_a_gap() -> None:
    rows = [row("baseline", seed, -10.0) for seed in (1, 2, 3)]
    rows += [row("rbc", 1, -9.0), row("rbc", 2, -10.0), row("rbc", 3, -5.0)]
    known = [example(seed=seed, reward=reward) for seed, reward in ((1, -8.0), (2, -6.0), (3, -10.0), (4, -1.0))]
    table = gap_table(rows, {bound.key: bound for bound in known})
    assert table.title.endswith("over 2 of 3 episodes; 1 without a gap are left out")
    cells = {line[0]: line[1:] for line in table.rows}
    assert list(cells) == ["bound", "rbc", "baseline"]
    assert cells["rbc"][0] == "0.250"  # the mean of 0.5 and 0; one weather file has no interval
    assert cells["bound"][:2] == ("1.000", "0.300")  # the mean of 0.2 and 0.4
    assert cells["baseline"][1] == "0.000"
    with pytest.raises(InvalidConfig, match="has a bound above the baseline control"):
        gap_table(rows, {bound.key: bound for bound in known[2:]})
    with pytest.raises(InvalidConfig, match="has a bound above the baseline control"):
        gap_table(rows, {known[3].key: known[3]})  # of an episode without rows
    with pytest.raises(InvalidConfig, match="run the controller 'baseline' too"):
        gap_table(rows[3:], {bound.key: bound for bound in known})


def test_gap__command_shows_the_tables_before_it_says_that_no_bound_is_of_their_episodes(tmp_path: Path) -> None:
    folder = tmp_path / "bounds"
    folder.mkdir()
    example().save(folder)
    results = Results("smoke")
    results.add([row("baseline", 1, -10.0), row("rbc", 1, -9.0)])
    results.save(tmp_path / "r.json")
    done = CliRunner().invoke(app, ["benchmark", "--show", str(tmp_path / "r.json"), "--bounds", str(folder)])
    assert isinstance(done.exception, InvalidConfig)
    assert "no episode of all controllers has a bound above the baseline control" in str(done.exception)
    assert "Scores by building" in done.output


@pytest.mark.parametrize(
    ("changes", "text"),
    [({"hashes": {OFFICE: "cd"}}, f"file {OFFICE}"), ({"versions": {"numpy": "1.0"}}, "numpy 1.0, now ")],
)
def test_gap__bounds_of_other_files_or_versions_are_refused(changes: dict[str, Any], text: str) -> None:
    results = Results("smoke", hashes={OFFICE: "ab"})
    results.add([row("baseline", SEED, -10.0), row("rbc", SEED, -9.0)])
    own = example(hashes={OFFICE: "ab", "ref-other": "00"}, versions=results.versions)
    assert len(list(tables_with_gap(results, {own.key: own}))) == len(tables(results)) + 1
    other = own.model_copy(update=changes)
    with pytest.raises(InvalidConfig, match=f"{TASK}/{SEED} cannot be compared with its bound, .*: {text}"):
        list(tables_with_gap(results, {other.key: other}))
    elsewhere = other.model_copy(update={"seed": 1})
    assert len(list(tables_with_gap(results, {own.key: own, elsewhere.key: elsewhere}))) == len(tables(results)) + 1


# Real episodes


@pytest.mark.slow
@pytest.mark.process
@pytest.mark.timeout(600)
def test_bound__begins_with_published_policies_whose_rows_are_equal_to_the_bit(tmp_path: Path) -> None:
    task, policies = Task(OFFICE, "summer", "USA_IL_Chicago"), PUBLISHED / "policies-2"
    job = BoundTask("quick", task, SEED, tmp_path, ["baseline", "tuned", "ppo"], policies=policies)
    bound = improve_bound(job, 1)
    published = load_results(PUBLISHED / "quick-2.json").rows.values()
    rewards = {
        one.controller: one.reward
        for one in published
        if (one.building, one.season, one.weather, one.seed) == (*task.key, SEED)
    }
    assert bound.starts["baseline (relative)"] == rewards["baseline"]
    assert bound.starts["tuned (absolute)"] == rewards["tuned"]
    assert bound.starts["ppo (absolute)"] == rewards["ppo"]
    assert bound.reward >= max(rewards[name] for name in ("baseline", "tuned", "ppo"))


@pytest.mark.slow
@pytest.mark.process
@pytest.mark.timeout(1200)
def test_bound__beats_the_controllers_and_is_run_again_to_the_bit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(SETS, "smoke", dataclasses.replace(SETS["smoke"], buildings=(OFFICE,)))
    monkeypatch.setattr(bound_search, "STAGES_H", (1.0, None))
    simulations = 5 + 9 + 16  # of the controllers, of a sweep, of windows
    job = BoundTask("smoke", TASK, SEED, tmp_path / "bounds", ["baseline", "fixed", "rbc"])
    bound = improve_bound(job, simulations)
    results, _ = run_benchmark("smoke", tmp_path / "results.json", ["rbc"])
    rewards = {one.controller: one.reward for one in results.rows.values() if one.building == OFFICE}
    assert bound.starts["baseline (relative)"] == rewards["baseline"]  # offsets of 0, to the bit
    assert bound.starts["rbc (absolute)"] == rewards["rbc"]
    assert bound.reward > max(rewards.values())
    assert (bound.simulations, bound.stages) == (simulations, 2)
    assert load_bound(job.path, "smoke") == bound
    older = bound.model_copy(update={"versions": {**bound.versions, "numpy": "1.0"}})
    assert check_bound(older, "smoke") == []  # its rewards are equal all the same
    other = older.model_copy(update={"reward": float(np.nextafter(bound.reward, 0.0))})
    assert [text.partition(": ")[2] for text in check_bound(other, "smoke")] == [
        f"version of numpy 1.0, now {np.__version__}", f"reward {other.reward!r}, now {bound.reward!r}",
    ]  # fmt: skip
    assert improve_bound(job, simulations) == bound
    checked = CliRunner().invoke(app, ["bounds", str(job.folder), "--set", "smoke", "--building", OFFICE, "--check"])
    assert checked.exit_code == 0, checked.output
    assert "bounds that are equal to the bit: 1" in checked.output
