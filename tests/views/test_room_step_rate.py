"""The rate at which a node simulates, from polls that are not aligned with its timesteps."""

import numpy as np
import pytest

from zenostat.views.room.step_rate import StepRate


def polled(
    rate: StepRate, step_at: list[float], *, until_s: float, step_s: float, pace_s: float = 0.0
) -> list[float | None]:
    """Return the rate at each poll of a node whose step k begins at `step_at[k]`."""
    rates = []
    for now_s in np.arange(0.0, until_s, 0.5).tolist():
        rate.add(now_s, 1, int(np.searchsorted(step_at, now_s, side="right")) - 1, pace_s=pace_s)
        rates.append(rate.rate(now_s, step_s))
    return rates


@pytest.mark.parametrize("speed", [1.0, 60.0, 90.0, 900.0])
def test_step_rate__of_a_paced_node_is_its_speed_whatever_the_length_of_a_step(speed: float) -> None:
    every_s = 900.0 / speed
    begins = [every_s * k - 0.1 for k in range(8)]
    rates = polled(StepRate(), begins, until_s=7 * every_s, step_s=900.0, pace_s=every_s)
    assert rates[: int(2 * every_s)].count(None) > 0
    known = [value for value in rates if value is not None]
    assert len(known) > len(rates) / 2
    assert known == pytest.approx([speed] * len(known), rel=0.5 / 5.0)  # the window is a poll longer or shorter


def test_step_rate__of_a_fast_node_counts_all_its_steps() -> None:
    rates = polled(StepRate(), [0.001 * k for k in range(30_000)], until_s=29.0, step_s=900.0)
    assert rates[-1] == pytest.approx(900.0 / 0.001)


def test_step_rate__of_a_paused_node_is_0_and_afterwards_that_of_new_steps() -> None:
    before, after = [float(k) for k in range(10)], [100.0 + 2.0 * k for k in range(10)]
    rates = polled(StepRate(), before + after, until_s=118.0, step_s=60.0)
    assert rates[2 * 9] == pytest.approx(60.0)
    assert set(rates[2 * 15 : 2 * 100]) == {0.0}
    assert rates[2 * 100 : 2 * 102] == [None] * 4
    assert rates[2 * 102 :] == pytest.approx([30.0] * len(rates[2 * 102 :]))


def test_step_rate__is_0_as_soon_as_the_node_says_that_it_is_paused() -> None:
    """Real time with steps of 15 min: without its word, a pause shows after half an hour."""
    rate = StepRate()
    for step in range(3):
        rate.add(900.0 * step, 1, step, pace_s=900.0)
    assert rate.rate(1800.0, 900.0) == pytest.approx(1.0)
    rate.add(1801.0, 1, 2, is_stopped=True)
    assert rate.rate(1801.0, 900.0) == 0.0
    for now_s, step in ((2000.0, 2), (2500.0, 3)):
        rate.add(now_s, 1, step, pace_s=900.0)
        assert rate.rate(now_s, 900.0) is None
    rate.add(3400.0, 1, 4, pace_s=900.0)
    assert rate.rate(3400.0, 900.0) == pytest.approx(1.0)


@pytest.mark.parametrize(("pace_s", "stalled_s"), [(0.0, 5.0), (900.0, 1800.0)])
@pytest.mark.parametrize("begins", [[0.0], [0.0, 1.0]])
def test_step_rate__of_a_node_that_waits_from_the_first_poll_on_is_0(
    pace_s: float, stalled_s: float, begins: list[float]
) -> None:
    """Such as one in lockstep without a controller; of a paced one it is not known before its pace has passed twice."""
    rates = polled(StepRate(), begins, until_s=2000.0, step_s=900.0, pace_s=pace_s)
    first = int(2 * (begins[-1] + stalled_s)) + 1
    assert set(rates[:first]) == {None}
    assert set(rates[first:]) == {0.0}


def test_step_rate__of_an_unpaced_node_with_long_timesteps_is_that_of_its_changes() -> None:
    rates = polled(StepRate(), [20.0 * k - 0.1 for k in range(8)], until_s=150.0, step_s=900.0)
    assert set(rates[:80]) == {None, 0.0}  # until the second change
    assert rates[80:] == pytest.approx([45.0] * len(rates[80:]), rel=0.5 / 20.0)


def test_step_rate__begins_anew_with_an_episode() -> None:
    rate = StepRate()
    for now_s, episode, step in ((0.0, 1, 7), (1.0, 1, 8), (2.0, 1, 9), (3.0, 2, 0)):
        rate.add(now_s, episode, step)
    assert rate.rate(3.0, 60.0) is None
    rate.add(4.0, 2, 1)
    assert rate.rate(4.0, 60.0) == pytest.approx(60.0)
