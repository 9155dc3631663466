"""Snapshots and branches for whoever is on the bus: plain requests, a controller on a branch, owners that leave."""

import os
import subprocess
from pathlib import Path

import psutil
import pytest
from support.nodes import SMALL, NodeProgram, Program, node_on_bus, until
from support.run_cli import ZENOSTAT

import zenostat
from zenostat.bridge.client.bus import Bus
from zenostat.topics.errors import InvalidConfig, NodeLost, NodeNotFound, RequestRejected
from zenostat.topics.messages import CreateBranch, Reset

OWNER = """
import sys
import zenostat  # registers the environments
from zenostat.agent_sdk.envs.building_env import BuildingEnv
env = BuildingEnv(connect=sys.argv[1], node="office", affinity="off")
env.reset()
for _ in range(3):
    env.step(env.action_space.sample())
kept = [env.snapshot(), env.branch(), env.branch(), env.snapshot()]
kept[1].step(env.action_space.sample())
print("has them", flush=True)
sys.stdin.readline()
"""


@pytest.fixture
def bus(episode_bus: Bus) -> Bus:
    """The bus of a node that the tests of this module share, without branches and snapshots."""
    until(lambda: not (s := episode_bus.status("office")).branches and not s.snapshots, "those of others have ended")
    until(lambda: episode_bus.nodes() == ["office"], "their nodes, too")
    return episode_bus


def cooling(bus: Bus, node: str, setpoint: float | None, steps: int, *, name: str = "plain") -> list[float]:
    """A plain controller comes, sets or keeps, and leaves; what the core zone's temperature was."""
    seen = []
    with bus.controller(node, name=name) as link:
        sample = link.current()
        for _ in range(steps):
            sample.send({} if setpoint is None else {"core_zn_cooling_setpoint": setpoint})
            sample = link.receive()
            seen.append(sample["core_zn_air_temperature"])
    return seen


@pytest.mark.slow
def test_branches__plain_controller_drives_a_branch_as_any_node(bus: Bus) -> None:
    """Controllers come and go there, one after the other, at the same level."""
    with bus.controller("office") as link:
        sample = link.reset()
        for _ in range(40):
            sample.send({"core_zn_cooling_setpoint": 24.0})
            sample = link.receive()
        one, other = (bus.branch("office", CreateBranch(controller=link.name)) for _ in range(2))
        assert bus.nodes() == ["office", one, other]
        manifest = bus.manifest(one)
        assert (manifest.branch_of, manifest.node, manifest.slots) == ("office", one, 1)
        assert bus.latest(one).values == bus.latest("office").values
        held = cooling(bus, one, None, 10, name="first")
        assert cooling(bus, other, 28.0, 10, name="first") != held
        held += cooling(bus, one, None, 5, name="second")
        expected = []
        for _ in range(15):
            sample.send()
            sample = link.receive()
            expected.append(sample["core_zn_air_temperature"])
        assert held == expected
        status = bus.status("office", memory=True)
        assert [(b.name, b.step, b.owner, b.engines) for b in status.branches] == [
            (one, 55, link.name, 1), (other, 50, link.name, 1)
        ]  # fmt: skip
        assert all(b.private_bytes > 0 for b in status.branches)


@pytest.mark.slow
def test_branches__status_command_shows_forks_with_their_memory(bus: Bus) -> None:
    with bus.controller("office") as link:
        link.reset()
        branch, snapshot = bus.branch("office", CreateBranch(controller=link.name)), bus.snapshot("office", link.name)
        output = subprocess.run(
            [*ZENOSTAT, "status", "--connect", bus.endpoint],
            capture_output=True, text=True, check=True, env=os.environ | {"COLUMNS": "200"},
        ).stdout  # fmt: skip
    for words in (f"branch {branch}", f"snapshot {snapshot.snapshot}", link.name, "MB"):
        assert words in output, output


def test_branches__stop_ends_a_branch_alone(bus: Bus) -> None:
    with bus.controller("office") as link:
        link.reset()
        one, other = (bus.branch("office", CreateBranch(controller=link.name)) for _ in range(2))
        hold = bus.controller(one)
        hold.current()
        bus.stop(one)
        with pytest.raises(NodeLost):
            hold.receive()
        until(lambda: bus.nodes() == ["office", other], "it has ended")
        with pytest.raises(NodeNotFound, match=other):
            bus.stop(one)
        bus.stop(other)
        until(lambda: not bus.status("office").branches, "both have ended")


@pytest.mark.slow
def test_branch_without_an_owner__ends_with_its_parent(node: NodeProgram) -> None:
    """It outlives the controller of the episode, its reset and its end."""
    with zenostat.connect(node.endpoint, affinity="off") as bus:
        with bus.controller("office") as link:
            link.reset()
            name = bus.branch("office", CreateBranch())
            bus.reset("office", Reset())
        hold = bus.controller(name)
        sample = hold.current()
        sample.send({"core_zn_cooling_setpoint": 24.0})
        assert hold.receive().step == 1
        bus.stop("office")
        with pytest.raises(NodeLost):
            hold.receive()


@pytest.mark.slow
def test_branches_and_snapshots__end_if_their_owner_has_no_token(bus: Bus) -> None:
    with bus.controller("office") as link:
        link.reset()
        kept = [bus.snapshot("office", owner).snapshot for owner in ("", link.name)]
        bus.snapshot("office", "ghost")
        branch = bus.branch("office", CreateBranch(controller="ghost"))
        assert [owned.owner for owned in bus.status("office").snapshots] == ["anonymous", link.name, "ghost"]
        until(lambda: branch not in bus.nodes(), "its branch has ended")
        assert [owned.name for owned in bus.status("office").snapshots] == kept
    bus.drop("office", kept[0])


def test_branches_and_snapshots__end_with_their_owner(bus: Bus) -> None:
    with bus.controller("office") as link:
        link.reset()
        mine = bus.snapshot("office").snapshot
        with bus.controller("office", name="passer-by", priority=12, required=False) as other:
            theirs = bus.branch("office", CreateBranch(controller=other.name, snapshot=mine))
            bus.snapshot("office", other.name)
        until(lambda: not bus.status("office").branches, "its branch has ended")
        assert [s.name for s in bus.status("office").snapshots] == [mine]
        with pytest.raises(RequestRejected, match=mine):
            bus.drop("office", theirs)
        bus.drop("office", mine)


def test_branches__killed_environment_leaves_a_shared_node_without_its_forks(
    shared_node: NodeProgram, bus: Bus
) -> None:
    node = psutil.Process(shared_node.pid)
    with Program(OWNER, bus.endpoint) as owner:
        assert owner.line() == "has them"
        status = bus.status("office")
        assert (len(status.snapshots), len(status.branches)) == (2, 2)
        assert len(node.children()) == 6
        owner.process.kill()
        until(lambda: not (s := bus.status("office")).snapshots and not s.branches, "its forks have ended")
    until(lambda: len(node.children()) == 2 and bus.nodes() == ["office"], "their engines and nodes, too")
    with bus.controller("office") as link:
        link.reset()
        assert cooling_of(link, 3) == 3


def cooling_of(link: zenostat.ControllerLink, steps: int) -> int:
    sample = link.current()
    for _ in range(steps):
        sample.send({"core_zn_cooling_setpoint": 24.0})
        sample = link.receive()
    return sample.step


@pytest.mark.slow
def test_branches__killed_node_takes_its_branches_along(scratch: Path) -> None:
    node = NodeProgram(scratch / "node", **SMALL)
    with zenostat.connect(node.endpoint, affinity="off") as bus, bus.controller("office") as link:
        link.reset()
        hold = bus.controller(bus.branch("office", CreateBranch(controller=link.name)))
        hold.current().send()
        hold.receive()
        node.kill()
        with pytest.raises(NodeLost):
            hold.receive()
    node.close()


@pytest.mark.slow
def test_branches__branch_whose_name_would_be_too_long_is_refused(scratch: Path) -> None:
    name = "x" * 127
    with node_on_bus(scratch / "node", **SMALL | {"name": name}) as (_, bus), bus.controller(name) as link:
        link.reset()
        with pytest.raises(InvalidConfig, match="up to 128"):
            bus.branch(name, CreateBranch(controller=link.name))
        bus.snapshot(name, link.name)
        assert cooling_of(link, 2) == 2


def test_branches__several_engines_in_a_branch_stand_where_their_one_parent_stood(bus: Bus) -> None:
    with bus.controller("office") as link:
        link.reset()
        cooling_of(link, 5)
        before = bus.latest("office")
        name = bus.branch("office", CreateBranch(controller=link.name, slots=3))
        with bus.controller(name) as hold:
            sample = hold.current()
            assert sample.message.values == before.values * 3
            assert sample.message.step == [5] * 3
            hold.send()
            rows = hold.receive().message.values
        sample = link.current()
        sample.send()
        assert rows == link.receive().message.values * 3


def test_branches__each_slot_of_a_branch_counts(folder: Path) -> None:
    settings = {"plant": "zenostat.agent_sdk.testing.fake_plant:FakePlant", "name": "fake", "branches": 4}
    with (
        NodeProgram(folder / "node", **settings) as node,
        zenostat.connect(node.endpoint, affinity="off") as bus,
        bus.controller("fake") as link,
    ):
        link.reset()
        with pytest.raises(RequestRejected, match=r"has 0 snapshots.*allows 4 \(branches=4\), and 5 slots"):
            bus.branch("fake", CreateBranch(controller=link.name, slots=5))
        bus.branch("fake", CreateBranch(controller=link.name, slots=3))
        with pytest.raises(RequestRejected, match=r"has 3 snapshots.*allows 4"):
            bus.branch("fake", CreateBranch(controller=link.name, slots=2))
        bus.snapshot("fake", link.name)
        for create in (lambda: bus.snapshot("fake", link.name), lambda: bus.branch("fake", CreateBranch())):
            with pytest.raises(RequestRejected, match=r"has 4 snapshots.*allows 4"):
                create()
        assert sum(branch.engines for branch in bus.status("fake").branches) == 3
