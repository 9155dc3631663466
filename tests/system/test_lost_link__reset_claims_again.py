"""After a lost link a reset claims the node again, and steps work."""

import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import gymnasium as gym
import psutil
import pytest
from support.links import CuttableLink
from support.nodes import SMALL, NodeProgram, begin_new_episode, free_port, until
from support.run_cli import ZENOSTAT

import zenostat
from zenostat.topics.errors import BusError, EpisodeChanged, NodeLost, NodeNotFound, PeerError, RequestRejected

pytestmark = pytest.mark.usefixtures("scratch")

SLOTS = pytest.mark.parametrize("slots", [1, 2])


def make(slots: int, **arguments: Any) -> Any:
    arguments["affinity"] = "off"
    if slots == 1:
        return gym.make("zenostat/Building-v1", **arguments)
    return gym.make_vec("zenostat/Building-v1", slots, "vector_entry_point", **arguments)


def step_until_lost(env: Any) -> None:
    with pytest.raises(NodeLost, match=r"is gone|was stopped"):
        step_for_ever(env)


def step_for_ever(env: Any) -> None:
    while True:
        env.step(env.action_space.sample())


def has_reset(env: Any) -> bool:
    try:
        env.reset(seed=0)
    except BusError:  # the way is not there again yet
        return False
    return True


def steps_again(env: Any) -> None:
    until(lambda: has_reset(env), "the environment resets")
    for _ in range(3):
        env.step(env.action_space.sample())


@contextmanager
def node_behind_link(folder: Path, **more: Any) -> Iterator[tuple[NodeProgram, CuttableLink, int]]:
    port = free_port()
    settings = {**SMALL, "listen": [f"tcp/127.0.0.1:{port}"], **more}
    with NodeProgram(folder / "node", **settings) as node, CuttableLink(port) as link:
        yield node, link, port


@pytest.fixture(scope="module")
def tcp_node(module_folder: Path) -> Iterator[NodeProgram]:
    """A node that the tests share which it outlives."""
    with NodeProgram(module_folder / "node", **SMALL, listen=[f"tcp/127.0.0.1:{free_port()}"]) as node:
        yield node


@pytest.fixture
def link(tcp_node: NodeProgram) -> Iterator[CuttableLink]:
    """A link to `tcp_node`, which waits at the first sample of a new episode."""
    with zenostat.connect(tcp_node.endpoint, affinity="off") as bus:
        begin_new_episode(bus)
    with CuttableLink(int(tcp_node.endpoint.rpartition(":")[2])) as opened:
        yield opened


@pytest.mark.slow
@pytest.mark.variants
@SLOTS
def test_lost_link__cut_connection(scratch: Path, slots: int) -> None:
    with node_behind_link(scratch, slots=slots) as (_, link, _):
        env = make(slots, connect=link.endpoint, node="office")
        env.reset(seed=0)
        for _ in range(2):
            link.cut()
            step_until_lost(env)
            steps_again(env)
        env.close()


@pytest.mark.slow
def test_lost_link__link_that_is_down(link: CuttableLink) -> None:
    env = make(1, connect=link.endpoint, node="office")
    env.reset(seed=0)
    link.down()
    step_until_lost(env)
    with pytest.raises(NodeNotFound, match="no node 'office'"):
        env.reset()
    link.up()
    steps_again(env)
    env.close()


@pytest.mark.slow
@SLOTS
def test_lost_link__own_node_that_was_frozen(slots: int) -> None:
    env = make(slots, **SMALL)
    env.reset(seed=0)
    node = env.unwrapped.local_node.pid
    os.kill(node, signal.SIGSTOP)
    try:
        step_until_lost(env)
    finally:
        os.kill(node, signal.SIGCONT)
    steps_again(env)
    assert env.unwrapped.local_node.pid == node
    env.close()


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("recorded", [False, True])
def test_lost_link__own_node_that_is_frozen_is_ended(recorded: bool, scratch: Path) -> None:
    env = make(1, **SMALL, record=str(scratch / "run.mcap") if recorded else None)
    env.reset(seed=0)
    node = psutil.Process(env.unwrapped.local_node.pid)
    node.suspend()
    until(lambda: node.status() == psutil.STATUS_STOPPED, "it is frozen")
    env.close()
    assert not node.is_running()


@pytest.mark.slow
def test_lost_link__environment_closes_while_the_other_side_is_frozen(scratch: Path) -> None:
    with NodeProgram(scratch / "node", **SMALL) as node:
        env = make(1, connect=node.endpoint, node="office")
        env.reset(seed=0)
        psutil.Process(node.pid).suspend()
        try:
            step_until_lost(env)
            env.close()
        finally:
            psutil.Process(node.pid).resume()


def answer_for_ever(controller: zenostat.ControllerLink) -> None:
    while True:
        controller.receive().send()


@contextmanager
def router(endpoint: str) -> Iterator[None]:
    program = [*ZENOSTAT, "router", "--listen", endpoint]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline()
            yield
        finally:
            process.kill()


@pytest.mark.slow
def test_lost_link__router_that_was_killed_and_started_again(scratch: Path) -> None:
    at = f"tcp/127.0.0.1:{free_port()}"
    with router(at):
        node = NodeProgram(scratch / "node", **SMALL, listen=[], connect=[at])
        env = make(1, connect=at, node="office")
        env.reset(seed=0)
    with node:
        step_until_lost(env)
        with router(at):
            steps_again(env)
            env.close()
            node.close()


@pytest.mark.slow
def test_lost_link__controller_without_gymnasium(link: CuttableLink) -> None:
    with zenostat.connect(link.endpoint, affinity="off") as bus, bus.controller("office") as controller:
        controller.reset().send()
        link.cut()
        with pytest.raises(NodeLost):
            answer_for_ever(controller)
        until(lambda: bus.nodes() == ["office"], "the link is back")
        controller.reset().send({"core_zn_cooling_setpoint": 26.0})
        assert controller.receive().value_source["core_zn_cooling_setpoint"] == controller.name


@pytest.mark.slow
def test_lost_link__claim_that_only_the_node_lost(tcp_node: NodeProgram, link: CuttableLink) -> None:
    """Another controller has taken the level over meanwhile: the refusal names it, and steps work once it has left."""
    env = make(1, connect=link.endpoint, node="office")
    env.reset(seed=0)
    link.down()
    step_until_lost(env)
    with (
        zenostat.connect(tcp_node.endpoint, affinity="off") as bus,
        until(lambda: claimed(bus), "the node has lost the environment too"),
    ):
        link.up()
        refused = until(lambda: refusal(env), "the claim is refused")
        assert "is claimed by 'other-" in refused
    steps_again(env)
    env.close()


def claimed(bus: zenostat.Bus) -> zenostat.ControllerLink | None:
    try:
        return bus.controller("office", name="other")
    except RequestRejected:
        return None


def refusal(env: Any) -> str:
    try:
        env.reset()
    except BusError:
        return ""
    except PeerError as error:
        return str(error)
    raise AssertionError("the reset was taken")


@pytest.mark.slow
def test_lost_link__node_elsewhere_that_was_restarted(scratch: Path) -> None:
    with node_behind_link(scratch) as (node, link, port):
        env = make(1, connect=link.endpoint, node="office")
        env.reset(seed=0)
        instance = env.unwrapped.manifest.instance
        node.kill()
        step_until_lost(env)
        with pytest.raises(NodeNotFound, match="no node 'office'"):
            env.reset()
        settings = {**SMALL, "listen": [f"tcp/127.0.0.1:{port}"]}
        with NodeProgram(scratch / "again", **settings):
            steps_again(env)
            assert env.unwrapped.manifest.instance != instance
        step_until_lost(env)
        with NodeProgram(scratch / "other", **{**settings, "building": "ref-medium-office"}):
            until(lambda: "restarted with other points" in reset_error(env), "the other building is refused")
        env.close()


def reset_error(env: Any) -> str:
    try:
        env.reset()
    except (BusError, EpisodeChanged) as error:
        return str(error)
    return ""
