"""Which tests start other processes: found from the code of the tests, their fixtures and the functions they call."""

import subprocess
from collections.abc import Iterator
from functools import cache
from types import CodeType, FunctionType, ModuleType
from typing import Any

import gymnasium as gym
import pytest

from support.nodes import NodeProgram, Program
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.agent_sdk.envs.vector_env import BuildingVectorEnv
from zenostat.bridge.client.local_node import LocalNode

STARTERS = (NodeProgram, Program, LocalNode, BuildingEnv, BuildingVectorEnv)
"""A function that refers to one of these starts a process."""

CALLS = ((subprocess, {"Popen", "run"}), (gym, {"make", "make_vec"}))
"""So does one that refers to one of these modules and these names."""

FOLLOWED = ("support", "conftest", "test_", "zenostat.agent_sdk", "zenostat.eplus_node", "zenostat.models.data_packs")
"""Functions of these modules are searched; not those of `models` that ask EnergyPlus, whose answers are cached."""


def starts_processes(item: pytest.Item) -> bool:
    """Return whether the test, or a fixture or a function that it uses, refers to what starts processes."""
    fixtures = getattr(item, "_fixtureinfo", None)
    functions = [getattr(item, "function", None)]
    if fixtures is not None:
        functions += [definition.func for each in fixtures.name2fixturedefs.values() for definition in each]
    return any(_starts(function) for function in functions)


@cache
def _starts(function: Any) -> bool:
    return _reaches(function, set())


def _reaches(what: Any, seen: set[int]) -> bool:
    if id(what) in seen:
        return False
    seen.add(id(what))
    if isinstance(what, type):
        return any(_reaches(member, seen) for member in vars(what).values())
    function = getattr(what, "__wrapped__", what)
    if not isinstance(function, FunctionType):
        return False
    for code in _codes(function.__code__):
        names = [name for name in code.co_names if name in function.__globals__]
        used = [function.__globals__[name] for name in names]
        modules = [each for each in used if isinstance(each, ModuleType) and each.__name__.startswith(FOLLOWED)]
        used += [vars(module)[name] for module in modules for name in code.co_names if name in vars(module)]
        if any(each is starter for each in used for starter in STARTERS):
            return True
        if any(each is module and calls & set(code.co_names) for each in used for module, calls in CALLS):
            return True
        if any(_is_followed(each) and _reaches(each, seen) for each in used):
            return True
    return False


def _is_followed(what: Any) -> bool:
    return isinstance(what, FunctionType | type) and what.__module__.startswith(FOLLOWED)


def _codes(code: CodeType) -> Iterator[CodeType]:
    """The code of a function and of all functions within it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)
