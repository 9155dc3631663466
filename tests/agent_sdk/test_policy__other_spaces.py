"""Spaces on which a model was not trained are described in one line, also where the dimensions have no names."""

import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete, Space

pytest.importorskip("stable_baselines3")

from zenostat.agent_sdk.controllers.predictor import describe_difference

WIDE = Box(np.array([-1, 0], np.float32), np.array([1, 3], np.float32))


@pytest.mark.parametrize(
    ("trained", "current", "names", "text"),
    [
        (Box(-1, 1, (23,)), Box(-1, 1, (53,)), (), "23 of them, now 53"),
        (Box(-1, 1, (1,)), Box(-1, 1, (2,)), ("heat", "cool"), "1 of them, now 2: heat, cool"),
        (Box(-1, 1, (2,)), WIDE, (), "number 1 was -1 to 1, now 0 to 3"),
        (Box(-1, 1, (2,)), WIDE, ("heat", "cool"), "cool was -1 to 1, now 0 to 3"),
        (Discrete(3), Discrete(5), (), "Discrete(3), now Discrete(5)"),
    ],
)
def test_policy__difference(trained: Space[object], current: Space[object], names: tuple[str, ...], text: str) -> None:
    assert describe_difference(trained, current, names) == text
