"""Zenostat: buildings in simulation on a Zenoh bus, and Gymnasium environments under `zenostat/`.

Nothing is imported before it is used, so that the simulators' own processes start fast.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from zenostat.agent_sdk.env_factory import load_env, make, make_vec, save_env
    from zenostat.agent_sdk.envs.building_env import BuildingEnv
    from zenostat.agent_sdk.envs.fleet_env import FleetVectorEnv
    from zenostat.agent_sdk.envs.snapshot import Snapshot
    from zenostat.agent_sdk.envs.vector_env import BuildingVectorEnv
    from zenostat.bridge.client.bus import Bus, connect
    from zenostat.bridge.client.controller_link import ControllerLink
    from zenostat.bridge.client.sample import SampleView
    from zenostat.topics import errors
    from zenostat.topics.messages import Manifest

__all__ = [
    "BuildingEnv",
    "BuildingVectorEnv",
    "Bus",
    "ControllerLink",
    "FleetVectorEnv",
    "Manifest",
    "SampleView",
    "Snapshot",
    "connect",
    "errors",
    "load_env",
    "make",
    "make_vec",
    "save_env",
]

_MODULES = {
    "BuildingEnv": "agent_sdk.envs.building_env",
    "BuildingVectorEnv": "agent_sdk.envs.vector_env",
    "Bus": "bridge.client.bus",
    "ControllerLink": "bridge.client.controller_link",
    "FleetVectorEnv": "agent_sdk.envs.fleet_env",
    "Manifest": "topics.messages",
    "SampleView": "bridge.client.sample",
    "Snapshot": "agent_sdk.envs.snapshot",
    "connect": "bridge.client.bus",
    "load_env": "agent_sdk.env_factory",
    "make": "agent_sdk.env_factory",
    "make_vec": "agent_sdk.env_factory",
    "save_env": "agent_sdk.env_factory",
}
_SUBMODULES = {
    "errors": "topics.errors",
    **{
        name: name
        for name in (
            "benchmark", "controllers", "datasets", "envs", "evaluation", "ray", "recording", "report", "rewards",
            "semantic", "testing", "time_series", "training", "wrappers",
        )
    },
}  # fmt: skip
_REGISTRY = "gymnasium.envs.registration"


def __getattr__(name: str) -> Any:
    if name in _SUBMODULES:
        member: Any = import_module(f"zenostat.{_SUBMODULES[name]}")
    elif name in _MODULES:
        member = getattr(import_module(f"zenostat.{_MODULES[name]}"), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = member
    return member


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_SUBMODULES})


class _RegistryFinder(MetaPathFinder):
    """Register the environments as soon as the program imports Gymnasium, which a simulator's process never does."""

    def find_spec(
        self, name: str, _path: Sequence[str] | None = None, _target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Find Gymnasium's registry, and register the environments after it has been loaded."""
        if name != _REGISTRY:
            return None
        sys.meta_path.remove(self)
        spec = find_spec(name)
        if spec is not None and spec.loader is not None:
            spec.loader = _RegistryLoader(spec.loader)
        return spec


class _RegistryLoader(Loader):
    def __init__(self, loader: Loader) -> None:
        self._loader = loader

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        self._loader.exec_module(module)
        _register_environments()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._loader, name)  # such as `get_source`, for `inspect` and tracebacks


def _register_environments() -> None:
    from zenostat.agent_sdk.registration import register

    register()


if _REGISTRY in sys.modules:
    _register_environments()
else:
    sys.meta_path.insert(0, _RegistryFinder())
