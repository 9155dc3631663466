"""The names that `zenostat` offers, and the modules that importing it loads."""

import pytest
from support.run_cli import run_python

import zenostat

HEAVY = ("rerun", "pyenergyplus", "torch", "stable_baselines3", "matplotlib", "pettingzoo", "pandas")


@pytest.mark.parametrize("name", zenostat.__all__)
def test_package__each_name_is_offered(name: str) -> None:
    assert getattr(zenostat, name) is not None
    assert name in dir(zenostat)


def test_package__unknown_name_is_no_attribute() -> None:
    with pytest.raises(AttributeError, match="module 'zenostat' has no attribute 'mak'"):
        _ = zenostat.mak


def test_package__importing_the_package_loads_no_environments() -> None:
    program = "import sys, zenostat; print(*sorted(sys.modules))"
    loaded = run_python("-c", program, check=True).stdout.split()
    assert not [module for module in loaded if module.split(".")[0] in HEAVY]
    assert not [module for module in loaded if module.startswith("zenostat.agent_sdk.")]
