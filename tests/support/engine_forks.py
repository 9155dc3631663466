"""Scaffolding for tests of snapshots and branches: trajectories under planned actions, and engines that fork badly."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import psutil
import pytest

import zenostat  # noqa: F401  # registers the environments
from support.nodes import engines_of, runs, until
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.bridge.client.controller_link import ControllerLink

SMALL = "zenostat/ref-small-office-USA_CO_Denver-continuous-v1"
"""One summer day of it has 96 steps with `FOUR`."""

DAY = {"begin": "07-03", "end": "07-03", "affinity": "off"}
FOUR = {"steps_per_hour": 4}

KINDS = {
    "five zones": "5zone-hot-continuous-v1",
    "data centre, DX": "datacenter_dx-hot-continuous-v1",
    "data centre, chilled water": "datacenter_cw-hot-continuous-v1",
    "medium office with EMS": "office-medium-USA_CO_Denver-continuous-v1",
    "photovoltaics and battery": "shop-hot-continuous-v1",
    "battery that is controlled": "officegrid-hot-continuous-v1",
}

Row = list[float]


def make(name: str = SMALL, **arguments: Any) -> BuildingEnv:
    env = gym.make(name if "/" in name else f"zenostat/{name}", **(DAY | arguments)).unwrapped
    assert isinstance(env, BuildingEnv)
    return env


def plan(env: BuildingEnv, seed: int, steps: int | None = None) -> list[Any]:
    """Random actions that are the same each time, one for each step of an episode."""
    env.action_space.seed(seed)
    return [env.action_space.sample() for _ in range(env.manifest.steps if steps is None else steps)]


def row(env: BuildingEnv, reward: float = 0.0) -> Row:
    """All that is known of a sample: the points and the actuators as float64, and the reward."""
    return [env.sample.step, *env.sample.values.tolist(), *env.sample.effective.tolist(), reward]


def go(env: BuildingEnv, actions: Sequence[Any]) -> list[Row]:
    """Steps by these actions from where the environment stands."""
    rows = []
    for action in actions:
        _, reward, *_ = env.step(action)
        rows.append(row(env, reward))
    return rows


def episode(env: BuildingEnv, actions: Sequence[Any], **reset: Any) -> list[Row]:
    """An episode from its reset on; row k is of sample k."""
    env.reset(**reset)
    return [row(env), *go(env, actions)]


def keep_on(env: BuildingEnv) -> list[Row]:
    """Steps to the end without commanding anything: whatever holds goes on to hold. Rewards are left out."""
    rows = []
    while not env.sample.truncated:
        env.link.send(np.zeros(len(env.manifest.actuators)), bytes(len(env.manifest.actuators)))
        env._sample = env.link.receive()
        rows.append(row(env))
    return rows


def same(got: Sequence[Row], expected: Sequence[Row]) -> None:
    """Equal to the bit, NaN to NaN."""
    np.testing.assert_array_equal(np.array(got), np.array(expected))


def without_rewards(rows: Sequence[Row]) -> list[Row]:
    return [[*r[:-1], 0.0] for r in rows]


def engines(env: BuildingEnv) -> list[psutil.Process]:
    """The engines of its node that run, the youngest last."""
    assert env.local_node is not None
    return engines_of(env.local_node.pid)


def new_engine(env: BuildingEnv, make_one: Callable[[], Any]) -> tuple[Any, psutil.Process]:
    """Return the result of `make_one`, and the one engine that started with it."""
    before = {engine.pid for engine in engines(env)}
    new = make_one()
    (engine,) = [engine for engine in engines(env) if engine.pid not in before]
    return new, engine


def drop_forks(env: BuildingEnv) -> None:
    """Drop all snapshots of its node, and wait until these and the branches, which tests close, have gone."""
    assert isinstance(env.link, ControllerLink)
    bus, node = env.link.bus, env.manifest.node
    for snapshot in bus.status(node).snapshots:
        bus.drop(node, snapshot.name)

    def left() -> int:
        status = bus.status(node)
        return len(status.snapshots) + len(status.branches)

    until(lambda: not left(), "all forks have ended")


def kill(process: psutil.Process) -> None:
    """Kills, and waits until it is no more than a zombie at most."""
    process.kill()
    until(lambda: not runs(process), f"{process.pid} has ended")


_NODE_STARTS_THEM = """
import sys
if sys.orig_argv[-2:] == ["-m", "zenostat.eplus_node"]:
    from dataclasses import replace
    from zenostat.eplus_node import engine_spec as spec
    spec.ENERGYPLUS = replace(spec.ENERGYPLUS, command=(sys.executable, "-P", {engine!r}, "zenostat.eplus_node.engine"))
"""

_ENGINE = """
import errno, os, signal, sys
from zenostat.bridge.engine import system_calls
from zenostat.eplus_node.engine import timestep_exchange as engine
from zenostat.eplus_node.engine.__main__ import main

def fault():
    try:
        with open({fault!r}) as file:
            return file.read()
    except FileNotFoundError:
        return ""

clone, reopen_files = system_calls.clone, engine.reopen_files

def faulty_clone():
    what = fault()
    if what == "no memory":
        raise OSError(errno.ENOMEM, "no memory")
    child = clone()
    if (what == "the child dies" and not child) or (what == "the parent dies" and child):
        os.kill(os.getpid(), signal.SIGKILL)
    return child

def faulty_reopen_files(folder):
    if fault() == "the disk is full":
        raise OSError(errno.ENOSPC, "No space left on device")
    reopen_files(folder)

system_calls.clone, engine.reopen_files = faulty_clone, faulty_reopen_files
main(*map(int, sys.argv[2:]))
"""


class Faults:
    """Make engines of nodes that start from now on fork badly while a fault is set.

    The node is the real one; its engines are real processes of a program that differs in its fork alone.
    """

    NO_MEMORY = "no memory"
    DISK_FULL = "the disk is full"
    CHILD_DIES = "the child dies"
    PARENT_DIES = "the parent dies"

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        own = folder / "faulty"
        own.mkdir()
        self._fault, engine = own / "fault", own / "engine.py"
        engine.write_text(_ENGINE.format(fault=str(self._fault)))
        (own / "sitecustomize.py").write_text(_NODE_STARTS_THEM.format(engine=str(engine)))
        paths = [str(own), *[path for path in sys.path if path]]
        monkeypatch.setenv("PYTHONPATH", ":".join(paths))

    def set(self, what: str) -> None:
        self._fault.write_text(what)

    def clear(self) -> None:
        self._fault.unlink()
