"""Going back to where a building stood: exactly there, any number of times, and a clear word where that cannot be."""

import copy
import pickle
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from support import data_packs as packs
from support.engine_forks import DAY, FOUR, KINDS, SMALL, episode, go, kill, make, new_engine, plan, row, same
from support.nodes import SMALL as SMALL_NODE
from support.nodes import NodeProgram, until, within

from zenostat import wrappers as w
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.topics.errors import (
    EngineDied,
    EpisodeChanged,
    InvalidConfig,
    NodeLost,
    RequestRejected,
    UsageError,
    ZenostatError,
)
from zenostat.topics.messages import CreateBranch, EngineStart, Reset

STOCHASTIC = SMALL.replace("continuous", "continuous-stochastic")
COLUMNS = ["dry_bulb_temperature", "relative_humidity"]
PEAK = {"kind": "peak"}


def back(env: BuildingEnv, snapshot: Any) -> dict[str, Any]:
    return env.reset(options={"snapshot": snapshot})[1]


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("kind", KINDS)
def test_env__going_back_is_exact_any_number_of_times(kind: str, scratch: Path) -> None:
    """To the first sample, the middle and the last but one; the episode that is left may stand anywhere."""
    packs.sinergym()
    env = make(KINDS[kind])
    last = env.manifest.steps
    mine, its = plan(env, 1), plan(env, 2)
    straight = episode(env, mine)
    points = (0, last // 2, last - 1)
    other = {at: episode(env, mine[:at] + its[at:]) for at in points}
    same([*_first(env)], straight[:1])
    kept = {}
    for at in range(last):
        if at in points:
            kept[at] = env.snapshot()
        same(go(env, mine[at : at + 1]), straight[at + 1 : at + 2])
    for _ in range(2):
        for at in points:
            for actions, expected in ((mine, straight), (its, other[at])):
                assert back(env, kept[at])["engine_start"] == EngineStart.SNAPSHOT
                assert env.sample.step == at
                np.testing.assert_array_equal(row(env)[:-1], straight[at][:-1])
                same(go(env, actions[at:]), expected[at + 1 :])
            if at < last - 1:
                back(env, kept[at])
                go(env, its[at : at + 1])
    same(episode(env, mine), straight)
    env.close()


def _first(env: BuildingEnv) -> Any:
    env.reset()
    yield row(env)


@pytest.mark.slow
def test_env__disturbed_weather_returns_with_its_episode(scratch: Path) -> None:
    """Whatever other weathers ran meanwhile, were started ahead, or were drawn anew by a seed."""
    env = make(STOCHASTIC, **FOUR)
    mine = plan(env, 1)

    def series() -> bytes:
        return env.weather(COLUMNS).values

    straight = episode(env, mine, seed=4)
    first = series()
    env.reset(seed=4)
    same(go(env, mine[:30]), straight[1:31])
    snapshot = env.snapshot()
    seen = {first}
    for seed in (None, None, 9, None, 4, None):
        env.reset(seed=seed)
        go(env, mine[:3])
        seen.add(series())
        info = back(env, snapshot)
        assert series() == first
        assert info["weather_noise"]
        same(go(env, mine[30:40]), straight[31:41])
    assert len(seen) > 4
    for _ in range(3):
        back(env, snapshot)
        assert series() == first
        same(go(env, mine[30:]), straight[31:])
    with env.branch(snapshot=snapshot) as branch:
        same(go(branch, mine[30:]), straight[31:])
    snapshot.close()
    assert series() == first
    same(episode(env, mine, seed=4), straight)
    env.reset()
    env.reset()
    assert len([path for path in within(env.local_node.folder) if path.suffix == ".epw"]) <= 4
    env.close()


@pytest.mark.slow
def test_env__reset_after_going_back_draws_as_if_nothing_had_been(scratch: Path) -> None:
    """The sequence of weathers that a seed began goes on."""
    plain, env = make(STOCHASTIC, **FOUR), make(STOCHASTIC, **FOUR)
    drawn = []
    for n, seed in enumerate((3, None, None, None)):
        _, expected = plain.reset(seed=seed)
        _, info = env.reset(seed=seed)
        drawn.append(info["weather_noise"])
        assert info["weather_noise"] == expected["weather_noise"]
        actions = plan(env, n, 4)
        same(go(env, actions), go(plain, actions))
        with env.snapshot() as snapshot:
            back(env, snapshot)
            go(env, actions)
            back(env, snapshot)
    assert len({tuple(d.items()) for d in drawn}) == 4
    plain.close()
    env.close()


@pytest.mark.slow
def test_env__rewards_and_limits_remember_what_they_did(scratch: Path) -> None:
    """A month's peak, and hours outside a range that end an episode: both need the past."""
    limit = {"points": ["core_zn_air_temperature"], "high": 27.0, "duration_h": 2.0}
    env = make(reward=PEAK, terminate=[limit], **FOUR)
    mine = [[20.0, 28.0]] * 96

    def run(actions: Any) -> list[Any]:
        rows = []
        for action in actions:
            _, earned, terminated, _, info = env.step(action)
            rows.append((earned, terminated, info["reward_terms"], info.get("terminated_by")))
            if terminated:
                break
        return rows

    env.reset()
    straight = run(mine)
    assert straight[-1][1]
    assert len({row[0] for row in straight}) > 20
    cut = len(straight) - 4  # the limit has been broken for an hour then
    env.reset()
    first = run(mine[:cut])
    snapshot = env.snapshot()
    rest = run(mine)
    assert first + rest == straight
    for fork in (env.snapshot, env.branch):
        with pytest.raises(EpisodeChanged, match="reset"):
            fork()
    with pytest.raises(EpisodeChanged, match="over"):
        env.step(mine[0])
    for _ in range(2):
        back(env, snapshot)
        assert run(mine) == straight[cut:]
    with env.branch(snapshot=snapshot) as branch:
        rows = [branch.step(action) for action in mine[:4]]
        assert [(r[1], r[2], r[4]["reward_terms"], r[4].get("terminated_by")) for r in rows] == straight[cut:]
        with pytest.raises(EpisodeChanged, match="over"):
            branch.step(mine[0])
    env.close()


@pytest.mark.slow
def test_env__with_files_kept_an_episode_after_going_back_to_sample_0_has_its_own(scratch: Path) -> None:
    """An episode that goes back keeps no files; the next one does, though its engine stands at the same sample."""
    env = make(output_dir=scratch / "kept", **FOUR)
    mine = plan(env, 1)
    straight = episode(env, mine)
    env.reset()
    snapshot = env.snapshot()
    back(env, snapshot)
    assert "output_dir" not in go_and_tell(env, mine)
    back(env, snapshot)
    assert env.reset()[1]["engine_start"] == EngineStart.STARTED
    same(go(env, mine[:-1]), straight[1:-1])
    *_, info = env.step(mine[-1])
    env.close()
    assert (Path(info["output_dir"]) / "eplusout.end").read_text().startswith("EnergyPlus Completed Successfully")


def go_and_tell(env: BuildingEnv, actions: Any) -> dict[str, Any]:
    """The last info."""
    for action in actions:
        *_, info = env.step(action)
    return info


# What cannot be


@pytest.mark.slow
def test_env__killed_snapshot_is_a_clear_error_and_the_episode_goes_on(office: BuildingEnv) -> None:
    env = office
    mine = plan(env, 1)
    straight = episode(env, mine)
    env.reset()
    go(env, mine[:20])
    other = env.snapshot()
    snapshot, engine = new_engine(env, env.snapshot)
    kill(engine)
    for _ in range(2):
        with pytest.raises(EngineDied, match="SIGKILL"):
            back(env, snapshot)
        with pytest.raises(EngineDied, match="SIGKILL"):
            env.branch(snapshot=snapshot)
    same(go(env, mine[20:50]), straight[21:51])
    snapshot.close()
    snapshot.close()
    same(go(env, mine[50:]), straight[51:])
    back(env, other)
    same(go(env, mine[20:]), straight[21:])


@pytest.mark.slow
def test_env__snapshot_that_cannot_be_gone_back_to_is_refused_by_name(office: BuildingEnv, scratch: Path) -> None:
    env, stranger = make(**FOUR), office
    with pytest.raises(EpisodeChanged, match="reset"):
        env.snapshot()
    with pytest.raises(EpisodeChanged, match="reset"):
        env.branch()
    mine = plan(env, 1)
    straight = episode(env, mine)
    for fork in (env.snapshot, env.branch):
        with pytest.raises(EpisodeChanged, match="reset"):
            fork()
    env.reset()
    go(env, mine[:20])
    stranger.reset()
    snapshot, closed = env.snapshot(), env.snapshot()
    closed.close()
    with pytest.raises(InvalidConfig, match="closed"):
        back(env, closed)
    with pytest.raises(InvalidConfig, match="closed"):
        env.branch(snapshot=closed)
    with pytest.raises(InvalidConfig, match=r"options\['snapshot'\] is 's1'; .*expected"):
        back(env, "s1")
    with pytest.raises(InvalidConfig, match=r"snapshot is 's1'; .*expected"):
        env.branch(snapshot="s1")  # type: ignore[call-overload]
    for copied in (copy.deepcopy, pickle.dumps):
        with pytest.raises(UsageError, match=r"cannot be copied or pickled, .*branch\(\) .*snapshot\(\) .*save_env"):
            copied(env)
    with pytest.raises(InvalidConfig, match="unknown reset options"):
        env.reset(options={"snapshots": snapshot})
    with pytest.raises(InvalidConfig, match=r"is of another environment's node 'building'.*; take one of this"):
        back(stranger, snapshot)
    bus, node = env.link.bus, env.manifest.node
    with pytest.raises(RequestRejected, match=snapshot.name):
        bus.reset(node, Reset(snapshot="s99"))
    with pytest.raises(RequestRejected, match=snapshot.name):
        bus.branch(node, CreateBranch(snapshot="s99"))
    with pytest.raises(RequestRejected, match=snapshot.name):
        bus.drop(node, "s99")
    with pytest.raises(RequestRejected, match="slot"):
        bus.branch(node, CreateBranch(slot=1))
    same(go(env, mine[20:]), straight[21:])
    env.close()


@pytest.mark.slow
def test_env__branch_has_no_forks_of_its_own(office: BuildingEnv) -> None:
    env = office
    mine = plan(env, 1)
    straight = episode(env, mine)
    env.reset()
    go(env, mine[:20])
    with env.snapshot() as snapshot, env.branch() as branch:
        for fork in (branch.snapshot, branch.branch):
            with pytest.raises(RequestRejected, match="ask its node 'building'"):
                fork()
        with pytest.raises(InvalidConfig, match="is of node 'building'"):
            branch.branch(snapshot=snapshot)
        for options in ({}, {"snapshot": snapshot}):
            with pytest.raises(InvalidConfig, match="a branch"):
                branch.reset(options=options)
        bus, name = branch.link.bus, branch.manifest.node
        with pytest.raises(RequestRejected, match="building"):
            bus.reset(name, Reset())
        with pytest.raises(RequestRejected, match="building"):
            bus.drop(name, snapshot.name)
        same(go(branch, mine[20:]), straight[21:])
    same(go(env, mine[20:]), straight[21:])


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("limit", [0, 2])
def test_env__there_are_no_more_forks_than_allowed(limit: int, scratch: Path) -> None:
    env = make(branches=limit, **FOUR)
    mine = plan(env, 1)
    straight = episode(env, mine)
    env.reset()
    got = go(env, mine[:5])
    forks = [env.snapshot(), env.branch()] if limit else []
    for _ in range(3):
        for fork in (env.snapshot, env.branch):
            with pytest.raises(RequestRejected, match=rf"{limit} snapshots and branches.*branches={limit}"):
                fork()
    if forks:
        back(env, forks[0])
        forks[0].close()
        with env.snapshot(), pytest.raises(RequestRejected, match="branches=2"):
            env.branch()
        forks[1].close()
        until(lambda: not env.link.bus.status("building").branches, "it has ended")
        with env.branch(), env.snapshot():
            pass
    got += go(env, mine[5:])
    same(got, straight[1:])
    env.close()


@pytest.mark.slow
def test_env__forks_may_be_closed_after_their_environment(scratch: Path) -> None:
    """It has ended them; who still holds them hears a clear word, and their `close` is quiet."""
    env = make(**FOUR)
    env.reset()
    go(env, plan(env, 1, 3))
    snapshot, branch = env.snapshot(), env.branch()
    env.close()
    with pytest.raises(ZenostatError):
        branch.step(plan(branch, 1, 1)[0])
    branch.close()
    snapshot.close()
    branch.close()
    with pytest.raises(EpisodeChanged, match="closed"):
        back(env, snapshot)


@pytest.mark.slow
def test_env__node_that_has_started_again_has_no_snapshots(scratch: Path) -> None:
    """Under the same name, at the same endpoint."""
    node = NodeProgram(scratch / "node", **SMALL_NODE)
    env = BuildingEnv(connect=node.endpoint, node="office", affinity="off")
    env.reset()
    snapshot, branch = env.snapshot(), env.branch()
    node.close()
    with pytest.raises(NodeLost):
        go(branch, plan(branch, 1, 2))
    branch.close()
    with pytest.raises(NodeLost):
        go(env, plan(env, 1, 2))
    with NodeProgram(scratch / "node", **SMALL_NODE) as node:
        again = BuildingEnv(connect=node.endpoint, node="office", affinity="off")
        again.reset()
        with pytest.raises(InvalidConfig, match="was restarted"):
            back(again, snapshot)
        with pytest.raises(InvalidConfig, match="was restarted"):
            again.branch(snapshot=snapshot)
        mine = again.snapshot()
        assert mine.name == snapshot.name
        snapshot.close()
        back(again, mine)
        again.close()
    env.close()


@pytest.mark.slow
def test_env__clock_that_is_observed_goes_back_too(scratch: Path) -> None:
    """At an hour's end and at a day's, where the timestep began within the one before."""
    fields = ("month", "day_of_month", "day_of_week", "hour", "minutes", "current_time")
    env = make(**(FOUR | {"end": "07-04"}), time=fields)
    observed = [env.reset()[0]]
    kept = []
    for step in range(1, 98):
        observed.append(env.step([20.0, 25.0])[0])
        if step in (1, 4, 96):
            kept.append((step, env.snapshot()))
    assert observed[96][:6].tolist() == [7, 3, 2, 23, 60, 24]
    for step, snapshot in kept:
        np.testing.assert_array_equal(env.reset(options={"snapshot": snapshot})[0], observed[step])
    env.close()


@pytest.mark.slow
def test_env__wrappers_know_where_a_snapshot_is(office: BuildingEnv) -> None:
    """The forecast is of the hours that come, and the clock is that of the sample."""
    env: Any = w.WeatherForecast(w.CyclicTime(office), ["dry_bulb_temperature"], n=3)
    env.reset(seed=1)
    for _ in range(40):
        seen = env.step([20.0, 25.0])[0]
    with env.unwrapped.snapshot() as kept:
        for _ in range(7):
            env.step([20.0, 25.0])
        np.testing.assert_array_equal(env.reset(options={"snapshot": kept})[0], seen)


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("slots", [0, 3])
def test_env__wrappers_remember_what_they_did(slots: int, scratch: Path) -> None:
    """Moved setpoints, what was observed before, the errors of forecasts; a log counts the steps that were taken."""
    how: Any = {"vectorization_mode": "vector_entry_point", **DAY, **FOUR}
    env: Any = gym.make_vec(SMALL, num_envs=slots, **how) if slots else make(**FOUR)
    increments, initial = {"heating_setpoint": 1.0, "cooling_setpoint": [1.0, 0.5]}, [20.0, 25.0]
    env = w.IncrementalAction(env, increments, dict(zip(increments, initial, strict=True)))
    env = w.PreviousObservation(env, ["core_zn_air_temperature"])
    env = w.WeatherForecast(env, ["dry_bulb_temperature"], n=2, errors={"dry_bulb_temperature": 2.0})
    env = w.TensorBoardLog(env, scratch / "log", every=1000)
    env.reset(seed=1)
    env.action_space.seed(1)
    actions = [env.action_space.sample() for _ in range(30)]
    for action in actions[:10]:
        stepped = env.step(action)
    with env.unwrapped.snapshot() as kept:
        straight = [env.step(action) for action in actions[10:20]]
        for other in (actions[20:], actions[:3]):
            for action in other:
                env.step(action)
            np.testing.assert_array_equal(env.reset(options={"snapshot": kept})[0], stepped[0])
            for action, expected in zip(actions[10:20], straight, strict=True):
                got = env.step(action)
                np.testing.assert_array_equal(got[0], expected[0])
                np.testing.assert_array_equal(got[1], expected[1])
        assert env.get_state()["slots"][0] == {"steps": (10 + 10 + 10 + 10 + 3 + 10) * max(slots, 1)}
        late = w.PreviousObservation(env, ["outdoor_temperature"])  # not there when the snapshot was taken
        seen = late.reset(options={"snapshot": kept})[0]
        np.testing.assert_array_equal(seen[..., :-1], stepped[0])
        np.testing.assert_array_equal(
            seen[..., -1], stepped[0][..., late.observation_names.index("outdoor_temperature")]
        )
    env.close()


def test_observation__belongs_to_the_caller(office: BuildingEnv) -> None:
    """Also if it is changed in place, as some scalers do."""
    env: Any = w.PreviousObservation(office, ["core_zn_air_temperature"])
    env.reset(seed=1)
    seen = env.step([20.0, 25.0])[0]
    expected = seen.copy()
    with env.unwrapped.snapshot() as kept:
        seen[:] = 0.0
        for _ in range(2):
            again = env.reset(options={"snapshot": kept})[0]
            np.testing.assert_array_equal(again, expected)
            again[:] = 0.0
