"""Warnings of a new environment, and of a comparison about a controller that it skips."""

import json
from contextlib import closing
from pathlib import Path

import gymnasium as gym
import pytest
from support.nodes import SMALL

from zenostat.agent_sdk.controllers.oracle import OracleController
from zenostat.agent_sdk.controllers.pid import PIDController
from zenostat.agent_sdk.controllers.rule_based import RuleBasedController
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.agent_sdk.testing import FakeEnv
from zenostat.lab.evaluate import _create_controllers
from zenostat.models.building.model import read_building
from zenostat.models.catalog import find_building
from zenostat.topics.errors import UsageError

PLANT = """
class Room:
    step_s = 900.0
    steps = 4
    sensors = {"temp": "degC"}
    actuators = {"heater": ("W", 0.0, 1000.0)}

    def reset(self, seed):
        self.temp = 20.0
        return {"temp": self.temp}

    def step(self, commands):
        self.temp += (commands["heater"] or 0.0) / 1000.0
        return {"temp": self.temp}
"""


@pytest.mark.slow
def test_env__plant_without_a_reward_states_that_it_pays_nothing(
    tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    (tmp_path / "room.py").write_text(PLANT)
    plant = f"{tmp_path}/room.py:Room"
    with pytest.warns(UserWarning, match=r"room has no reward, so every step pays 0\.0; pass reward="):
        gym.make("zenostat/Plant-v1", plant=plant).close()
    gym.make("zenostat/Plant-v1", plant=plant, reward=None).close()
    gym.make("zenostat/Plant-v1", plant=plant, reward=lambda values, begin: 1.0).close()
    assert not [warning for warning in recwarn if "has no reward" in str(warning.message)]


@pytest.mark.slow
def test_env__model_without_a_run_period_states_that_it_simulates_a_year(scratch: Path) -> None:
    objects = dict(read_building(find_building("ref-small-office")).objects)
    del objects["RunPeriod"]
    file = scratch / "office.epJSON"
    file.write_text(json.dumps(objects))
    weather = SMALL["weather"]
    with (
        pytest.warns(UserWarning, match="no RunPeriod, so an episode is a whole year; choose begin and end"),
        pytest.warns(UserWarning, match="simulates its sizing periods only; an episode simulates the weather file"),
        closing(BuildingEnv(file, weather, affinity="off")) as env,
    ):
        assert env.manifest.begin[5:10] == "01-01"
    with closing(BuildingEnv(file, weather, begin="07-03", end="07-03", affinity="off")) as env:
        assert not env.manifest.warnings


def test_env__controller_without_a_needed_parameter_is_skipped_and_the_others_run() -> None:
    unfit: dict[str, UsageError] = {}
    with closing(FakeEnv()) as env:
        factories = {"pid": PIDController, "rbc": RuleBasedController}
        created = _create_controllers(factories, env, {"pid": {}, "rbc": {}}, unfit)
    assert list(created) == ["rbc"]
    assert "needs setpoint: --set setpoint=" in str(unfit["pid"])


def test_env__oracle_is_skipped_without_a_reward() -> None:
    unfit: dict[str, UsageError] = {}
    with closing(FakeEnv(reward=None)) as env:
        created = _create_controllers(
            {"oracle": OracleController, "rbc": RuleBasedController}, env, {"oracle": {}, "rbc": {}}, unfit
        )
    assert list(created) == ["rbc"]
    assert "needs a reward" in str(unfit["oracle"])
