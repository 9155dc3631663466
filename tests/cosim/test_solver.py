"""The solvers of loops against theory: exact numbers of trials, expansions, jumps, bounds."""

from math import inf

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zenostat.cosim.solver import Function, Outcome, Problem, solve, solve_by_acceleration, solve_in_bracket


def problem(function: Function, *, unknowns: int = 1, tolerance: float = 1e-9, **limits: float) -> Problem:
    return Problem(
        function,
        np.full(unknowns, tolerance),
        np.full(unknowns, limits.get("low", -inf)),
        np.full(unknowns, limits.get("high", inf)),
        int(limits.get("limit", 12)),
    )


@pytest.mark.parametrize("slope", [0.5, -0.5, -3.0, 5.0, 0.9])
def test_bracket__linear_function_takes_three_trials(slope: float) -> None:
    """A contraction or an expansion: the secant of two trials is the function itself."""
    solution = solve(problem(lambda x: slope * x + 1.0), np.array([0.3]))
    assert solution.is_solved
    assert solution.trials == 3
    assert solution.best.x[0] == pytest.approx(1.0 / (1.0 - slope), rel=1e-9)


@pytest.mark.parametrize("unknowns", [1, 2])
@pytest.mark.parametrize("value", [np.nan, inf])
def test_solve__ends_where_the_function_has_no_value(unknowns: int, value: float) -> None:
    """The best trial before is taken, or the first one."""
    solution = solve(problem(lambda x: x * value, unknowns=unknowns), np.full(unknowns, 2.0))
    assert (solution.trials, solution.outcome, solution.best.x.tolist()) == (1, Outcome.UNDEFINED, [2.0] * unknowns)
    tries = iter([0.0, value])
    solution = solve(problem(lambda x: 0.5 * x + next(tries), unknowns=unknowns), np.full(unknowns, 2.0))
    assert (solution.trials, solution.outcome, solution.best.x.tolist()) == (2, Outcome.UNDEFINED, [2.0] * unknowns)
    assert not solution.is_solved


def test_bracket__constant_function_takes_two_trials() -> None:
    solution = solve(problem(lambda x: 0.0 * x + 4.0), np.array([0.3]))
    assert (solution.trials, solution.best.x[0]) == (2, 4.0)


def test_bracket__solution_at_the_start_takes_one_trial() -> None:
    solution = solve(problem(lambda x: x, low=0.0, high=1.0), np.array([0.25]))
    assert (solution.trials, solution.best.x[0], solution.outcome) == (1, 0.25, Outcome.SOLVED)


@given(st.floats(0.05, 0.95), st.floats(0.0, 1.0), st.floats(0.5, 50.0))
def test_bracket__decreasing_function_is_solved_within_its_bounds(
    middle: float, start: float, steepness: float
) -> None:
    """Continuous and decreasing, so there is one fixed point; the bracket holds it, and halves in two trials."""

    def function(x: np.ndarray) -> np.ndarray:
        return np.clip(0.5 - np.tanh(steepness * (x - middle)), 0.0, 1.0)

    trials: list[float] = []

    def observed(x: np.ndarray) -> np.ndarray:
        trials.append(float(x[0]))
        return function(x)

    solution = solve(problem(observed, tolerance=1e-4, low=0.0, high=1.0, limit=60), np.array([start]))
    assert solution.is_solved
    assert abs(function(solution.best.x) - solution.best.x)[0] <= 1e-4
    assert all(0.0 <= x <= 1.0 for x in trials)
    assert len(set(trials)) == len(trials)


def test_bracket__saturated_function_is_solved_at_its_bound() -> None:
    solution = solve(problem(lambda x: np.clip(3.0 * x + 1.0, -2.0, 2.0), low=-2.0, high=2.0), np.array([0.0]))
    assert (solution.outcome, solution.best.x[0]) == (Outcome.SOLVED, 2.0)


@given(st.floats(0.01, 0.99), st.floats(0.0, 1.0))
def test_bracket__jump_has_no_solution(place: float, start: float) -> None:
    """x = 1 left of a place and 0 right of it: the residual changes its sign, but is at least min(place, 1 - place)."""
    tolerance = 0.5 * min(place, 1.0 - place)
    switch = problem(lambda x: np.where(x < place, 1.0, 0.0), tolerance=tolerance, low=0.0, high=1.0, limit=100)
    solution = solve(switch, np.array([start]))
    assert solution.outcome is Outcome.JUMP
    assert solution.best.error > 1.0
    assert solution.bracket is not None
    low, high = solution.bracket
    assert low < place <= high
    assert high - low <= 0.1 * tolerance


def test_bracket__limit_of_trials_keeps_the_best() -> None:
    errors: list[float] = []

    def function(x: np.ndarray) -> np.ndarray:
        errors.append(abs(float(np.exp(-5.0 * x[0]) - x[0])))
        return np.exp(-5.0 * x)

    solution = solve(problem(function, limit=4), np.array([2.0]))
    assert (solution.outcome, solution.trials) == (Outcome.LIMIT, 4)
    assert abs(solution.best.residual[0]) == min(errors)


@pytest.mark.parametrize("unknowns", [1, 2, 3])
@pytest.mark.parametrize("start", [0.0, 21.5, -4e5])
@pytest.mark.parametrize("scale", [1.0, 3.7])
def test_solve__function_without_a_fixed_point_keeps_its_start(unknowns: int, start: float, scale: float) -> None:
    """x + c has the residual c everywhere; where x is so large that x + c equals x, that is its rounding alone."""
    offset = np.array([0.3, 0.7, -0.2])[:unknowns]
    shifted = problem(lambda x: (x * scale + offset * scale) / scale, unknowns=unknowns, tolerance=1e-6, limit=40)
    solution = solve(shifted, np.full(unknowns, start))
    assert solution.outcome is Outcome.LIMIT
    assert solution.best.x.tolist() == [start] * unknowns
    assert solution.best.error == pytest.approx(np.abs(offset).max() / 1e-6, rel=1e-6)


@pytest.mark.parametrize("unknowns", [1, 2])
def test_solve__tolerance_below_the_rounding_of_a_solution_is_met_by_its_residual_of_zero(unknowns: int) -> None:
    """Halves and eighths are exact: 0.5 x + 2^29 has the fixed point 2^30, where numbers are 2^-22 apart."""
    halved = problem(lambda x: 0.5 * x + 2.0**29, unknowns=unknowns, tolerance=1e-9)
    solution = solve(halved, np.full(unknowns, 8.0))
    assert (solution.is_solved, solution.best.x.tolist()) == (True, [2.0**30] * unknowns)


@pytest.mark.parametrize("unknowns", [2, 3, 5])
@pytest.mark.parametrize("scale", [0.3, 3.0])
def test_acceleration__linear_function_of_n_unknowns_takes_n_plus_two_trials(unknowns: int, scale: float) -> None:
    """n differences of residuals span the space, so the trial after them is exact, for expansions as well."""
    generator = np.random.default_rng(unknowns)
    matrix, offset = scale * generator.normal(size=(unknowns, unknowns)), generator.normal(size=unknowns)
    solution = solve(
        problem(lambda x: matrix @ x + offset, unknowns=unknowns, tolerance=1e-8, limit=40), np.zeros(unknowns), depth=5
    )
    assert solution.is_solved
    assert solution.trials <= unknowns + 2
    assert solution.best.x == pytest.approx(np.linalg.solve(np.eye(unknowns) - matrix, offset), rel=1e-6)


def test_acceleration__depth_zero_is_relaxation() -> None:
    """x = x + damping * (G(x) - x): a contraction of 0.5 with damping 1 halves the error in each trial."""
    errors = []

    def function(x: np.ndarray) -> np.ndarray:
        errors.append(float(np.abs(x - 2.0).max()))
        return 0.5 * x + 1.0

    solution = solve_by_acceleration(problem(function, unknowns=2, tolerance=1e-3), np.zeros(2), depth=0)
    assert errors == [2.0 * 0.5**k for k in range(len(errors))]
    assert solution.trials == 11  # the residual is half the error: 2 * 0.5**11 is the first below 0.001


def test_acceleration__damping_solves_an_expansion_that_relaxation_does_not() -> None:
    """G(x) = -2 x diverges without damping; with 0.5, x becomes -0.5 x."""
    solution = solve_by_acceleration(
        problem(lambda x: -2.0 * x, unknowns=2, tolerance=1e-6, limit=100), np.array([1.0, 2.0]), depth=0
    )
    assert solution.is_solved


def test_acceleration__unknowns_stay_within_their_bounds() -> None:
    trials = []

    def function(x: np.ndarray) -> np.ndarray:
        trials.append(x.copy())
        return np.clip(np.array([-4.0 * x[1] + 3.0, 4.0 * x[0] - 1.0]), 0.0, 1.0)

    solution = solve(problem(function, unknowns=2, tolerance=1e-6, low=0.0, high=1.0, limit=60), np.array([0.2, 0.9]))
    assert all(((x >= 0.0) & (x <= 1.0)).all() for x in trials)
    assert solution.best.error == min(np.abs(function(x) - x).max() / 1e-6 for x in [*trials])


def test_solver__equal_functions_have_equal_trials_to_the_bit() -> None:
    def run() -> list[bytes]:
        trials: list[bytes] = []

        def function(x: np.ndarray) -> np.ndarray:
            trials.append(x.tobytes())
            return np.array([np.cos(x[1]), 0.5 * np.sin(x[0] + x[2]), 0.1 * x[0] * x[1]])

        assert solve(problem(function, unknowns=3, limit=40), np.zeros(3)).is_solved
        return trials

    assert run() == run()


def test_solver__one_unknown_is_solved_in_a_bracket() -> None:
    cosine = problem(np.cos, low=0.0, high=1.0)
    assert solve(cosine, np.array([0.1])).best.x[0] == solve_in_bracket(cosine, np.array([0.1])).best.x[0]


# Secants of an earlier solution


@pytest.mark.parametrize("unknowns", [1, 2, 3, 5])
def test_secants__linear_function_with_another_offset_takes_two_trials(unknowns: int) -> None:
    """n secants of a linear function are the function itself, so the second trial is exact."""
    generator = np.random.default_rng(unknowns)
    matrix, offset = 0.5 * generator.normal(size=(unknowns, unknowns)), generator.normal(size=(2, unknowns))
    limits = {"unknowns": unknowns, "tolerance": 1e-8}
    first = solve(problem(lambda x: matrix @ x + offset[0], **limits, limit=40), np.zeros(unknowns), depth=unknowns)
    second = solve(
        problem(lambda x: matrix @ x + offset[1], **limits), first.best.x, depth=unknowns, secants=first.secants
    )
    assert first.is_solved
    assert (second.trials, second.outcome) == (2, Outcome.SOLVED)
    assert second.best.x == pytest.approx(np.linalg.solve(np.eye(unknowns) - matrix, offset[1]), rel=1e-6)


@pytest.mark.parametrize("unknowns", [1, 3])
@given(pairs=st.lists(st.lists(st.floats(-1e6, 1e6), min_size=6, max_size=6), max_size=3))
def test_secants__wrong_ones_do_not_prevent_a_solution(unknowns: int, pairs: list[list[float]]) -> None:
    """Those of an unlike function, without a change, or that depend on each other."""
    secants = tuple((np.array(pair[:unknowns]), np.array(pair[3 : 3 + unknowns])) for pair in pairs)
    function = problem(lambda x: 0.5 * np.sin(x) + 1.0, unknowns=unknowns, low=-5.0, high=5.0, limit=40)
    solution = solve(function, np.zeros(unknowns), secants=secants)
    assert solution.is_solved
    assert solution.best.residual == pytest.approx(np.zeros(unknowns), abs=1e-9)


def test_secants__unsolved_problem_has_none_and_a_start_that_is_solved_keeps_its_own() -> None:
    secants = ((np.array([1.0]), np.array([-0.5])),)
    assert solve(problem(lambda x: -5.0 * x + 1.0, limit=2), np.array([0.3]), secants=secants).secants == ()
    assert solve(problem(lambda x: x), np.array([0.3]), secants=secants).secants == secants
