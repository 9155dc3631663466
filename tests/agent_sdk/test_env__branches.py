"""Branches of a running building: the same to the bit, alone in the world, and gone without a trace."""

import gc
import os
import re
from pathlib import Path
from typing import Any

import gymnasium as gym
import psutil
import pytest
from support import data_packs as packs
from support.engine_forks import (
    DAY,
    FOUR,
    KINDS,
    SMALL,
    Faults,
    engines,
    episode,
    go,
    keep_on,
    kill,
    make,
    new_engine,
    plan,
    same,
    without_rewards,
)
from support.nodes import until, within

from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.topics.errors import EngineDied, EpisodeChanged, ForkFailed, RequestRejected, SimulatorError
from zenostat.topics.messages import State

GROWTH_BYTES = 15e6
PUT_TOGETHER_BYTES = 20e6
ZENOH_THREADS = 6


# The same to the bit


@pytest.mark.variants
@pytest.mark.parametrize("kind", KINDS)
def test_env__branch_goes_on_as_its_parent_and_nobody_feels_it(kind: str, scratch: Path) -> None:
    """At the first sample, in the middle and at the last but one, with everybody stepping in turn to the end.

    What is expected comes of episodes of the same environment before it ever branched.
    """
    packs.sinergym()
    env = make(KINDS[kind])
    last = env.manifest.steps
    mine, one, other = (plan(env, seed) for seed in (1, 2, 3))
    straight = episode(env, mine)
    for at in (0, last // 2, last - 1):
        expected = [straight, *(episode(env, mine[:at] + its[at:]) for its in (one, other))]
        env.reset()
        go(env, mine[:at])
        branches = [env, *(env.branch() for _ in range(3))]
        plans = [mine, one, other, mine]
        got: list[Any] = [[] for _ in branches]
        for k in range(at, last):
            for slot, its, so_far in zip(branches, plans, got, strict=True):
                so_far.extend(go(slot, its[k : k + 1]))
        for rows, its in zip(got, [*expected, straight], strict=True):
            same(rows, its[at + 1 :])
        for branch in branches[1:]:
            assert branch.sample.truncated
            branch.close()
    env.close()


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("kind", KINDS)
def test_env__what_was_commanded_holds_in_a_branch_that_nobody_commands(kind: str, scratch: Path) -> None:
    """And `released` gives the building its own control back, as the parent's own releasing does."""
    packs.sinergym()
    env = make(KINDS[kind])
    at = env.manifest.steps // 3
    actions = plan(env, 4, at)
    held, freed = [], []
    for rows, mask in ((held, 0), (freed, 2)):
        env.reset()
        go(env, actions)
        env.link.send(*_all(env, mask))
        env._sample = env.link.receive()
        rows.extend(keep_on(env))
    env.reset()
    go(env, actions)
    with env.branch() as branch, env.branch(relinquished=True) as relinquished:
        same(keep_on(branch)[1:], held)
        same(keep_on(relinquished)[1:], freed)
    assert without_rewards(held) != without_rewards(freed)
    env.close()


def _all(env: Any, mask: int) -> tuple[Any, bytes]:
    import numpy as np

    count = len(env.manifest.actuators)
    return np.zeros(count), bytes([mask]) * count


def _huge_bytes(process: psutil.Process) -> int:
    rollup = Path(f"/proc/{process.pid}/smaps_rollup").read_text()
    return 1024 * int(re.findall(r"AnonHugePages: +(\d+) kB", rollup)[0])


def _can_put_together() -> bool:
    huge = Path("/sys/kernel/mm/transparent_hugepage/enabled")
    kernel = tuple(int(part) for part in os.uname().release.split(".")[:2])
    return kernel >= (6, 1) and huge.exists() and "[never]" not in huge.read_text()


@pytest.mark.slow
def test_env__engine_that_is_forked_often_puts_its_pages_together_and_goes_on_the_same(scratch: Path) -> None:
    """Also with branches that live on and share the pages as they were."""
    env = make(**FOUR)
    mine = plan(env, 1)
    straight = episode(env, mine)
    env.reset()
    got = go(env, mine[:40])
    engine = engines(env)[-1]
    before = _huge_bytes(engine)
    branches = []
    for at in range(40, 48):
        branches.append((at, env.branch()))
        got += go(env, mine[at : at + 1])
        if at < 42:
            assert _huge_bytes(engine) <= before + PUT_TOGETHER_BYTES / 4  # the kernel does some by itself
    if _can_put_together():
        assert _huge_bytes(engine) > before + PUT_TOGETHER_BYTES
    same(got + go(env, mine[48:]), straight[1:])
    for at, branch in branches:
        same(go(branch, mine[at:]), straight[at + 1 :])
        branch.close()
    env.close()


@pytest.mark.slow
def test_branches__of_a_snapshot_are_where_it_is(office: BuildingEnv) -> None:
    """Also while no episode runs any more."""
    env = office
    mine, its = plan(env, 1), plan(env, 2)
    expected = episode(env, mine[:30] + its[30:])
    straight = episode(env, mine[:30])
    snapshot = env.unwrapped.snapshot()
    straight += go(env, mine[30:])
    with pytest.raises(EpisodeChanged, match="reset"):
        env.branch()
    with env.branch(snapshot=snapshot) as one, env.branch(snapshot=snapshot, relinquished=True) as other:
        assert one.sample.step == other.sample.step == 30
        same(go(one, mine[30:]), straight[31:])
        same(go(other, its[30:]), expected[31:])


@pytest.mark.slow
def test_env__reward_with_a_memory_of_its_own_goes_along(scratch: Path) -> None:
    """An object, which the environments would share: what a branch earns is not remembered by its parent."""

    class Counts:
        def __init__(self) -> None:
            self.seen = 0

        def __call__(self, values: Any, begin: Any) -> float:
            self.seen += 1
            return float(self.seen)

        def reset(self, slots: Any = None) -> None:
            self.seen = 0

        def state(self) -> dict[str, Any]:
            return {"seen": self.seen}

        def restore(self, state: dict[str, Any]) -> None:
            self.seen = state["seen"]

    env = make(reward=Counts(), **FOUR)
    actions = plan(env, 1)
    env.reset()
    go(env, actions[:5])
    with env.branch() as branch:
        assert [row[-1] for row in go(branch, actions[5:8])] == [6.0, 7.0, 8.0]
        assert [row[-1] for row in go(env, actions[5:7])] == [6.0, 7.0]
        assert [row[-1] for row in go(branch, actions[8:9])] == [9.0]
    env.close()


# Death


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("moment", ["waiting", "computing"])
def test_env__killed_branch_harms_nobody(moment: str, office: BuildingEnv) -> None:
    env = office
    mine, its = plan(env, 1), plan(env, 2)
    straight, other = episode(env, mine), episode(env, mine[:20] + its[20:])
    env.reset()
    got = go(env, mine[:20])
    sibling = env.branch()
    branch, engine = new_engine(env, env.branch)
    go(branch, mine[20:22])
    if moment == "computing":
        engine.suspend()
        branch.link.send(branch._actions.values(mine[22]))
        name, bus = branch.manifest.node, branch.link.bus
        until(lambda: bus.status(name).state is State.RUNNING, "it computes")
        got += go(env, mine[20:25])
    kill(engine)
    with pytest.raises(EngineDied, match="SIGKILL"):
        go(branch, mine[22:])
    got += go(env, mine[20 + len(got) - 20 :])
    same(got, straight[1:])
    same(go(sibling, its[20:]), other[21:])
    with pytest.raises(EngineDied, match="SIGKILL"):
        go(branch, mine[22:])
    branch.close()
    sibling.close()
    same(episode(env, mine), straight)


@pytest.mark.slow
def test_branches__outlive_the_engine_that_they_were_forked_from(office: BuildingEnv) -> None:
    env = office
    mine = plan(env, 1)
    straight = episode(env, mine)
    _, engine = new_engine(env, env.reset)
    go(env, mine[:20])
    snapshot, branch = env.snapshot(), env.branch()
    kill(engine)
    with pytest.raises(EngineDied, match="SIGKILL"):
        go(env, mine[20:])
    with pytest.raises(EngineDied, match="SIGKILL"):
        go(env, mine[20:])
    same(go(branch, mine[20:50]), straight[21:51])
    env.reset(options={"snapshot": snapshot})
    same(go(env, mine[20:]), straight[21:])
    same(go(branch, mine[50:]), straight[51:])
    branch.close()
    same(episode(env, mine), straight)


@pytest.mark.slow
def test_env__without_an_engine_nothing_is_forked(office: BuildingEnv) -> None:
    """An engine that died unnoticed while its node waited: the fork's error tells it."""
    env = office
    env.reset()
    engine = engines(env)[-1]
    go(env, plan(env, 1, 3))
    kill(engine)
    for fork in (env.branch, env.snapshot):
        with pytest.raises((EngineDied, RequestRejected)) as raised:
            fork()
        assert "SIGKILL" in str(raised.value) or "failed" in str(raised.value)
    env.reset()
    with env.branch() as branch:
        go(branch, plan(env, 1, 3))


CANNOT = {
    Faults.NO_MEMORY: (ForkFailed, "Cannot allocate memory"),
    Faults.DISK_FULL: (SimulatorError, "No space left"),
    Faults.CHILD_DIES: (SimulatorError, "SIGKILL"),
}


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("what", CANNOT)
def test_env__fork_that_fails_leaves_the_episode_as_it_was(
    what: str, scratch: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    faults = Faults(scratch, monkeypatch)
    env = make(**FOUR)
    node = psutil.Process(env.local_node.pid)
    mine = plan(env, 1)
    straight = episode(env, mine)
    env.reset()
    got = go(env, mine[:20])
    with env.branch(), env.snapshot() as snapshot:

        def held() -> tuple[int, int, list[str]]:
            return node.num_fds(), len(node.children()), sorted(map(str, within(scratch)))

        before, threads = held(), node.num_threads()
        faults.set(what)
        kind, words = CANNOT[what]
        for _ in range(3):
            for fork in (
                env.branch,
                env.snapshot,
                lambda: env.branch(snapshot=snapshot),
                lambda: env.reset(options={"snapshot": snapshot}),
            ):
                with pytest.raises(kind, match=words):
                    fork()
        status = env.link.bus.status(env.manifest.node)
        assert (len(status.snapshots), len(status.branches)) == (1, 1)
        faults.clear()
        until(lambda: held() == before, "all is as it was")
        assert node.num_threads() <= threads + ZENOH_THREADS
        with env.branch() as branch:
            same(go(branch, mine[20:]), straight[21:])
        got += go(env, mine[20:])
        same(got, straight[1:])
        env.reset(options={"snapshot": snapshot})
        same(go(env, mine[20:]), straight[21:])
    same(episode(env, mine), straight)
    env.close()


@pytest.mark.slow
def test_env__engine_that_dies_while_it_forks_fails_its_episode_alone(
    scratch: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The engine of the episode, and then that of a snapshot, of which the child was made already."""
    faults = Faults(scratch, monkeypatch)
    env = make(**FOUR)
    mine = plan(env, 1)
    straight = episode(env, mine)
    env.reset()
    go(env, mine[:20])
    with env.branch() as sibling, env.snapshot() as snapshot:
        children = len(psutil.Process(env.local_node.pid).children())
        faults.set(Faults.PARENT_DIES)
        with pytest.raises(EngineDied, match="SIGKILL"):
            env.branch(snapshot=snapshot)
        got = go(env, mine[20:30])
        same(got, straight[21:31])
        with pytest.raises(EngineDied, match="SIGKILL"):
            env.branch()
        faults.clear()
        with pytest.raises(EngineDied, match="SIGKILL"):
            go(env, mine[30:])
        same(go(sibling, mine[20:]), straight[21:])
        until(lambda: len(psutil.Process(env.local_node.pid).children()) == children - 2, "no zombie is left")
    same(episode(env, mine), straight)
    env.close()


@pytest.mark.slow
def test_env__node_out_of_descriptors_refuses_a_fork_and_goes_on(scratch: Path) -> None:
    env = make(**FOUR)
    mine = plan(env, 1)
    straight = episode(env, mine)
    env.reset()
    got = go(env, mine[:20])
    node = psutil.Process(env.local_node.pid)
    was = node.rlimit(psutil.RLIMIT_NOFILE)
    node.rlimit(psutil.RLIMIT_NOFILE, (node.num_fds(), was[1]))
    for fork in (env.branch, env.snapshot):
        with pytest.raises(ForkFailed, match="Too many open files"):
            fork()
    got += go(env, mine[20:40])
    node.rlimit(psutil.RLIMIT_NOFILE, was)
    with env.branch() as branch, env.snapshot():
        same(go(branch, mine[40:]), straight[41:])
    same(got + go(env, mine[40:]), straight[1:])
    env.close()


# EnergyPlus's own files


# Nothing is left


def _threads(env: Any) -> int:
    """Number of threads of its node and of this process; Zenoh starts and ends some of its own as it likes."""
    return psutil.Process(env.local_node.pid).num_threads() + psutil.Process().num_threads()


def _held(env: Any, scratch: Path) -> dict[str, Any]:
    """All that a node could leave behind."""
    gc.collect()  # a closed session has a descriptor until it is collected: former tests' are none of ours
    node = psutil.Process(env.local_node.pid)
    bus = env.link.bus
    return {
        "processes": len(node.children()),
        "descriptors": node.num_fds(),
        "branches' threads": len(bus.status("building").branches),
        "files": sorted(str(path) for path in within(scratch) if "-fork" not in str(path)),
        "shared memory": Path(f"/proc/{node.pid}/maps").read_text().count("/dev/shm/"),
        "nodes": bus.nodes(),
        "controllers": bus.controllers(),
        "descriptors here": psutil.Process().num_fds(),
    }


def _until_as_it_was(env: Any, scratch: Path, before: dict[str, Any]) -> None:
    held = before

    def same() -> bool:
        nonlocal held
        held = _held(env, scratch)
        return held == before

    try:
        until(same, "all is as it was")
    except AssertionError as error:
        changed = {name: (before[name], now) for name, now in held.items() if now != before[name]}
        raise AssertionError(f"{error}: {changed}") from None


@pytest.mark.slow
def test_env__nothing_is_left_of_forks_that_were_closed(scratch: Path) -> None:
    """Closed at once, in the middle, at their end, with a command on its way, and by a killed engine."""
    env = make(**FOUR)
    mine = plan(env, 1)
    env.reset()
    go(env, mine[:5])

    def use() -> None:
        with env.snapshot() as snapshot, env.branch(), env.branch(snapshot=snapshot) as one, env.branch() as other:
            go(one, mine[5:8])
            go(other, mine[5:])
            env.reset(options={"snapshot": snapshot})
            branch, engine = new_engine(env, env.branch)
            branch.link.send(branch._actions.values(mine[5]))
            branch.close()
            branch, engine = new_engine(env, env.branch)
            kill(engine)
            branch.close()

    use()
    until(lambda: not env.link.bus.status("building").branches, "the branches have ended")
    before, threads = _held(env, scratch), _threads(env)
    for _ in range(4):
        use()
    _until_as_it_was(env, scratch, before)
    assert _threads(env) <= threads + ZENOH_THREADS
    status = env.link.bus.status("building")
    assert (status.snapshots, status.branches) == ([], [])
    env.close()


@pytest.mark.slow
def test_env__thousand_resets_and_a_thousand_branches_leave_a_node_as_it_was(scratch: Path) -> None:
    env = make(**FOUR)
    mine = plan(env, 1)
    node = psutil.Process(env.local_node.pid)

    def rounds(count: int) -> None:
        for _ in range(count):
            env.reset()
            go(env, mine[:1])
            with env.branch() as branch:
                go(branch, mine[1:2])
        until(lambda: not env.link.bus.status("building").branches, "the branches have ended")

    rounds(50)
    own = psutil.Process()
    before, threads = _held(env, scratch), _threads(env)
    memory = [process.memory_info().rss for process in (node, own)]
    rounds(950)  # and those before
    for process, was in zip((node, own), memory, strict=True):
        assert process.memory_info().rss < was + GROWTH_BYTES
    _until_as_it_was(env, scratch, before)
    assert _threads(env) <= threads + ZENOH_THREADS
    env.close()


# What a branch tells of itself


@pytest.mark.slow
def test_env__branch_tells_the_weather_that_it_reads(scratch: Path) -> None:
    """Also once its parent has another, and where it was made of a snapshot of an earlier episode."""
    env = make(SMALL.replace("continuous", "continuous-stochastic"), **FOUR)

    def dry_bulb(one: Any) -> bytes:
        return bytes(one.weather(["dry_bulb_temperature", "relative_humidity"]).values)

    env.reset(seed=4)
    go(env, plan(env, 1, 5))
    expected, snapshot = dry_bulb(env), env.snapshot()
    with env.branch() as early:
        assert dry_bulb(early) == expected
        for seed in (5, None):
            env.reset(seed=seed)
            go(env, plan(env, 1, 2))
            assert dry_bulb(early) == expected != dry_bulb(env)
    with env.branch(snapshot=snapshot) as late:
        snapshot.close()
        assert dry_bulb(late) == expected
        env.reset()
        assert dry_bulb(late) == expected
    env.close()


@pytest.mark.slow
def test_env__branchs_manifest_names_its_own_weather(scratch: Path) -> None:
    names = ["USA_CO_Denver", "USA_FL_Miami"]
    env = make(SMALL, weather=names, weather_order="sequence", **FOUR)
    env.reset()
    snapshot = env.snapshot()
    env.reset()
    with env.branch(snapshot=snapshot) as then, env.branch() as now:
        weathers = [(one.manifest.weather, round(one.manifest.latitude_deg)) for one in (then, now)]
    assert weathers == [("USA_CO_Denver", 40), ("USA_FL_Miami", 26)]
    env.close()


@pytest.mark.slow
def test_env__branch_of_a_time_without_faults_is_undisturbed(scratch: Path) -> None:
    env = make(**FOUR)
    env.reset()
    go(env, plan(env, 1, 3))
    snapshot = env.snapshot()
    bias = {"kind": "bias", "points": "core_zn_air_temperature", "offset": 5.0}
    env.link.bus.faults("building", {"seed": 1, "faults": [bias]})
    with env.branch(snapshot=snapshot) as before, env.branch() as after:
        assert (before.manifest.faults_injected, after.manifest.faults_injected) == (False, True)
        for branch, changed in ((before, False), (after, True)):
            info = branch.step([20.0, 25.0])[-1]
            assert ("fault_free_values" in info) is changed
    env.close()


def test_env__branch_has_counted_no_timestep_when_it_begins(office: BuildingEnv) -> None:
    env = office
    env.reset()
    go(env, plan(env, 1, 5))
    with env.branch() as branch:
        bus, name = env.link.bus, branch.manifest.node
        assert bus.status(name).statistics.cycle.count == 0
        go(branch, plan(env, 2, 3))
        until(lambda: bus.status(name).statistics.cycle.count == 3, "each timestep is counted, and no other")
        cycle = bus.status(name).statistics.cycle
        assert cycle.max_ms < 60_000.0, "not the time since the machine has started"


@pytest.mark.slow
def test_env__seeds_go_to_the_slots_that_are_named_with_them(scratch: Path) -> None:
    """In whatever order a request names them."""
    name = SMALL.replace("continuous", "continuous-stochastic")
    env: Any = gym.make_vec(name, num_envs=2, vectorization_mode="vector_entry_point", **(DAY | FOUR))
    weathers = []
    for slots, seed in (([0, 1], [6, 5]), ([1, 0], [5, 6]), ([0, 1], [5, 6])):
        env.link.reset(slots=slots, seed=seed)
        weathers.append([bytes(env.slot_weather(slot, ["dry_bulb_temperature"]).values) for slot in range(2)])
    assert weathers[0] == weathers[1] == weathers[2][::-1]
    assert weathers[0] != weathers[2]
    env.close()
