"""The orchestration of a step against hand calculations: order, delay, solved loops, balances."""

import re
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.coupled_plants import FakeCoupled, Step, district_file, free, gain, manifest_of, orchestrated
from support.examples import examples

W: Any = {"x": "W"}
U: Any = {"u": ("W", -1e6, 1e6)}


def plant(step: Step, *, sensors: Any = None, actuators: Any = None, **fields: Any) -> FakeCoupled:
    parts = {name: fields.pop(name) for name in ("first", "values", "name", "log") if name in fields}
    return FakeCoupled(manifest_of(sensors or W, actuators or U, **fields), step, **parts)


def file_of(folder: Path, connections: str, plants: str = "ab", head: str = "") -> Any:
    lines = "".join(f"  {name}: {{plant: 'p.py:P'}}\n" for name in plants)
    return district_file(folder, f"{head}plants:\n{lines}connections:\n{connections}")


def counter(state: list[float], _: list[float]) -> tuple[list[float], list[float]]:
    """A plant whose value is the number of its timestep."""
    return [state[0] + 1.0], [state[0] + 1.0]


def test_step__acyclic_plants_have_values_of_the_same_step(folder: Path) -> None:
    """a counts, b doubles, c adds one: c is 2 k + 1 in step k, without any delay, whatever their order in the file."""
    file = file_of(folder, "  - {from: b.x, to: c.u}\n  - {from: a.x, to: b.u}\n", "cba")
    plants = {"c": plant(gain(1.0, 1.0)), "b": plant(gain(2.0)), "a": plant(counter, first=[0.0])}
    orchestrator, _, _ = orchestrated(file, plants)
    for k in range(1, 6):
        orchestrator.step(free(plants))
        assert [orchestrator.rows[name].values[0, 0] for name in "abc"] == [k, 2.0 * k, 2.0 * k + 1.0]


def test_step__independent_plants_run_side_by_side(folder: Path) -> None:
    log: list[str] = []
    plants = {name: plant(gain(1.0), name=name, log=log) for name in "abc"}
    orchestrator, _, _ = orchestrated(file_of(folder, "  - {from: a.x, to: c.u}\n", "abc"), plants)
    log.clear()
    orchestrator.step(free(plants))
    assert log == ["a begins", "b begins", "a ends", "b ends", "c begins", "c ends"]


@pytest.mark.parametrize("delay", [1, 3])
def test_step__delayed_value_is_that_of_an_earlier_step(folder: Path, delay: int) -> None:
    file = file_of(folder, f"  - {{from: a.x, to: b.u, delay: {delay}, initial: -5}}\n")
    plants = {"a": plant(counter, first=[0.0]), "b": plant(gain(1.0))}
    orchestrator, _, _ = orchestrated(file, plants)
    for _ in range(6):
        orchestrator.step(free(plants))
    assert [row[0] for row in plants["b"].commands] == ([-5.0] * delay + [1.0, 2.0, 3.0, 4.0, 5.0])[:6]


def test_step__delayed_value_begins_with_sample_0(folder: Path) -> None:
    file = file_of(folder, "  - {from: a.x, to: b.u, delay: 1}\n")
    plants = {"a": plant(counter, first=[0.0], values=[9.0]), "b": plant(gain(1.0))}
    orchestrator, _, _ = orchestrated(file, plants)
    orchestrator.step(free(plants))
    assert plants["b"].commands == [[9.0]]


def test_step__several_sources_are_added_and_bounded(folder: Path) -> None:
    file = file_of(folder, "  - {from: a.x, to: c.u, sum: true}\n  - {from: b.x, to: c.u, sum: true}\n", "abc")
    plants = {
        "a": plant(gain(1.0)), "b": plant(gain(1.0)), "c": plant(gain(1.0), actuators={"u": ("W", 0.0, 10.0)}),
    }  # fmt: skip
    orchestrator, _, _ = orchestrated(file, plants)
    for a, b in ((3.0, 4.0), (8.0, 9.0)):
        orchestrator.step(free(plants, a=[a], b=[b]))
    assert plants["c"].commands == [[7.0], [10.0]]
    total = orchestrator.balances()[-1]
    assert (total.name, total.sent, total.received, total.clipped) == ("c.u", 900.0 * 24, 900.0 * 17, 900.0 * 7)


def test_step__actuators_without_connection_have_the_districts_commands(folder: Path) -> None:
    two: Any = {"u": ("W", None, None), "v": ("W", None, None)}
    plants = {"a": plant(gain(1.0)), "b": plant(gain(1.0), actuators=two)}
    orchestrator, _, _ = orchestrated(file_of(folder, "  - {from: a.x, to: b.u}\n"), plants)
    orchestrator.step(free(plants, a=[2.0], b=[99.0, 4.0]))
    orchestrator.step(free(plants, a=[3.0]))
    assert plants["b"].commands[0] == [2.0, 4.0]
    assert plants["b"].commands[1][0] == 3.0
    assert np.isnan(plants["b"].commands[1][1])


def test_step__different_timesteps_exchange_means(folder: Path) -> None:
    """a steps three times in a step of b: b gets the mean of its values, and a the value of b three times."""
    file = file_of(folder, "  - {from: a.x, to: b.u}\n  - {from: b.x, to: a.u, delay: 1}\n")
    plants = {"a": plant(counter, first=[0.0], step_s=300.0, steps=288), "b": plant(gain(10.0))}
    orchestrator, _, _ = orchestrated(file, plants)
    orchestrator.step(free(plants))
    orchestrator.step(free(plants))
    assert [row[0] for row in plants["b"].commands] == [2.0, 5.0]
    assert [row[0] for row in plants["a"].commands] == [0.0, 0.0, 0.0, 20.0, 20.0, 20.0]


@pytest.mark.parametrize("delay", [1, 2])
def test_step__interpolation_of_a_delayed_value_begins_with_its_first_one(folder: Path, delay: int) -> None:
    file = file_of(folder, f"  - {{from: a.x, to: b.u, resample: interpolate, delay: {delay}, initial: 0}}\n")
    plants = {"a": plant(counter, first=[100.0]), "b": plant(gain(1.0))}
    orchestrator, _, _ = orchestrated(file, plants)
    for _ in range(4):
        orchestrator.step(free(plants))
    later = [50.5, 101.5, 102.5]  # the mean between 0 and 101, between 101 and 102
    assert [row[0] for row in plants["b"].commands] == ([0.0] * delay + later)[:4]


LOOP = "  - {from: a.x, to: b.u}\n  - {from: b.x, to: a.u, solve: true, tolerance: 1.0e-9}\n"


@pytest.mark.parametrize(("first", "second"), [(0.5, 0.5), (-2.0, 3.0), (4.0, 1.0)])
def test_loop__linear_loop_has_its_algebraic_solution(folder: Path, first: float, second: float) -> None:
    """a = f b + 1, b = g a + 2: a = (2 f + 1) / (1 - f g), for contractions and, without bounds, expansions."""
    unbounded: Any = {"u": ("W", None, None)}
    plants = {"a": plant(gain(first, 1.0), actuators=unbounded), "b": plant(gain(second, 2.0), actuators=unbounded)}
    orchestrator, _, _ = orchestrated(file_of(folder, LOOP), plants)
    orchestrator.step(free(plants))
    expected = (2.0 * first + 1.0) / (1.0 - first * second)
    assert orchestrator.rows["a"].values[0, 0] == pytest.approx(expected, rel=1e-9)
    assert orchestrator.loops[0].is_solved
    assert abs(orchestrator.residuals[1]) <= 1e-9
    trials = orchestrator.loops[0].trials
    assert (plants["a"].tries, plants["b"].tries) == (trials, trials)
    assert [len(each.commands) for each in plants.values()] == [1, 1]


def test_loop__next_step_begins_with_the_solution(folder: Path) -> None:
    plants = {"a": plant(gain(0.5, 1.0)), "b": plant(gain(0.5, 2.0))}
    orchestrator, _, _ = orchestrated(file_of(folder, LOOP), plants)
    for expected in (3, 1, 1):
        orchestrator.step(free(plants))
        assert orchestrator.loops[0].trials == expected
    assert (orchestrator.loops[0].total, orchestrator.loops[0].steps) == (5, 3)


def test_loop__loops_that_do_not_depend_on_each_other_are_solved_at_the_same_time(folder: Path) -> None:
    """Each waits in its first trial for the other one; a and b, c and d as in the test of one loop."""
    meeting = threading.Barrier(2, timeout=60.0)

    def met(factor: float, offset: float) -> Step:
        waits = iter([True])

        def step(state: list[float], row: list[float]) -> tuple[list[float], list[float]]:
            if next(waits, False):
                meeting.wait()
            return gain(factor, offset)(state, row)

        return step

    plants = {
        "a": plant(met(0.5, 1.0)),
        "b": plant(gain(0.5, 2.0)),
        "c": plant(met(0.2, 1.0)),
        "d": plant(gain(0.5, 2.0)),
    }
    text = LOOP + LOOP.replace("a.", "c.").replace("b.", "d.") + "  - {from: a.x, to: e.u}\n"
    orchestrator, _, _ = orchestrated(file_of(folder, text, "abcde"), {**plants, "e": plant(gain(2.0))})
    orchestrator.step({**free(plants), "e": np.full(1, np.nan)})
    values = [orchestrator.rows[name].values[0, 0] for name in "ace"]
    assert values == pytest.approx([2.0 / 0.75, 1.4 / 0.9, 4.0 / 0.75], rel=1e-8)
    assert [loop.is_solved for loop in orchestrator.loops] == [True, True]


def test_loop__two_loops_through_one_plant_have_two_unknowns(folder: Path) -> None:
    """a = b + c; b = 0.5 a + 1; c = 0.25 a + 2: a = 12, with both returns solved."""
    text = """  - {from: b.x, to: a.u, solve: true, tolerance: 1.0e-9}
  - {from: c.x, to: a.v, solve: true, tolerance: 1.0e-9}
  - {from: a.x, to: b.u}
  - {from: a.x, to: c.u}
"""
    two: Any = {"u": ("W", None, None), "v": ("W", None, None)}
    plants = {
        "a": plant(lambda state, row: (state, [row[0] + row[1]]), actuators=two),
        "b": plant(gain(0.5, 1.0)),
        "c": plant(gain(0.25, 2.0)),
    }
    orchestrator, _, _ = orchestrated(file_of(folder, text, "abc"), plants)
    orchestrator.step(free(plants))
    assert orchestrator.rows["a"].values[0, 0] == pytest.approx(12.0, rel=1e-8)
    assert orchestrator.loops[0].trials <= 4


def test_loop__value_for_several_actuators_is_one_unknown(folder: Path) -> None:
    """a = 0.25 (u + v) + 1, and both inputs are its value: a = 2, in the three trials of a linear function."""
    text = "  - {from: a.x, to: [a.u, a.v], name: own, solve: true, tolerance: 1.0e-9}\n"
    two: Any = {"u": ("W", None, None), "v": ("W", -5.0, 5.0)}
    plants = {"a": plant(lambda state, row: (state, [0.25 * (row[0] + row[1]) + 1.0]), actuators=two)}
    orchestrator, binding, _ = orchestrated(file_of(folder, text, "a"), plants)
    orchestrator.step(free(plants))
    assert [transfer.name for transfer in binding.transfers] == ["own-1", "own-2"]
    assert [(transfer.low, transfer.high) for transfer in binding.transfers] == [(-5.0, 5.0)] * 2
    assert plants["a"].commands[0][0] == plants["a"].commands[0][1] == pytest.approx(2.0, rel=1e-9)
    assert orchestrator.loops[0].trials == 3
    assert all(abs(balance.closure) <= 1e-9 for balance in orchestrator.balances())


def test_step__sum_of_a_single_connection_is_limited_by_its_actuator(folder: Path) -> None:
    """The source sends 10 W for 900 s, 5 W are received, and the balance has the rest as clipped."""
    plants = {"a": plant(gain(0.0, 10.0)), "b": plant(gain(1.0), actuators={"u": ("W", 0.0, 5.0)})}
    orchestrator, _, _ = orchestrated(file_of(folder, "  - {from: a.x, to: b.u, sum: true}\n"), plants)
    orchestrator.step(free(plants))
    assert plants["b"].commands[0][0] == 5.0
    (balance,) = orchestrator.balances()
    assert (balance.sent, balance.received, balance.clipped) == (9000.0, 4500.0, 4500.0)


def switch(state: list[float], row: list[float]) -> tuple[list[float], list[float]]:
    """Staged equipment: full power below a command of 3, none above."""
    return state, [10.0 if row[0] < 3.0 else 0.0]


def test_loop__jump_keeps_the_best_trial_and_is_reported(folder: Path) -> None:
    text = "  - {from: a.x, to: a.u, solve: true, tolerance: 0.1, low: 0, high: 10}\n"
    plants = {"a": plant(switch)}
    orchestrator, _, _ = orchestrated(file_of(folder, text, "a", "solver: {trials: 40}\n"), plants)
    orchestrator.step(free(plants))
    (report,) = orchestrator.drain_warnings()
    assert report.startswith("loop 'a' is not solved in step 1 after ")
    assert "respond with a jump" in report
    assert (orchestrator.loops[0].unsolved, orchestrator.loops[0].is_solved) == (1, False)
    assert orchestrator.loops[0].error == pytest.approx(abs(orchestrator.residuals[0]) / 0.1)
    assert abs(orchestrator.residuals[0]) == pytest.approx(3.0, abs=0.05)  # below 3 the residual is 7
    assert orchestrator.drain_warnings() == []


def test_loop__jump_that_the_limit_of_trials_hides_is_reported_with_its_place(folder: Path) -> None:
    """Six trials leave the place of the jump, 3, between two values."""
    text = "  - {from: a.x, to: a.u, solve: true, tolerance: 1.0e-6, low: 0, high: 10}\n"
    plants = {"a": plant(switch)}
    orchestrator, _, _ = orchestrated(file_of(folder, text, "a", "solver: {trials: 6}\n"), plants)
    orchestrator.step(free(plants))
    (report,) = orchestrator.drain_warnings()
    assert "since the limit was reached" in report
    bracket = re.search(r"and it changes its sign between (\S+) and (\S+) W$", report)
    assert bracket is not None
    assert float(bracket[1]) < 3.0 <= float(bracket[2])


def test_loop__limit_of_trials_is_reported(folder: Path) -> None:
    plants = {"a": plant(gain(0.5, 1.0)), "b": plant(gain(0.5, 2.0))}
    orchestrator, _, _ = orchestrated(file_of(folder, LOOP, head="solver: {trials: 2}\n"), plants)
    orchestrator.step(free(plants))
    (report,) = orchestrator.drain_warnings()
    assert "not solved in step 1 after 2 trials, since the limit was reached" in report


def mixed(state: list[float], row: list[float]) -> tuple[list[float], list[float]]:
    """A plant with a memory and a nonlinear response."""
    value = 0.8 * state[0] + np.tanh(np.nan_to_num(row[0]) / 7.0) + 0.5
    return [value], [3.0 * value]


# Sources without a value


def readings(*values: float) -> Step:
    """A plant whose values are these, one in each timestep."""

    def step(state: list[float], _: list[float]) -> tuple[list[float], list[float]]:
        return [state[0] + 1.0], [values[int(state[0])]]

    return step


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_step__last_value_holds_where_a_source_has_none(folder: Path, value: float) -> None:
    plants = {"a": plant(readings(1.0, value, value, 4.0), first=[0.0]), "b": plant(gain(1.0))}
    orchestrator, binding, _ = orchestrated(file_of(folder, "  - {from: a.x, to: b.u}\n"), plants)
    (terms,) = [transfer.balance_terms for transfer in binding.transfers]
    published = []
    for _ in range(4):
        orchestrator.step(free(plants))
        published.append(dict(zip(terms, orchestrator.balance_terms, strict=True))["sent"])
    assert [row[0] for row in plants["b"].commands] == [1.0, 1.0, 1.0, 4.0]
    assert np.array_equal(published, [1.0, np.nan, np.nan, 4.0], equal_nan=True)
    (report,) = orchestrator.drain_warnings()
    assert report == "connection 'a.x-b.u': its source has no value in step 2; the last one holds until it has one"
    (balance,) = orchestrator.balances()
    assert (balance.sent, balance.received, balance.missing_steps) == (4500.0, 4500.0, 2)
    assert balance.label == "a.x-b.u (steps without a value: 2)"


def test_step__actuator_is_relinquished_until_there_is_a_value(folder: Path) -> None:
    source = plant(readings(np.nan, 3.0), first=[0.0], values=[np.nan])
    plants = {"a": source, "b": plant(gain(1.0))}
    for connection in ("", ", resample: interpolate"):
        file = file_of(folder, f"  - {{from: a.x, to: b.u{connection}}}\n")
        orchestrator, _, _ = orchestrated(file, plants)
        for _ in range(2):
            orchestrator.step(free(plants))
        assert np.isnan(plants["b"].commands[0][0])
        assert "the actuator is relinquished" in orchestrator.drain_warnings()[0]
        assert np.isfinite(orchestrator.balances()[0].sent)


def test_step__shorter_timesteps_and_delays_hold_the_last_value_as_well(folder: Path) -> None:
    """5 and 7 of the three timesteps of a step; then none, which delays hold as 7."""
    values = (5.0, np.nan, 7.0, np.nan, np.nan, np.nan, 1.0, 1.0, 1.0)
    plants = {"a": plant(readings(*values), first=[0.0], step_s=300.0, steps=288), "b": plant(gain(1.0))}
    file = file_of(folder, "  - {from: a.x, to: b.u, delay: 1, initial: 2}\n")
    orchestrator, _, _ = orchestrated(file, plants)
    for _ in range(3):
        orchestrator.step(free(plants))
    assert [row[0] for row in plants["b"].commands] == pytest.approx([2.0, 17.0 / 3.0, 7.0])
    (balance,) = orchestrator.balances()
    assert balance.missing_steps == 2
    assert abs(balance.closure) <= 1e-9


@pytest.mark.parametrize("missing", ["a", "b"])
def test_loop__without_a_value_is_not_solved_and_goes_on_with_the_next_one(folder: Path, missing: str) -> None:
    def without(step: Step) -> Step:
        def wrapped(state: list[float], row: list[float]) -> tuple[list[float], list[float]]:
            (count,), (value,) = state, step([], row)[1]
            return [count + 1.0], [np.nan if count == 1.0 else value]

        return wrapped

    steps = {"a": gain(0.5, 1.0), "b": gain(0.5, 2.0)}
    plants = {name: plant(without(s) if name == missing else s, first=[0.0]) for name, s in steps.items()}
    orchestrator, _, _ = orchestrated(file_of(folder, LOOP), plants)
    solved = []
    for _ in range(3):
        orchestrator.step(free(plants))
        solved.append(orchestrator.loops[0].is_solved)
    assert solved == [True, False, True]
    commands = [row[0] for row in plants["a"].commands]
    assert commands == pytest.approx([10.0 / 3.0] * 3)
    held, unsolved = sorted(orchestrator.drain_warnings())
    assert "the last one holds" in held
    assert unsolved == "loop 'a-b' is not solved in step 2 after 1 trials, since a plant has no value"
    assert all(np.isfinite(balance.sent) for balance in orchestrator.balances())


CONNECTION = st.tuples(
    st.sampled_from(["hold", "mean", "interpolate"]),
    st.sampled_from(["", ", delay: 1", ", delay: 3", ", solve: true, tolerance: 0.01"]),
    st.sampled_from(["", ", low: 0.5, high: 2", ", factor: -2.5, offset: 1"]),
)


TERMS = ("sent", "clipped", "resampled", "residual", "stored")


@settings(max_examples=examples(60), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.tuples(CONNECTION, CONNECTION), st.sampled_from([300.0, 450.0, 900.0]), st.integers(1, 12))
def test_balance__closes_for_each_connection(
    folder: Path, connections: tuple[tuple[str, str, str], ...], step_s: float, steps: int
) -> None:
    """Sent = received + clipped + resampled + residual + stored, whatever the connections do, within 1e-9."""
    (first, back), lines = connections, []
    if back[1] == "":
        back = (back[0], ", delay: 1", back[2])
    if "solve" in first[1] and "delay" in back[1]:
        first = (first[0], "", first[2])
    for (kind, form, limits), (source, target) in zip((first, back), (("a", "b"), ("b", "a")), strict=True):
        lines.append(f"  - {{from: {source}.x, to: {target}.u, resample: {kind}{form}{limits}}}\n")
    if "delay" in first[1] and "solve" in back[1]:
        lines[1] = lines[1].replace(", solve: true, tolerance: 0.01", "")
    plants = {"a": plant(mixed, first=[1.0], step_s=step_s, steps=960), "b": plant(mixed, first=[-2.0])}
    orchestrator, binding, _ = orchestrated(file_of(folder, "".join(lines)), plants)
    names = [(number, term) for number, each in enumerate(binding.transfers) for term in each.balance_terms]
    sums = dict.fromkeys(((number, term) for number in (0, 1) for term in TERMS), 0.0)
    for number in range(steps):
        orchestrator.step(free(plants))
        for balance in orchestrator.balances():
            assert abs(balance.closure) <= 1e-9, (number, balance)
        for name, value in zip(names, orchestrator.balance_terms, strict=True):
            sums[name] += value * 900.0
    for (number, term), published in sums.items():
        balance = orchestrator.balances()[number]
        assert published == pytest.approx(getattr(balance, term), abs=1e-9 * max(balance.greatest, 1.0)), (number, term)
    first_balance = orchestrator.balances()[0]
    received = sum(row[0] for row in plants["b"].commands) * 900.0
    assert first_balance.received == pytest.approx(received, rel=1e-12)
    if first[0] == "mean":
        assert abs(first_balance.resampled) <= 1e-9 * first_balance.greatest
