"""Minimum of a quadratic function within bounds, by an active set."""

from __future__ import annotations

import numpy as np

from zenostat.topics.arrays import Floats

_SINGULAR = 1e-9
"""Ratio of singular values below which a direction has no effect."""
_ROUNDS = 20
"""Rounds for each variable, at most; each lowers the function, and few are needed."""


def bounded_minimum(curvature: Floats, gradient: Floats, low: Floats, high: Floats) -> Floats:
    """Return x with low <= x <= high that minimizes x' curvature x / 2 - gradient' x.

    The minimum of the free variables is approached until one of them meets its bound, where it stays as long as the
    function falls beyond (C. L. Lawson and R. J. Hanson, Solving Least Squares Problems, 1974, chapter 23).

    Args:
        curvature: symmetric matrix without negative eigenvalues, shape (variables, variables).
        gradient: negative gradient at 0, shape (variables,).
        low: lower bounds, at most 0, shape (variables,).
        high: upper bounds, at least 0, shape (variables,).
    """
    x = np.zeros(len(gradient))
    is_free = np.ones(len(gradient), bool)
    for _ in range(_ROUNDS * len(gradient)):
        if is_free.any():
            target = x.copy()
            pull = gradient[is_free] - curvature[np.ix_(is_free, ~is_free)] @ x[~is_free]
            inverse = np.linalg.pinv(curvature[np.ix_(is_free, is_free)], rcond=_SINGULAR, hermitian=True)
            target[is_free] = inverse @ pull
            share, met = _until_bound(x, target, low, high)
            x = np.clip(x + share * (target - x), low, high)
            if met is not None:
                x[met] = low[met] if target[met] < x[met] else high[met]
                is_free[met] = False
                continue
        slope = gradient - curvature @ x
        inward = np.where(x <= low, slope, np.where(x >= high, -slope, 0.0))
        inward[is_free] = 0.0
        released = int(np.argmax(inward))
        if inward[released] <= 1e-12 * max(float(np.abs(gradient).max()), 1e-300):
            break
        is_free[released] = True
    return x


def _until_bound(x: Floats, target: Floats, low: Floats, high: Floats) -> tuple[float, int | None]:
    """Return the share of the way to a target within the bounds, and the variable that meets its bound there."""
    share, met = 1.0, None
    for place, (begin, end) in enumerate(zip(x, target, strict=True)):
        bound = low[place] if end < low[place] else high[place] if end > high[place] else None
        if bound is not None:
            part = float((bound - begin) / (end - begin))
            if met is None or part < share:
                share, met = max(part, 0.0), place
    return share, met
