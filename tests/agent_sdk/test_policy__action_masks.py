"""A model that takes action masks is evaluated with those of its environment, or refused where there are none."""

from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("sb3_contrib")

from sb3_contrib import MaskablePPO
from sb3_contrib.common.wrappers import ActionMasker

from zenostat.agent_sdk.controllers.policy_loader import load_policy
from zenostat.agent_sdk.testing import FakeEnv
from zenostat.agent_sdk.wrappers import save_wrappers
from zenostat.lab.training import EvaluationCallback, evaluate_model
from zenostat.topics.errors import InvalidConfig

pytestmark = pytest.mark.usefixtures("one_torch_thread")

DAY: dict[str, Any] = {"steps_per_hour": 1, "control": "building", "discrete": 5}


class ActionRecorder(gym.Wrapper[Any, Any, Any, Any]):
    """Records the actions of all episodes."""

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        self.actions: list[int] = []

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        self.actions.append(int(action))
        return self.env.step(action)


def masked() -> Any:
    """Allow one action in each step: the step's number modulo 5."""
    return ActionMasker(ActionRecorder(FakeEnv(**DAY)), lambda env: np.arange(5) == env.unwrapped.sample.step % 5)


def test_evaluate_model__acts_within_the_masks_of_the_environment() -> None:
    with closing(masked()) as env, closing(masked()) as evaluation:
        model = MaskablePPO("MlpPolicy", env, n_steps=24, batch_size=24, n_epochs=1, device="cpu", seed=0)
        model.learn(24, callback=EvaluationCallback(lambda: evaluation, every=24))
        assert evaluation.env.actions == [step % 5 for step in range(24)]
        evaluate_model(model, env, episodes=2)
        assert env.env.actions[-48:] == [step % 5 for step in range(24)] * 2


def test_policy__model_that_takes_action_masks_is_refused_without_them(tmp_path: Path) -> None:
    """A node has no masks, nor have wrappers that can be written as data."""
    file = tmp_path / "model.zip"
    with closing(masked()) as env, closing(FakeEnv(**DAY)) as bare:
        model = MaskablePPO("MlpPolicy", env, device="cpu")
        model.save(file)
        refused = r"a model of MaskablePPO needs the masks .* has no method action_masks\(\); .*evaluate_model\(model"
        with pytest.raises(InvalidConfig, match=refused):
            evaluate_model(model, bare)
        with pytest.raises(InvalidConfig, match=refused):
            load_policy(file, MaskablePPO)(bare.manifest)
        save_wrappers(gym.wrappers.FrameStackObservation(bare, 2), tmp_path / "model.wrappers.yaml")
        timed = ActionMasker(gym.wrappers.FrameStackObservation(bare, 2), lambda _: np.ones(5, bool))
        MaskablePPO("MlpPolicy", timed, device="cpu").save(file)
        with pytest.raises(InvalidConfig, match=refused):
            load_policy(file, MaskablePPO)(bare.manifest)
        save_wrappers(timed, tmp_path / "model.wrappers.yaml")
        with pytest.raises(InvalidConfig, match="ActionMasker cannot be written as data"):
            load_policy(file, MaskablePPO)
