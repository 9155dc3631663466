"""Nodes that run elsewhere as one vector environment: equal to Gymnasium's `SyncVectorEnv` over the same nodes."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from support.nodes import SMALL, NodeProgram, engines_of, free_port, until

import zenostat
from zenostat import wrappers as w
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.agent_sdk.envs.fleet_env import FleetVectorEnv
from zenostat.agent_sdk.envs.fleet_nodes import check_compatible, node_addresses
from zenostat.agent_sdk.testing import FakeEnv
from zenostat.topics.errors import (
    BusError,
    EpisodeChanged,
    InvalidAction,
    InvalidConfig,
    NodeNotFound,
    UnknownArgument,
    UsageError,
)

MODES = list(AutoresetMode)
each_mode = pytest.mark.parametrize("mode", MODES, ids=lambda mode: mode.value)
HOT = {"points": ["core_zn_air_temperature"], "low": 15.0, "high": 26.0, "duration_h": 1.0}
NOISE = {"dry_bulb_temperature": {"sigma": 3.0, "mu": 0.0, "tau_h": 24.0}}
DAYS: dict[str, Any] = {
    **SMALL,
    "end": "07-05",
    "steps_per_hour": 1,
    "terminate": [HOT],
    "time": ["hour"],
    "weather_noise": NOISE,
    "noise_start": "third_day",
}
"""72 timesteps, the last 24 of them with noise that the seed decides; the action when the core zone is too hot."""
STEPS = 40
BUT = ("engine_start",)
"""How an engine reached its first sample depends on the episodes before."""


@pytest.fixture(scope="module")
def nodes(module_folder: Path) -> Iterator[list[NodeProgram]]:
    """Two nodes of the same name at endpoints of their own."""
    with ExitStack() as stack:
        yield [stack.enter_context(NodeProgram(module_folder / f"n{i}", **DAYS)) for i in range(2)]


def fleet(
    nodes: Sequence[NodeProgram], mode: AutoresetMode = AutoresetMode.NEXT_STEP, **arguments: Any
) -> FleetVectorEnv:
    endpoints = [node.endpoint for node in nodes]
    env = gym.make_vec(
        "zenostat/Building-v1", len(nodes), connect=endpoints, node="office", autoreset_mode=mode, **arguments
    )
    assert isinstance(env, FleetVectorEnv)
    return env


def sync(nodes: Sequence[NodeProgram], mode: AutoresetMode = AutoresetMode.NEXT_STEP) -> SyncVectorEnv:
    singles = [lambda node=node: BuildingEnv(connect=node.endpoint, node="office", affinity="off") for node in nodes]
    return SyncVectorEnv(singles, autoreset_mode=mode)


def plain(value: Any) -> Any:
    """Comparable with `==`, to the bit, with types, shapes and masks."""
    if isinstance(value, dict):
        return {key: plain(inner) for key, inner in value.items() if str(key).removeprefix("_") not in BUT}
    if isinstance(value, np.ndarray) and value.dtype == object:
        return [plain(inner) for inner in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.dtype.str, value.shape, value.tobytes()
    return type(value).__name__, value


def trajectory(env: VectorEnv[Any, Any, Any], actions: Sequence[Any]) -> list[Any]:
    """All that `reset` and `step` return; in mode `Disabled`, also of the resets of slots that have ended."""
    rows = [plain(dict(enumerate(env.reset(seed=5))))]
    for action in actions:
        result = env.step(action)
        rows.append(plain(dict(enumerate(result))))
        ended = result[2] | result[3]
        if env.metadata["autoreset_mode"] is AutoresetMode.DISABLED and ended.any():
            rows.append(plain(dict(enumerate(env.reset(options={"reset_mask": ended})))))
    return rows


def actions_for(env: VectorEnv[Any, Any, Any], count: int = STEPS) -> list[Any]:
    env.action_space.seed(2)
    return [env.action_space.sample() for _ in range(count)]


@pytest.mark.slow
@pytest.mark.variants
@each_mode
def test_fleet_env__equal_to_the_sync_vector_to_the_bit(nodes: list[NodeProgram], mode: AutoresetMode) -> None:
    with closing(fleet(nodes, mode)) as env:
        actions = actions_for(env)
        ours = trajectory(env, actions)
        spaces = env.observation_space, env.action_space
    with closing(sync(nodes, mode)) as env:
        theirs = trajectory(env, actions)
        assert spaces == (env.observation_space, env.action_space)
    assert ours == theirs
    ends = np.array([np.frombuffer(row[2][2], bool) | np.frombuffer(row[3][2], bool) for row in theirs if 4 in row])
    assert ends.sum(axis=0).min() >= 1, "each slot has ended"
    assert any(end.any() and not end.all() for end in ends), "some ended alone"


@pytest.mark.slow
def test_fleet_env__each_slot_has_the_noise_of_its_seed(nodes: list[NodeProgram]) -> None:
    """Through the end of the run period, into an episode whose noise continues the sequence of the seed."""
    rows = []
    for make in (fleet, sync):
        with closing(make(nodes)) as env:
            rows.append(trajectory(env, [np.tile(np.array([15.0, 23.0], np.float32), (2, 5))] * 75))
    assert rows[0] == rows[1]
    outdoor = [np.frombuffer(row[0][2], np.float32).reshape(2, -1) for row in rows[0]]
    assert any(not np.array_equal(*slots) for slots in outdoor[49:72]), "the slots have different noise"


@pytest.mark.slow
def test_fleet_env__wrappers_are_around_the_fleet(nodes: list[NodeProgram]) -> None:
    chain = [{"wrapper": "CyclicTime", "fields": ["hour"]}, {"wrapper": "PreviousObservation", "names": []}]
    chain[1]["names"] = ["core_zn_air_temperature"]
    rows = []
    for make in (fleet, sync):
        env = w.apply_wrappers(make(nodes), chain)
        with closing(env):
            rows.append(trajectory(env, actions_for(env, 30)))
    assert rows[0] == rows[1]


def test_fleet_env__all_commands_are_sent_before_a_sample_is_awaited(
    nodes: list[NodeProgram], monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []
    for name in ("step_async", "step_wait"):
        original = getattr(BuildingEnv, name)

        def logged(self: BuildingEnv, *args: Any, _name: str = name, _original: Any = original) -> Any:
            calls.append(_name)
            return _original(self, *args)

        monkeypatch.setattr(BuildingEnv, name, logged)
    with closing(fleet(nodes)) as env:
        env.reset(seed=0)
        env.step(env.action_space.sample())
    assert calls == ["step_async"] * 2 + ["step_wait"] * 2


def test_fleet_env__invalid_action_names_its_slot_and_nothing_is_simulated(nodes: list[NodeProgram]) -> None:
    with closing(fleet(nodes)) as env:
        env.reset(seed=0)
        action = env.action_space.sample()
        wrong = action.copy()
        wrong[1, 0] = 1000.0
        with pytest.raises(InvalidAction, match="slot 1: "):
            env.step(wrong)
        assert env.step(action)[4]["step"].tolist() == [1, 1]


def test_fleet_env__slots_begin_anew_by_mask(nodes: list[NodeProgram]) -> None:
    with closing(fleet(nodes)) as env:
        with pytest.raises(EpisodeChanged, match="call reset"):
            env.step(env.action_space.sample())
        with pytest.raises(EpisodeChanged, match="all slots first"):
            env.reset(options={"reset_mask": np.array([True, False])})
        env.reset(seed=[1, None])
        for _ in range(3):
            before = env.step(env.action_space.sample())[0]
        observations, infos = env.reset(options={"reset_mask": np.array([False, True])})
        assert infos["_step"].tolist() == [False, True]
        assert np.array_equal(observations[0], before[0])
        assert env.step(env.action_space.sample())[4]["step"].tolist() == [4, 1]


def test_fleet_env__each_slot_is_an_environment(nodes: list[NodeProgram]) -> None:
    with closing(fleet(nodes, render_mode="rgb_array")) as env:
        env.reset(seed=0)
        assert env.call("weather", ["dry_bulb_temperature"])[1].units == ["C"]
        assert env.get_attr("render_mode") == ("rgb_array", "rgb_array")
        assert [picture.shape for picture in env.render()] == [(640, 960, 3)] * 2
        assert env.observation_names == env.envs[1].observation_names
    env.close()
    with pytest.raises(EpisodeChanged, match="the environment is closed"):
        env.reset()


@pytest.mark.slow
def test_fleet_env__nodes_at_one_endpoint_share_a_connection(nodes: list[NodeProgram], scratch: Path) -> None:
    """A node routes between those that connect to it; a router does the same for many."""
    at = nodes[0].endpoint
    with (
        NodeProgram(scratch / "other", **DAYS, name="other", listen=[], connect=[at]),
        closing(gym.make_vec("zenostat/Building-v1", 2, connect=at, node=["office", "other"])) as env,
    ):
        env.reset(seed=0)
        assert env.step(env.action_space.sample())[4]["step"].tolist() == [1, 1]
        first, second = env.unwrapped.envs
        assert first.link.bus is second.link.bus


# Lost nodes


class Restartable:
    """A node at a port of its own that can be killed and started again."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._port = folder, free_port()
        self.start()

    @property
    def endpoint(self) -> str:
        return f"tcp/127.0.0.1:{self._port}"

    def kill(self) -> None:
        self.program.kill()
        self.program.close()

    def start(self) -> None:
        self.program = NodeProgram(self._folder, **{**DAYS, "listen": [self.endpoint]})

    def close(self) -> None:
        self.program.close()


@pytest.fixture
def victim(scratch: Path) -> Iterator[Restartable]:
    with closing(Restartable(scratch / "victim")) as node:
        yield node


@pytest.mark.slow
@pytest.mark.variants
@each_mode
def test_fleet_env__lost_node_is_one_slots_error(
    nodes: list[NodeProgram], victim: Restartable, mode: AutoresetMode
) -> None:
    """The other slots continue to the bit, and the slot continues once the node is back."""
    with closing(fleet([nodes[0], nodes[1]], mode)) as env:
        actions = actions_for(env, 8)
        env.reset(seed=5)
        expected = [plain(env.step(action)[0]) for action in actions]
    with closing(fleet([nodes[0], nodes[1], victim], mode)) as env:
        env.reset(seed=5)
        padded = [np.concatenate([action, action[:1]]) for action in actions]
        before = [env.step(action)[0] for action in padded[:3]]
        victim.kill()
        with pytest.warns(UserWarning, match=r"slot 2 \(node 'office' at tcp/.*is gone"):
            lost = env.step(padded[3])
        assert lost[1][2] == 0.0
        assert (lost[2].tolist(), lost[3].tolist()) == ([False] * 3, [False, False, True])
        infos = lost[4]["final_info"] if mode is AutoresetMode.SAME_STEP else lost[4]
        assert infos["error"][2].startswith("NodeLost: node 'office' is gone")
        assert infos["_error"].tolist() == [False, False, True]
        assert np.array_equal(lost[0][2], before[-1][2])
        if mode is AutoresetMode.DISABLED:
            _, infos = env.reset(options={"reset_mask": lost[3]})
            assert infos["error"][2].startswith("NodeNotFound: no node 'office'")
        rest = [*before, lost[0], *(env.step(action)[0] for action in padded[4:])]
        assert [plain(observation[:2]) for observation in rest] == expected

        victim.start()
        until(lambda: _is_back(env, padded[0], mode), "the node's slot continues")
        *_, infos = env.step(padded[0])
        assert infos["step"][2] == 1
        assert "error" not in infos


def _is_back(env: FleetVectorEnv, action: Any, mode: AutoresetMode) -> bool:
    """Whether the third slot has started an episode; a step that did not is truncated, and says why."""
    if mode is AutoresetMode.DISABLED:
        _, infos = env.reset(options={"reset_mask": np.array([False, False, True])})
    else:
        *_, truncated, infos = env.step(action)
        assert truncated[2] == (mode is AutoresetMode.SAME_STEP or "error" in infos)
        if np.any(truncated[:2]):  # the others' day has ended meanwhile
            env.reset(options={"reset_mask": np.array([True, True, False])})
    assert "error" not in infos or infos["error"][2].startswith(("NodeNotFound", "NodeLost"))
    return "error" not in infos


@pytest.mark.slow
def test_fleet_env__failed_simulation_is_one_slots_error(nodes: list[NodeProgram], scratch: Path) -> None:
    with NodeProgram(scratch / "own", **DAYS) as own, closing(fleet([nodes[0], own], AutoresetMode.SAME_STEP)) as env:
        env.reset(seed=0)
        engines_of(own.pid)[-1].kill()
        with pytest.warns(UserWarning, match=r"slot 1 \(node 'office'"):
            *_, truncated, infos = env.step(env.action_space.sample())
        assert truncated.tolist() == [False, True]
        assert infos["final_info"]["error"][1].startswith("EngineDied: ")
        assert infos["step"].tolist() == [1, 0], "the node started another engine"


@pytest.mark.slow
def test_fleet_env__errors_are_raised_where_wanted(nodes: list[NodeProgram], victim: Restartable) -> None:
    with closing(fleet([nodes[0], victim], on_error="raise")) as env:
        env.reset(seed=0)
        victim.kill()
        with pytest.raises(BusError, match=r"^slot 1 \(node 'office' at tcp/.*\): node 'office' is gone"):
            env.step(env.action_space.sample())
        with pytest.raises(NodeNotFound, match=r"^slot 1 \(node 'office'"):
            env.reset()


@pytest.mark.slow
def test_fleet_env__no_node_left_is_an_error(victim: Restartable) -> None:
    with closing(fleet([victim])) as env:
        env.reset(seed=0)
        victim.kill()
        with pytest.warns(UserWarning, match="is gone"):
            env.step(env.action_space.sample())
        for _ in range(2):  # nor do later steps wait or return zeros
            with pytest.raises(NodeNotFound, match=r"^slot 0 \(node 'office'"):
                env.step(env.action_space.sample())


# What cannot be


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"connect": ["tcp/a:1", "tcp/b:1"]}, "several nodes need connect= and node="),
        ({"connect": ["tcp/a:1", "tcp/b:1"], "node": ["x"]}, "connect has 2 endpoints and node 1 names"),
        ({"connect": [], "node": "x"}, "connect has 0 endpoints"),
        ({"node": ["x", "y"]}, "several nodes need connect= and node="),
        ({"connect": ["a", "b:1"], "node": "x"}, r"(?s)'a' is not an endpoint.*'b:1' is not an endpoint"),
        ({"connect": "tcp/a:1", "node": ["x", "x"]}, "node 'x' at tcp/a:1 is listed twice"),
        ({"connect": "tcp/a:1", "node": ["x", "a/b"]}, "'a/b' is not valid"),
        ({"connect": ["tcp/a:1"] * 3, "node": ["x", "y", "z"]}, "num_envs = 2, but .* list 3 nodes: .*num_envs=3"),
        ({"connect": ["tcp/a:1", "tcp/b:1"], "node": "x", "on_error": "ignore"}, "there are: truncate, raise"),
        ({"connect": ["tcp/a:1", "tcp/b:1"], "node": "x", "render_mode": "rerun"}, "zenostat monitor"),
        ({"connect": ["tcp/a:1", "tcp/b:1"], "node": "x", "building": "y"}, "building: nodes .* own settings"),
        ({"connect": ["tcp/a:1", "tcp/b:1"], "node": "x", "autoreset_mode": "Never"}, "there are: 'NextStep'"),
        ({"connect": ["tcp/a:1", "tcp/b:1"], "node": "x", "priority": 0}, "priority"),
    ],
)
def test_fleet_env__arguments_that_cannot_be(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidConfig, match=words):
        gym.make_vec("zenostat/Building-v1", 2, **arguments)


def test_fleet_env__unknown_argument() -> None:
    with pytest.raises(UnknownArgument, match="did you mean 'priority'"):
        FleetVectorEnv(["tcp/a:1"], "x", prioriti=3)


def test_fleet_env__several_nodes_are_no_single_environment() -> None:
    with pytest.raises(InvalidConfig, match=r"gymnasium\.make_vec"):
        gym.make("zenostat/Building-v1", connect=["tcp/a:1", "tcp/b:1"], node="x")


@pytest.mark.slow
def test_fleet_env__nodes_that_are_not_there_are_all_named(nodes: list[NodeProgram]) -> None:
    absent = f"tcp/127.0.0.1:{free_port()}"
    with pytest.raises(
        NodeNotFound, match=rf"(?s)^slot 1 \(node 'b' .*'b' on .*\nslot 2 \(node 'office' at {absent}\)"
    ):
        FleetVectorEnv([nodes[0].endpoint, nodes[0].endpoint, absent], ["office", "b", "office"])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"zones": 2}, "its observations are without zone_3_air_temperature"),
        ({"time": ["month"]}, "its observations are with month"),
        ({"control": "building"}, "its actions are without zone_1_heating_setpoint, zone_1_cooling_setpoint"),
        ({"control": "zone", "discrete": 4}, "its action space is MultiDiscrete"),
    ],
)
def test_fleet_env__nodes_that_do_not_fit_are_named(arguments: dict[str, Any], words: str) -> None:
    manifests = [FakeEnv(**fields).manifest for fields in ({}, {}, arguments)]
    with pytest.raises(InvalidConfig, match=rf"^slot 2 \(node 'c' at tcp/a:1\) does not fit slot 0: {words}"):
        check_compatible(node_addresses("tcp/a:1", ["a", "b", "c"]), manifests)


@pytest.mark.slow
def test_fleet_env__node_with_slots_is_refused_and_nothing_is_claimed(nodes: list[NodeProgram], scratch: Path) -> None:
    with (
        NodeProgram(scratch / "slots", **DAYS, slots=2) as slots,
        pytest.raises(InvalidConfig, match=r"^slot 1 \(node .* has 2 slots; a fleet needs nodes with one slot$"),
    ):
        fleet([nodes[0], slots])
    with zenostat.connect(nodes[0].endpoint) as bus:
        until(lambda: bus.controllers() == [], "whoever was refused has gone")
        assert not any(c.state.is_connected for c in bus.status("office").controllers)


def test_fleet_env__halves_of_a_step_come_in_turn() -> None:
    env = FakeEnv(zones=1, steps_per_hour=1)
    with pytest.raises(EpisodeChanged, match="call reset"):
        env.step_async(np.array([16.0, 25.0], np.float32))
    env.reset(seed=0)
    with pytest.raises(UsageError, match=r"step_async\(\) before step_wait"):
        env.step_wait()
    env.step_async(np.array([16.0, 25.0], np.float32))
    with pytest.raises(UsageError, match="already"):
        env.step_async(np.array([16.0, 25.0], np.float32))
    half = env.step_wait()
    env.reset(seed=0)
    whole = env.step(np.array([16.0, 25.0], np.float32))
    assert plain(dict(enumerate(half))) == plain(dict(enumerate(whole)))
    env.step_async(np.array([16.0, 25.0], np.float32))
    env.reset(seed=0)  # what was begun is dropped
    assert env.step(np.array([16.0, 25.0], np.float32))[4]["step"] == 1
