"""The names that `agent_sdk` offers, and the modules that importing it loads."""

from __future__ import annotations

import subprocess
import sys

import pytest

import agent_sdk

HEAVY = ("rerun", "pyenergyplus", "torch", "stable_baselines3", "matplotlib", "pettingzoo", "pandas")


@pytest.mark.parametrize("name", agent_sdk.__all__)
def test_each_name_is_offered(name: str) -> None:
    assert getattr(agent_sdk, name) is not None
    assert name in dir(agent_sdk)


def test_an_unknown_name_is_no_attribute() -> None:
    with pytest.raises(AttributeError, match="module 'agent_sdk' has no attribute 'mak'"):
        _ = agent_sdk.mak


def test_importing_the_package_loads_no_environments() -> None:
    program = "import sys, agent_sdk; print(*sorted(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.split()
    assert not [module for module in loaded if module.split(".")[0] in HEAVY]
    assert not [module for module in loaded if module.startswith("agent_sdk.envs.")]
