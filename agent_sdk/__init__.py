"""The agent's side of Zenostat: `connect`, and Gymnasium environments under `zenostat/`."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from agent_sdk import registration
from agent_sdk.bus.bus import Bus, connect
from agent_sdk.bus.controller_link import ControllerLink
from agent_sdk.bus.sample import SampleView
from topics import errors
from topics.messages import Manifest

if TYPE_CHECKING:
    from agent_sdk.bus.snapshot import Snapshot
    from agent_sdk.env_factory import load_env, make, make_vec, save_env
    from agent_sdk.envs.building_env import BuildingEnv
    from agent_sdk.envs.fleet_env import FleetVectorEnv
    from agent_sdk.envs.vector_env import BuildingVectorEnv

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

# Imported on first use, so that a program without environments starts fast.
_LAZY = {
    "BuildingEnv": "agent_sdk.envs.building_env",
    "BuildingVectorEnv": "agent_sdk.envs.vector_env",
    "FleetVectorEnv": "agent_sdk.envs.fleet_env",
    "Snapshot": "agent_sdk.bus.snapshot",
    "load_env": "agent_sdk.env_factory",
    "make": "agent_sdk.env_factory",
    "make_vec": "agent_sdk.env_factory",
    "save_env": "agent_sdk.env_factory",
}

registration.register()


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    member = getattr(import_module(_LAZY[name]), name)
    globals()[name] = member
    return member


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
