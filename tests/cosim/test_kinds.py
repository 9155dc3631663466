"""Kinds of plants in a district's file that other tests do not have: an FMU, in a loop that is solved by its copies."""

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from support.fmus import build_tank

import zenostat  # noqa: F401  # registers the environments

pytest.importorskip("fmpy")

DISTRICT = """name: heated
plants:
  tank: {{fmu: {file}}}
connections:
  - {{from: tank.T, to: tank.heat, unit: degC, factor: -20, offset: 2000, solve: true, tolerance: 0.01}}
"""


@pytest.mark.slow
def test_district__fmu_is_solved_and_copied(scratch: Path) -> None:
    """The heat belongs to the temperature at the end of the same step; a snapshot goes on to the bit."""
    tank = build_tank(scratch)
    (scratch / "district.yaml").write_text(DISTRICT.format(file=tank.name))
    with gym.make("zenostat/District-v1", file=scratch / "district.yaml", reward=None) as created:
        env = created.unwrapped
        env.reset(seed=1)
        action = np.zeros(env.action_space.shape, np.float32)
        action = np.clip(action, env.action_space.low, env.action_space.high)
        env.step(action)
        with env.snapshot() as snapshot:
            rows = []
            for _ in range(2):
                env.reset(options={"snapshot": snapshot})
                for _ in range(3):
                    env.step(action)
                    sample = env.sample
                    heat = sample["exchange.tank.T-tank.heat"]
                    assert sample["loop.tank.solved"] == 1.0
                    assert heat == pytest.approx(2000.0 - 20.0 * sample["tank.T"], abs=0.01)
                    rows.append(sample.message.values)
            assert rows[:3] == rows[3:]
