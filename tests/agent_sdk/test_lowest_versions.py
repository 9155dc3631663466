"""constraints-lowest.txt has the lowest versions that pyproject.toml allows, and the packages import with them."""

import importlib
import pkgutil
import re
import tomllib
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import SyncVectorEnv

import zenostat
from zenostat import wrappers
from zenostat.agent_sdk.testing import FakeEnv
from zenostat.topics.errors import InvalidConfig

ROOT = Path(__file__).parents[2]
PACKAGES = tuple(link.name for link in (ROOT / "src" / "zenostat").iterdir() if link.is_symlink())


def normal(name: str) -> str:
    return name.lower().replace("_", "-")


def test_lowest_versions__constraints_are_the_lower_bounds() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    asked = [*project["dependencies"], *(one for extra in project["optional-dependencies"].values() for one in extra)]
    bounds = dict(re.findall(r"^([\w-]+)(?:\[\w+\])?[>=]=([\d.]+)", "\n".join(asked), re.MULTILINE))
    lines = re.findall(r"^([\w-]+)==([\d.]+)$", (ROOT / "constraints-lowest.txt").read_text(), re.MULTILINE)
    pinned = {normal(name): version for name, version in lines}
    assert sorted(pinned) == sorted(map(normal, bounds))
    for name, bound in bounds.items():
        assert f"{pinned[normal(name)]}.".startswith(f"{bound}."), name


@pytest.mark.parametrize("package", PACKAGES)
def test_lowest_versions__every_module_imports(package: str) -> None:
    # The walk imports packages once more, after the body of the loop has.
    for module in pkgutil.walk_packages([str(ROOT / package)], f"zenostat.{package}.", onerror=lambda _: None):
        if module.name.endswith("__main__"):
            continue
        try:
            importlib.import_module(module.name)
        except InvalidConfig as error:
            if "pip install" not in str(error):
                raise  # else an extra that is not installed
        except ModuleNotFoundError as error:
            if f"{error.name}".startswith("zenostat"):
                raise


def test_lowest_versions__wrappers_of_both_kinds_go_around_vectors() -> None:
    chain = [
        {"wrapper": "CyclicTime", "fields": ["hour"]},
        {"wrapper": "RescaleAction", "min_action": -1.0, "max_action": 1.0},
    ]
    settings = {"zones": 1, "steps_per_hour": 1, "time": ("hour",)}
    for env in (
        SyncVectorEnv([lambda: FakeEnv(**settings)] * 2),
        gym.make_vec("zenostat/Fake-v1", num_envs=2, **settings),
    ):
        wrapped = wrappers.apply_wrappers(env, chain)
        assert wrapped.reset(seed=0)[0].shape == wrapped.observation_space.shape
        observations, *_ = wrapped.step(np.zeros(wrapped.action_space.shape, np.float32))
        assert observations.shape == wrapped.observation_space.shape
        wrapped.close()


def test_lowest_versions__command_line_imports() -> None:
    assert Path(zenostat.__file__).parent == ROOT / "src" / "zenostat"
    assert importlib.import_module("zenostat.cli.main").main is not None
