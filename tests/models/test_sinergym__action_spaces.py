"""Sinergym's action spaces are read as data."""

import pytest

from zenostat.models.sinergym.literals import BoxSpec, DiscreteSpec, MultiDiscrete, read_space
from zenostat.topics.errors import InvalidConfig


@pytest.mark.parametrize(
    ("text", "means"),
    [
        ("Discrete(10)", DiscreteSpec(10)),
        ("gym.spaces.Discrete(n=10)", DiscreteSpec(10)),
        ("gymnasium.spaces.MultiDiscrete(nvec=np.array([2, 21]))", MultiDiscrete((2, 21))),
        ("spaces.MultiDiscrete([2, 3], dtype=np.int64)", MultiDiscrete((2, 3))),
        ("gym.spaces.Box(low=np.array([-1.5]), high=np.array([+2], dtype='float32'))", BoxSpec((-1.5,), (2.0,))),
        ("Box(0, 1, (3,), np.float32)", BoxSpec((0.0,) * 3, (1.0,) * 3)),
        ("Box(low=[0, 1], high=(2, 3))", BoxSpec((0.0, 1.0), (2.0, 3.0))),
        ("Box(low=numpy.array([0]), high=array([1]), shape=(1,))", BoxSpec((0.0,), (1.0,))),
    ],
)
def test_sinergym__space_is_read(text, means):
    assert read_space(text) == means


@pytest.mark.parametrize(
    "text",
    [
        "",
        "1",
        "a = Discrete(2)",
        "Discrete(2); Discrete(3)",
        "Discrete",
        "Discrete()",
        "Discrete(0)",
        "Discrete(2.5)",
        "Discrete(True)",
        "Discrete(2, start=1)",
        "Discrete(5 + 5)",
        "Discrete(n)",
        "Discrete(*[2])",
        "Discrete(**{'n': 2})",
        "other.Discrete(2)",
        "Text(5)",
        "MultiDiscrete([])",
        "MultiDiscrete([2, 0])",
        "MultiDiscrete(2)",
        "Box(low=0, high=1)",
        "Box(low=0, high=1, shape=(2, 2))",
        "Box(low=[0], high=[1, 2])",
        "Box(low=[0], high=[1], shape=(2,))",
        "Box(low=[1], high=[0])",
        "Box(low=[0], high=[1e999])",
        "Box(low=[0], high=[np.inf])",
        "Box(low=['0'], high=['1'])",
        "Box(low=[0], high=[1], dtype=print)",
        "Box(low=np.zeros(2), high=np.ones(2))",
        "Box(low=[x for x in range(2)], high=[1, 1])",
        "Box(low=[0], high=[1], low=[2])",
        "Discrete(" + "(" * 5000,
        *("Discrete(" + "-" * count + "1)" for count in (3, 200, 2_000, 100_000)),
    ],
    ids=lambda text: text[:60],
)
def test_sinergym__anything_else_is_no_space(text):
    with pytest.raises(InvalidConfig):
        read_space(text)
