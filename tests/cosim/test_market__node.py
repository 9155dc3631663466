"""A market among plants in processes: recorded, verified to the bit, and returned to."""

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from support.district_files import write_district

import zenostat  # noqa: F401  # registers the environments
from zenostat.cosim.verify_recording import verify_district

DISTRICT = """name: trade
plants:
  market: {market: {low: 0.0, high: 1.0, limit_w: 7000, rounds: 8, tolerance_w: 1, bidders: [
    {demand: east.draw}, {demand: west.draw}]}}
  east: {plant: "plants.py:House"}
  west: {plant: "plants.py:House", plant_arguments: {residents_w: 900.0}}
connections:
  - {from: market.price, to: east.heater, unit: EUR/kWh, factor: -4000, offset: 4000}
  - {from: market.price, to: west.heater, unit: EUR/kWh, factor: -2000, offset: 4000}
"""


@pytest.mark.slow
def test_market__is_verified_and_returned_to_to_the_bit(scratch: Path) -> None:
    """Ten steps in which 8000 W less 6000 W for each unit of price, and the residents, are kept below 7000 W."""
    file, record = write_district(scratch, DISTRICT), scratch / "trade.mcap"
    with gym.make("zenostat/District-v1", file=file, reward=None, record=record) as created:
        env = created.unwrapped
        env.reset(seed=1)
        action = np.zeros(env.action_space.shape, np.float32)  # there are none: the price sets all
        for _ in range(3):
            env.step(action)
        with env.snapshot() as snapshot:
            rows = []
            for _ in range(2):
                env.reset(options={"snapshot": snapshot})
                for _ in range(4):
                    env.step(action)
                    sample = env.sample
                    assert sample["market.cleared"] == 1.0
                    assert 6999.0 <= sample["market.demand"] == sample["market.cleared_demand"] <= 7000.0
                    rows.append(sample.message.values)
            assert rows[:4] == rows[4:]
        env.reset(seed=2)
        for _ in range(10):
            env.step(action)
    result = verify_district(record, file)
    assert result.passed, str(result)
    assert result.steps >= 10
