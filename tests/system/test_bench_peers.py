"""The loop of the benchmark `peers`: HELICS, mosaik and a district find the setpoint that a hand solution has."""

from __future__ import annotations

from math import sqrt
from typing import Any

import pytest

from bench import peers
from bench.peers import Kind, model

STEPS = 40
"""Ten hours: of the night, in which the lower bound holds, and of the day."""

TOOLS: dict[str, tuple[str, dict[str, Any]]] = {
    "HELICS": ("iterate", {"core": "tcp"}),
    "mosaik": ("iterate", {"place": "together"}),
    "district": ("solve", {"law": "connection"}),
}


def hand_solution(temperature: float, step: int, gain: float) -> float:
    """Solve the loop of a step without iteration: power is quadratic in the cooling Q, and Q linear in the setpoint S.

    Q = a - b S and S = m + g (p Q + q Q^2) give b g q Q^2 + (1 + b g p) Q + b m - a = 0.
    """
    inflow = 2e7 / 900.0 * temperature + 400.0 * model.outdoor_degc(step) + model.gains_w(step)
    total = 2e7 / 900.0 + 400.0 + 3000.0
    a, b = 3000.0 * inflow / total, 3000.0 * (1.0 - 3000.0 / total)
    m, p, q = 24.0 - 2.0 * gain, 1.0 / 3000.0, 0.3 / 1e4 / 3000.0
    square, linear, rest = b * gain * q, 1.0 + b * gain * p, b * m - a
    cooling = (-linear + sqrt(linear**2 - 4.0 * square * rest)) / (2.0 * square)
    return min(max(m + gain * (p * cooling + q * cooling**2), 22.5), 30.0)


def simulated(tool: str, gain: float, damping: float = 1.0) -> model.Day:
    if not Kind(tool, "delay").is_installed:
        pytest.skip(f"{tool} is not installed: {peers.install_command('bench')}")
    scheme, options = TOOLS[tool]
    return peers.run(Kind(tool, scheme, gain, damping, options), STEPS)


@pytest.mark.slow
@pytest.mark.process
@pytest.mark.parametrize(("gain", "damping"), [(0.5, 1.0), (1.5, 0.5)])
@pytest.mark.parametrize("tool", TOOLS)
def test_peers__converge_to_the_hand_solution(tool: str, gain: float, damping: float) -> None:
    day = simulated(tool, gain, damping)
    temperature = model.START_DEGC
    assert len(day.setpoints) == STEPS
    for step, (setpoint, power) in enumerate(zip(day.setpoints, day.powers, strict=True), 1):
        assert setpoint == pytest.approx(hand_solution(temperature, step, gain), abs=model.TOLERANCE_K)
        tried, temperature = model.office(temperature, step, setpoint)
        assert power == tried
    assert max(peers.residuals(day, gain)) <= model.TOLERANCE_K


@pytest.mark.slow
@pytest.mark.process
@pytest.mark.parametrize("tool", ["HELICS", "mosaik"])
def test_peers__substitution_does_not_converge_with_the_gain_of_the_table(tool: str) -> None:
    day = simulated(tool, 1.5)
    assert day.evaluations > 5 * STEPS
    assert max(peers.residuals(day, 1.5)) > 1.0


@pytest.mark.slow
@pytest.mark.process
@pytest.mark.parametrize("tool", ["HELICS", "mosaik", "district"])
@pytest.mark.parametrize("law", ["plant", "connection"])
def test_peers__exchange_of_all_tools_is_a_step_late(tool: str, law: str) -> None:
    """The setpoint is that of the power of the step before, to the bit."""
    if tool != "district" and law == "plant":
        return
    if not Kind(tool, "delay").is_installed:
        pytest.skip(f"{tool} is not installed: {peers.install_command('bench')}")
    options = {**TOOLS[tool][1], "law": law}
    day = peers.run(Kind(tool, "delay", options=options), STEPS)
    setpoint, temperature = model.MIDDLE_DEGC, model.START_DEGC
    for step in range(1, STEPS + 1):
        assert day.setpoints[step - 1] == pytest.approx(setpoint, rel=1e-14)
        power, temperature = model.office(temperature, step, day.setpoints[step - 1])
        assert day.powers[step - 1] == power
        setpoint = model.law(power, 1.5)
