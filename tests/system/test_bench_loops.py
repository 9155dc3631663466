"""The benchmark of algebraic loops: a day of a building against a delay of one step."""

import json
import subprocess
from pathlib import Path

import pytest

from bench import programs


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
    assert solved["noticeable"] <= round(96 * solved["no_fixed_point"]) < 20
    assert by_scheme["delay, damping 1"]["travel_k"] > 5.0 * solved["travel_k"]
