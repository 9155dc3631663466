"""Solvers of algebraic loops: a fixed point x = G(x), where each evaluation of G is a trial step of plants.

One unknown is solved by secants, kept within a bracket as soon as there is one. Several are solved by Anderson
acceleration (J. ACM 12, 547-560, 1965; type II of Fang and Saad, Numer. Linear Algebra Appl. 16, 197-221, 2009), with
damping where it diverges. An evaluation is expensive and a plant may respond with a jump, so each solver keeps its best
trial and ends after a number of trials.

The response of plants changes little from a step to the next one. So a solution has the secants of its trials (changes
of the unknowns and of the residual), and the next step begins with them: its second trial is already a secant step.

Sums are exact (`math.fsum`), so equal evaluations have equal results to the bit, on any machine.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from math import copysign, fsum, inf, isfinite, sqrt

import numpy as np

from zenostat.topics.arrays import Floats

Function = Callable[[Floats], Floats]
"""G: the values that plants return for the unknowns; both of shape (unknowns,)."""

_JUMP = 0.1
"""Width of a bracket, relative to the tolerance, in which a change of sign without a solution counts as a jump."""
_GROWTH = 10.0
"""Greatest step of a secant, relative to the previous one, while there is no bracket. A slope of an earlier problem is
used between its negative and the reciprocal of that."""
_DIVERGED = 2.0
"""Ratio to the least error at which Anderson acceleration starts again from its trial, with half the damping."""
_LEAST_DAMPING = 1.0 / 64.0
_ROUNDING = 16.0
"""Rounding error that a residual may have from the operations of its plants, in spacings of numbers at the unknown."""
_DEPENDENT = 1e-10
"""Columns whose norm falls below this part of itself, when made orthogonal to the others, are left out."""


Secants = tuple[tuple[Floats, Floats], ...]
"""Pairs of a change of the unknowns and the change of the residual with it, the latest last."""


class Outcome(StrEnum):
    """Result of a solver.

    `SOLVED`: the residual is within the tolerance. `JUMP`: the residual changes its sign within a tenth of the
    tolerance, but is nowhere within it, so there is no fixed point. `LIMIT`: the limit of trials was reached.
    `UNDEFINED`: G has no value (NaN or infinity) in a trial.
    """

    SOLVED = "solved"
    JUMP = "jump"
    LIMIT = "limit"
    UNDEFINED = "undefined"


@dataclass(frozen=True, slots=True)
class Trial:
    """An evaluation of G.

    Attributes:
        x: the unknowns, shape (unknowns,).
        residual: G(x) - x, of the same shape.
        error: largest ratio of a residual to its tolerance; NaN or infinity where G has no value.
        rounding: part of `error` that the rounding of numbers as large as the unknowns may hide.
    """

    x: Floats
    residual: Floats
    error: float
    rounding: float


@dataclass(frozen=True, slots=True)
class Solution:
    """The best trial of a solver.

    Attributes:
        best: the trial with the smallest error; of those that differ by no more than rounding, the first.
        trials: number of evaluations.
        outcome: why the solver ended.
        secants: of its trials, for the next problem; none unless it is solved.
        bracket: unknowns between which the residual changes its sign, the lower one first; None if there are none, or
            it is solved.
    """

    best: Trial
    trials: int
    outcome: Outcome
    secants: Secants = ()
    bracket: tuple[float, float] | None = None

    @property
    def is_solved(self) -> bool:
        """Whether the residual is within the tolerance."""
        return self.outcome is Outcome.SOLVED


@dataclass(frozen=True, slots=True)
class Problem:
    """A fixed point to find: x = G(x).

    Attributes:
        function: G.
        tolerance: greatest residual of each unknown, above 0, shape (unknowns,).
        low, high: bounds of the unknowns, which G respects as well; infinite where there are none.
        limit: greatest number of evaluations, 1 or more.
    """

    function: Function
    tolerance: Floats
    low: Floats
    high: Floats
    limit: int

    def evaluate(self, x: Floats) -> Trial:
        """Evaluate G once."""
        residual = self.function(x) - x
        error = float(np.max(np.abs(residual) / self.tolerance))
        return Trial(x, residual, error, _ROUNDING * float(np.max(np.spacing(np.abs(x)) / self.tolerance)))

    def clip(self, x: Floats) -> Floats:
        """Return the unknowns within their bounds."""
        return np.minimum(np.maximum(x, self.low), self.high)


class _Search:
    """The trials of a problem.

    The best one is better than those before it by more than its rounding. Far from the start, numbers are so large that
    a residual vanishes in their rounding: x + 0.3 equals x. So an error within the tolerance is a solution only if it
    is less than the best one by more than rounding has grown.

    Attributes:
        count: number of trials.
        latest: the latest trial.
        least: the trial with the least error.
        best: the best trial.
    """

    latest: Trial
    least: Trial
    best: Trial

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self.count = 0

    def attempt(self, x: Floats) -> Outcome | None:
        """Evaluate G; return why that ends the search, or None if it does not."""
        trial = self.latest = self._problem.evaluate(x)
        self.count += 1
        if self.count == 1:
            self.least = self.best = trial
        if not isfinite(trial.error):
            return Outcome.UNDEFINED
        gain = self.best.error - trial.error
        is_solved = trial.error <= 1.0 and (self.count == 1 or gain > trial.rounding - self.best.rounding)
        if is_solved or gain > trial.rounding:
            self.best = trial
        if trial.error < self.least.error:
            self.least = trial
        return Outcome.SOLVED if is_solved else None

    def end(self, outcome: Outcome, secants: Secants = (), bracket: tuple[float, float] | None = None) -> Solution:
        """Return the best trial, with secants if it is solved."""
        return Solution(self.best, self.count, outcome, secants if outcome is Outcome.SOLVED else (), bracket)


def solve(problem: Problem, start: Floats, *, depth: int = 3, damping: float = 1.0, secants: Secants = ()) -> Solution:
    """Solve x = G(x): one unknown in a bracket, several by Anderson acceleration.

    Args:
        problem: the fixed point to find.
        start: the first trial, shape (unknowns,).
        depth: number of previous trials that Anderson acceleration combines.
        damping: its relaxation factor, above 0 and at most 1.
        secants: of the solution of a similar problem.
    """
    if len(start) == 1:
        return solve_in_bracket(problem, start, secants)
    return solve_by_acceleration(problem, start, depth=depth, damping=damping, secants=secants)


# One unknown


@dataclass(frozen=True, slots=True)
class _End:
    """One end of a bracket: the sign of the residual is known, and its value if it was evaluated."""

    x: float
    sign: float
    residual: float | None = None


class _Bracket:
    """Two ends between which the residual changes its sign; none until such ends are known."""

    def __init__(self, low: float, high: float) -> None:
        self.ends: tuple[_End, _End] | None = None
        if isfinite(low) and isfinite(high):
            # G respects the bounds, so its residual is not negative at the lower and not positive at the upper one.
            self.ends = _End(low, 1.0), _End(high, -1.0)
        self._widths: list[float] = []

    @property
    def width(self) -> float:
        return inf if self.ends is None else abs(self.ends[1].x - self.ends[0].x)

    @property
    def is_evaluated(self) -> bool:
        return self.ends is not None and all(end.residual is not None for end in self.ends)

    @property
    def bounds(self) -> tuple[float, float] | None:
        """The ends, the lower one first, once both were evaluated."""
        if self.ends is None or not self.is_evaluated:
            return None
        low, high = sorted(end.x for end in self.ends)
        return low, high

    def narrow(self, point: _End, previous: _End | None) -> None:
        """Replace the end of the same sign by a point between the ends, or begin with it and the previous point."""
        if self.ends is not None:
            first, second = self.ends
            self.ends = (point, second) if first.sign == point.sign else (first, point)
        elif previous is not None and previous.sign != point.sign:
            self.ends = previous, point
        self._widths.append(self.width)

    def is_slow(self) -> bool:
        """Whether two trials have not halved the bracket."""
        return len(self._widths) >= 3 and self._widths[-1] > 0.5 * self._widths[-3]

    def admit(self, x: float) -> float:
        """Return a point between the ends: `x`, or else the middle; an end that was not evaluated is admitted."""
        if self.ends is None:
            return x
        left, right = sorted(self.ends, key=lambda end: end.x)
        if self.is_slow() or not isfinite(x):
            return 0.5 * (left.x + right.x)
        if x <= left.x:
            return left.x if left.residual is None else 0.5 * (left.x + right.x)
        if x >= right.x:
            return right.x if right.residual is None else 0.5 * (left.x + right.x)
        return x


def solve_in_bracket(problem: Problem, start: Floats, secants: Secants = ()) -> Solution:
    """Solve for one unknown: by secants, which a bracket keeps inside, and by its middle where they are slow.

    Without secants, the second trial is G of the first, so a function that does not depend on the unknown takes two. A
    linear one takes three, unless its solution is further than ten steps away, and two with its secant. Finite bounds
    are a bracket from the beginning.

    Args:
        problem: the fixed point to find.
        start: the first trial, shape (1,).
        secants: of the solution of a similar problem.
    """
    tolerance = float(problem.tolerance[0])
    search, bracket = _Search(problem), _Bracket(float(problem.low[0]), float(problem.high[0]))
    points: list[_End] = []
    x = float(problem.clip(start)[0])
    for _ in range(problem.limit):
        outcome = search.attempt(np.array([x]))
        residual = float(search.latest.residual[0])
        points.append(_End(x, copysign(1.0, residual), residual))
        if outcome is not None:
            return search.end(outcome, _latest_secant(points) or secants)
        bracket.narrow(points[-1], points[-2] if len(points) > 1 else None)
        if bracket.is_evaluated and bracket.width <= _JUMP * tolerance:
            return search.end(Outcome.JUMP, bracket=bracket.bounds)
        x = float(problem.clip(np.array([bracket.admit(_secant(bracket, points, secants))]))[0])
        if any(x == known.x for known in points):  # such as a bound outside of which the secant points
            return search.end(Outcome.JUMP if bracket.is_evaluated else Outcome.LIMIT, bracket=bracket.bounds)
    return search.end(Outcome.LIMIT, bracket=bracket.bounds)


def _latest_secant(points: list[_End]) -> Secants:
    if len(points) < 2:
        return ()
    first, second = points[-2:]
    assert first.residual is not None
    assert second.residual is not None
    return ((np.array([second.x - first.x]), np.array([second.residual - first.residual])),)


def _secant(bracket: _Bracket, points: list[_End], secants: Secants) -> float:
    """Return the zero of the line through the ends of the bracket, or through the last two points."""
    point = points[-1]
    assert point.residual is not None
    if len(points) == 1:
        return point.x - point.residual / _known_slope(secants)
    first, second = points[-2], point
    if bracket.is_evaluated:
        assert bracket.ends is not None
        first, second = bracket.ends
    assert first.residual is not None
    assert second.residual is not None
    slope = second.residual - first.residual
    if slope == 0.0:
        return point.x + point.residual
    x = second.x - second.residual * (second.x - first.x) / slope
    if bracket.ends is None:
        step = _GROWTH * max(abs(second.x - first.x), abs(point.residual))
        x = min(max(x, point.x - step), point.x + step)
    return x


def _known_slope(secants: Secants) -> float:
    """Return the slope of the residual in a similar problem; -1, that of a G which is constant, if it is of no use."""
    if not secants:
        return -1.0
    step, change = (float(part[0]) for part in secants[-1])
    slope = change / step if step else 0.0
    return slope if -_GROWTH <= slope <= -1.0 / _GROWTH else -1.0


# Several unknowns


def solve_by_acceleration(
    problem: Problem, start: Floats, *, depth: int = 3, damping: float = 1.0, secants: Secants = ()
) -> Solution:
    """Solve for several unknowns by Anderson acceleration, with less damping where it diverges.

    A linear function of n unknowns takes n + 2 trials at most, if `depth` is n or more and no bound is active, and two
    with n of its secants. Secants of a similar problem are older than those of the trials, and are left out as soon as
    the error grows.

    Args:
        problem: the fixed point to find.
        start: the first trial, shape (unknowns,).
        depth: number of previous trials that are combined, 0 or more; 0 is relaxation.
        damping: relaxation factor, above 0 and at most 1; it is halved where the error has doubled.
        secants: of the solution of a similar problem.
    """
    history: deque[Trial] = deque(maxlen=depth + 1)
    search = _Search(problem)
    x = problem.clip(start)
    for _ in range(problem.limit):
        outcome = search.attempt(x)
        trial, least = search.latest, search.least
        if outcome is not None:
            return search.end(outcome, _joined(secants, [*history, trial], depth))
        if secants and trial is not least:
            secants, trial = (), least
            history.clear()
        is_combined = len(history) > min(depth, len(start))  # before that, a linear function may diverge as well
        if is_combined and trial.error > _DIVERGED * least.error and damping > _LEAST_DAMPING:
            damping *= 0.5
            history.clear()
            trial = least
        history.append(trial)
        x = problem.clip(_combine(trial, _joined(secants, history, depth), problem.tolerance, damping))
        if secants and np.array_equal(x, trial.x):
            secants = ()
            x = problem.clip(_combine(trial, _joined((), history, depth), problem.tolerance, damping))
        if np.array_equal(x, trial.x):  # the bounds stop it
            return search.end(Outcome.LIMIT)
    return search.end(Outcome.LIMIT)


def _joined(secants: Secants, history: Iterable[Trial], depth: int) -> Secants:
    """Return the latest secants: those between trials, and before them those of a similar problem."""
    own = ((after.x - before.x, after.residual - before.residual) for before, after in pairwise(history))
    joined = (*secants, *own)
    return joined[max(len(joined) - depth, 0) :]


def _combine(latest: Trial, secants: Secants, tolerance: Floats, damping: float) -> Floats:
    """Return the next unknowns: those whose combined residual is least, moved by it."""
    weights = _least_squares([change / tolerance for _, change in secants], latest.residual / tolerance)
    x: Floats = latest.x + damping * latest.residual
    for weight, (step, change) in zip(weights, secants, strict=True):
        x = x - weight * (step + damping * change)
    return x


def _dot(a: Floats, b: Floats) -> float:
    return fsum((a * b).tolist())


def _least_squares(columns: list[Floats], target: Floats) -> list[float]:
    """Return the weights of columns whose sum is nearest to the target, by the modified Gram-Schmidt method.

    The latest column comes first; those that depend on it get the weight 0.
    """
    basis: list[tuple[int, Floats, float]] = []  # number of the column, its orthogonal part, and the square of its norm
    triangle: dict[tuple[int, int], float] = {}
    projections: dict[int, float] = {}
    rest = target
    for number in reversed(range(len(columns))):
        column = columns[number]
        norm = sqrt(_dot(column, column))
        for other, direction, square in basis:
            triangle[other, number] = _dot(direction, column) / square
            column = column - triangle[other, number] * direction
        square = _dot(column, column)
        if sqrt(square) <= _DEPENDENT * norm:
            continue
        projections[number] = _dot(column, rest) / square
        rest = rest - projections[number] * column
        basis.append((number, column, square))
    weights = [0.0] * len(columns)
    for position in reversed(range(len(basis))):
        number = basis[position][0]
        later = [triangle[number, other] * weights[other] for other, _, _ in basis[position + 1 :]]
        weights[number] = projections[number] - fsum(later)
    return weights
