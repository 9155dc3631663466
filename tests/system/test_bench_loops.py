"""The benchmark of algebraic loops: its solver, and a day of a building against a delay of one step."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from bench import loops, programs

LOW, HIGH = 20.0, 30.0


FUNCTIONS: dict[str, Callable[[float], float]] = {
    "constant": lambda _: 24.0,
    "linear": lambda x: 24.0 - 0.8 * (x - 21.0),
    "steep": lambda x: 25.0 - 6.0 * (x - 25.0),
    "quadratic": lambda x: 20.0 + 0.1 * (30.0 - x) ** 2,
    "upper bound": lambda _: 99.0,
    "lower bound": lambda _: 0.0,
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_solve__ends_at_a_fixed_point(name: str) -> None:
    def bounded(x: float) -> float:
        return min(max(FUNCTIONS[name](x), LOW), HIGH)

    for start in (LOW, 23.0, HIGH):
        x, trials, outcome = loops.solve(bounded, start, LOW, HIGH)
        assert (outcome, trials <= loops.LIMIT) == ("solved", True)
        assert abs(bounded(x) - x) <= loops.TOLERANCE_K


def test_solve__jump_has_no_fixed_point() -> None:
    """A stage that switches at 25.3 degC: the setpoint is above it with the stage and below it without."""
    for start in (LOW, 25.0, HIGH):
        x, trials, outcome = loops.solve(lambda x: 27.0 if x < 25.3 else 22.0, start, LOW, HIGH)
        assert (outcome, trials <= loops.LIMIT) == ("jump", True)
        assert LOW <= x <= HIGH


@pytest.mark.slow
def test_loops__solved_day_of_the_small_office(scratch: Path) -> None:
    """Delays of one step leave residuals of kelvins; trials leave them only where there is no fixed point."""
    done = subprocess.run(
        programs.command("loops", "office-small", "3.0"),
        env=programs.environment(), capture_output=True, text=True, check=True,
    )  # fmt: skip
    by_scheme = json.loads(done.stdout.splitlines()[-1])["3.0"]
    solved = by_scheme.pop("solved by trials")
    assert all(delayed["mean_k"] > 20.0 * solved["mean_k"] for delayed in by_scheme.values())
    assert solved["unsolved"] == 0.0
    assert solved["noticeable"] <= 96 * solved["no_fixed_point"] <= 96 * 0.2
    assert by_scheme["delay, damping 1"]["travel_k"] > 5.0 * solved["travel_k"]
