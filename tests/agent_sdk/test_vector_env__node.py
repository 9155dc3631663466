"""Several engines of one node as a vector environment: on real nodes, slot i is what a single environment is."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import yaml
from gymnasium.vector import AutoresetMode, VectorEnv
from support import data_packs as packs
from support.engine_forks import kill
from support.nodes import SMALL, NodeProgram, engines_of, runs, until
from support.vector_envs import differ, each_mode, fakes, run_both

import zenostat
from zenostat import wrappers as w
from zenostat.agent_sdk.envs.vector_env import BuildingVectorEnv
from zenostat.topics.errors import EngineDied, EpisodeChanged, InvalidConfig, RequestRejected, SimulatorError
from zenostat.topics.messages import State

ONE_DAY: dict[str, Any] = {"begin": "07-03", "end": "07-03", "affinity": "off"}


CLOSE = {"points": ["air_temperature"], "low": 15.0, "high": 25.5, "duration_h": 0.5}


SCENARIOS: dict[str, dict[str, Any]] = {
    "5zone-hot-continuous-v1": {},
    "5zone-mixed-discrete-v1": {},
    "5zone-cool-continuous-stochastic-v1": {},
    "5zone-hot-continuous-stochastic-v1": {"terminate": [CLOSE], "reward": {"kind": "exponential"}},
}


@pytest.fixture(scope="module", params=SCENARIOS)
def real(request: pytest.FixtureRequest) -> Iterator[list[VectorEnv[Any, Any, Any]]]:
    """A scenario's slots on one node, and as many single environments."""
    packs.sinergym()
    form = {**ONE_DAY, **SCENARIOS[request.param]}
    name = f"zenostat/{request.param}"
    envs: list[VectorEnv[Any, Any, Any]] = []
    try:
        envs.append(gym.make_vec(name, num_envs=2, vectorization_mode="vector_entry_point", **form))
        envs.append(gym.make_vec(name, num_envs=2, vectorization_mode="sync", **form))
        yield envs
    finally:
        for env in envs:
            env.close()


@pytest.mark.slow
@pytest.mark.variants
@each_mode
def test_vector_env__each_slot_of_a_node_is_what_a_single_environment_is(
    real: list[VectorEnv[Any, Any, Any]], mode: AutoresetMode
) -> None:
    """Through the ends of episodes, with the weather that comes next; only how an engine began may differ."""
    ours, theirs = real
    ours.autoreset_mode = theirs.autoreset_mode = mode
    ends = run_both(real, mode, 106, seed=11, but=("engine_start",))
    assert np.sum(ends, axis=0).min() >= 1
    if ours.manifest.task.terminate:
        assert any(end.any() and not end.all() for end in ends), "some ended alone"


@pytest.fixture
def small(scratch: Path) -> Iterator[BuildingVectorEnv]:
    """Three slots of the small building."""
    env = gym.make_vec("zenostat/Building-v1", num_envs=3, **SMALL, affinity="off")
    assert isinstance(env, BuildingVectorEnv)
    yield env
    env.close()


@pytest.mark.slow
def test_vector_env__engine_that_dies_ends_the_step_and_not_the_environment(small: BuildingVectorEnv) -> None:
    small.reset(seed=1)
    first = small.step(small.action_space.sample())
    assert small.local_node is not None
    victim = engines_of(small.local_node.pid)[-1]
    victim.kill()
    with pytest.raises(SimulatorError):
        small.step(small.action_space.sample())
    small.reset(seed=1)
    again = small.step(first[4]["action"])
    assert again[4]["step"].tolist() == [1, 1, 1]


@pytest.mark.slow
def test_vector_env__wrong_choice_of_slots_claims_nothing(scratch: Path) -> None:
    with NodeProgram(scratch / "node", **SMALL, slots=2) as node:
        way = {"connect": node.endpoint, "node": "office", "affinity": "off"}
        with pytest.raises(InvalidConfig, match=r"node 'office' has 2 slots, not 3: .*num_envs=2"):
            gym.make_vec("zenostat/Building-v1", num_envs=3, **way)
        with pytest.raises(InvalidConfig, match=r"node 'office' has 2 slots, not 1: .*num_envs=2"):
            gym.make("zenostat/Building-v1", **way)
        with zenostat.connect(node.endpoint, affinity="off") as bus:
            until(lambda: bus.controllers() == [], "whoever was refused has gone")
            assert bus.status("office").controllers == []
        env = gym.make_vec("zenostat/Building-v1", num_envs=2, **way)
        try:
            env.reset(seed=1)
            assert env.step(env.action_space.sample())[4]["step"].tolist() == [1, 1]
            with pytest.raises(InvalidConfig, match=r"steps_per_hour: the node at .* has its own"):
                gym.make_vec("zenostat/Building-v1", num_envs=2, **way, steps_per_hour=6)
        finally:
            env.close()


@pytest.mark.slow
def test_vector_env__plain_node_has_one_slot(scratch: Path) -> None:
    with NodeProgram(scratch / "node", **SMALL) as node:
        way = {"connect": node.endpoint, "node": "office", "affinity": "off"}
        with pytest.raises(InvalidConfig, match="node 'office' has a single slot, not 2"):
            gym.make_vec("zenostat/Building-v1", num_envs=2, **way)
        env = gym.make_vec("zenostat/Building-v1", num_envs=1, **way)
        env.reset(seed=[1])
        assert env.step(env.action_space.sample())[4]["step"].tolist() == [1]
        env.close()


@pytest.mark.slow
def test_vector_env__scenarios_wrappers_are_around_the_vector(scratch: Path) -> None:
    file = scratch / "mine.yaml"
    wrapped = [{"wrapper": "CyclicTime", "fields": ["hour"]}, {"wrapper": "RescaleAction"}]
    wrapped[1] |= {"min_action": -1.0, "max_action": 1.0}
    file.write_text(json.dumps({**SMALL, "time": ["hour"], "control": "building", "wrappers": wrapped}))
    single = gym.make("zenostat/Scenario-v1", file=file, affinity="off")
    many = gym.make_vec("zenostat/Scenario-v1", num_envs=2, file=file, affinity="off")
    try:
        assert many.single_observation_space == single.observation_space
        assert many.single_action_space == single.action_space
        assert w.wrappers_of(many) == w.wrappers_of(single)
        assert w.names_of(many) == w.names_of(single)
        rows, _ = many.reset(seed=1)
        assert rows[0].tobytes() == single.reset(seed=1)[0].tobytes()
        action = single.action_space.sample()
        assert many.step(np.stack([action, action]))[0][1].tobytes() == single.step(action)[0].tobytes()
    finally:
        single.close()
        many.close()
    file.write_text(json.dumps({**SMALL, "wrappers": [{"wrapper": "FrameStackObservation", "stack_size": 2}]}))
    with pytest.raises(InvalidConfig, match="FrameStackObservation has no vector form"):
        gym.make_vec("zenostat/Scenario-v1", num_envs=2, file=file, affinity="off")


@pytest.mark.slow
def test_vector_env__files_that_are_kept_are_a_slots_own(scratch: Path) -> None:
    settings = {**SMALL, "steps_per_hour": 1, "affinity": "off", "output_dir": scratch / "runs"}
    env = gym.make_vec("zenostat/Building-v1", num_envs=2, autoreset_mode="SameStep", **settings)
    try:
        env.reset(seed=1)
        for _ in range(24):
            *_, infos = env.step(env.action_space.sample())
        folders = infos["final_info"]["output_dir"].tolist()
        assert len(set(folders)) == 2
        assert all((Path(folder) / "eplusout.err").is_file() for folder in folders)
    finally:
        env.close()


@pytest.mark.slow
def test_vector_env__each_slot_tells_the_weather_that_it_reads(scratch: Path) -> None:
    settings = {**ONE_DAY, "building": "ref-small-office", "weather": "USA_CO_Denver", "steps_per_hour": 4}
    settings["weather_noise"] = {"dry_bulb_temperature": {"sigma": 3.0, "mu": 0.0, "tau_h": 24.0}}
    settings |= {"reward": None}
    settings["sensors"] = {"outdoors": ("Site Outdoor Air DryBulb Temperature", "Environment")}
    env = gym.make_vec("zenostat/Building-v1", num_envs=2, **settings)
    try:
        env.reset(seed=1)
        series = env.call("weather", ["dry_bulb_temperature"])
        read = [np.frombuffer(one.values)[11] for one in series]
        for _ in range(48):
            observations = env.step(env.action_space.sample())[0]
        assert read[0] != read[1]
        assert observations[:, 0].tolist() == pytest.approx(read, abs=0.051), "at 12:00, as the file's row 12 says"
        with pytest.raises(RequestRejected, match="no slot 2"):
            env.link.weather(["dry_bulb_temperature"], 2)
    finally:
        env.close()


@pytest.mark.slow
def test_vector_env__all_slots_go_back_exactly_any_number_of_times(scratch: Path) -> None:
    """With the weather of each, and what reward and limits remembered; slots had begun at different times."""
    packs.sinergym()
    warm = {"points": ["air_temperature"], "low": 15.0, "high": 40.0, "duration_h": 2.0}
    form = {**ONE_DAY, "terminate": [warm], "reward": {"kind": "peak"}, "autoreset_mode": AutoresetMode.DISABLED}
    envs = gym.make_vec(
        "zenostat/5zone-hot-continuous-stochastic-v1", num_envs=3, vectorization_mode="vector_entry_point", **form
    )
    assert isinstance(envs, BuildingVectorEnv)
    rng = np.random.default_rng(3)
    low, high = envs.single_action_space.low, envs.single_action_space.high
    actions = rng.uniform(low, high, (60, 3, len(low))).astype(np.float32)
    envs.reset(seed=5)
    for row in actions[:10]:
        envs.step(row)
    envs.reset(options={"reset_mask": np.array([False, True, False])})
    for row in actions[10:15]:
        after_step = envs.step(row)
    with envs.snapshot() as kept:
        straight = [envs.step(row) for row in actions[15:40]]
        for _ in range(2):
            seen, info = envs.reset(options={"snapshot": kept})
            np.testing.assert_array_equal(seen, after_step[0])
            assert info["step"].tolist() == [15, 5, 15]
            assert info["engine_start"].tolist() == ["snapshot"] * 3
            weather = [envs.envs[slot].weather(["dry_bulb_temperature"]).values for slot in range(3)]
            assert len(set(weather)) == 3
            for row, expected in zip(actions[15:40], straight, strict=True):
                stepped = envs.step(row)
                assert stepped[4].pop("engine_start").tolist() == ["snapshot"] * 3
                expected[4].pop("engine_start", None)
                assert [differ(*pair) for pair in zip(stepped, expected, strict=True)] == [""] * 5
            for row in actions[40:43]:
                envs.step(row)
    with pytest.raises(InvalidConfig, match="is closed; take another one"):
        envs.reset(options={"snapshot": kept})
    envs.close()


@pytest.mark.slow
def test_vector_env__snapshots_of_slots_that_cannot_be(small: BuildingVectorEnv) -> None:
    with pytest.raises(EpisodeChanged, match=r"call reset\(\) first"):
        small.snapshot()
    small.reset(seed=1)
    kept = small.snapshot()
    with pytest.raises(InvalidConfig, match="a snapshot contains all slots; leave out reset_mask"):
        small.reset(options={"snapshot": kept, "reset_mask": np.array([True, False, False])})
    for _ in range(small.manifest.steps):
        small.step(small.action_space.sample())
    with pytest.raises(EpisodeChanged, match="each slot must be in an episode"):
        small.snapshot()
    assert small.reset(options={"snapshot": kept})[1]["step"].tolist() == [0, 0, 0]
    fake = fakes(2)
    fake.reset()
    with pytest.raises(InvalidConfig, match="has no node"):
        fake.snapshot()
    with pytest.raises(InvalidConfig, match=r"of node .*; this environment is on"):
        fake.reset(options={"snapshot": kept})


BOTH = {**SMALL, "affinity": "off", "control": "building"}


def _until_reaped(env: BuildingVectorEnv, count: int) -> None:
    """Its node has had every occasion to see that engines have ended: their processes are over, and it was asked."""
    assert env.local_node is not None
    own = env.local_node.pid
    until(lambda: len([engine for engine in engines_of(own) if runs(engine)]) <= count, "engines have ended")
    for _ in range(3):
        env.link.weather(["dry_bulb_temperature"])


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("mode", [AutoresetMode.DISABLED, AutoresetMode.NEXT_STEP], ids=lambda mode: mode.value)
def test_vector_env__slot_that_has_ended_leaves_the_others_time(scratch: Path, mode: AutoresetMode) -> None:
    """However long the agent thinks then, as a learner does: the others go on, and it begins anew."""
    env: Any = gym.make_vec("zenostat/Building-v1", num_envs=2, autoreset_mode=mode, **BOTH)
    actions = np.tile([20.0, 25.0], (2, 1)).astype(np.float32)
    env.reset(seed=1)
    straight = [env.step(actions)[0][0] for _ in range(96)]
    env.reset(seed=1)
    for _ in range(5):
        env.step(actions)
    env.reset(seed=1, options={"reset_mask": np.array([True, False])})
    for _ in range(91):
        truncated = env.step(actions)[3]
    assert truncated.tolist() == [False, True]
    _until_reaped(env, 2)  # of slot 0, and the one that waits at sample 0
    assert env.link.bus.status(env.manifest.node).state is State.WAITING
    if mode is AutoresetMode.DISABLED:
        env.reset(seed=2, options={"reset_mask": np.array([False, True])})
        observations = [env.step(actions)[0] for _ in range(5)]
        np.testing.assert_array_equal([row[1] for row in observations], straight[:5])
    else:
        observations = [env.step(actions)[0] for _ in range(5)]  # the first of them begins slot 1 anew
        np.testing.assert_array_equal([row[1] for row in observations[1:]], straight[:4])
    np.testing.assert_array_equal([row[0] for row in observations], straight[91:])
    env.close()


@pytest.mark.slow
def test_vector_env__rewards_and_limits_know_the_truth_of_what_faults_disturb(scratch: Path) -> None:
    """They equal those of the single environment, to the bit."""
    plan = scratch / "faults.yaml"
    bias = {"kind": "bias", "points": "core_zn_air_temperature", "offset": 9.0}
    plan.write_text(
        yaml.safe_dump(
            {
                "seed": 3,
                "faults": [
                    bias,
                    {"kind": "drop", "points": "core_zn_occupants", "when": {"from_step": 10, "to_step": 20}},
                ],
            }
        )
    )
    limit = {"points": ["core_zn_air_temperature"], "high": 33.0}
    form = {**BOTH, "faults": plan, "terminate": [limit], "disable_env_checker": True}
    one: Any = gym.make("zenostat/Building-v1", **form)
    form.pop("disable_env_checker")
    many: Any = gym.make_vec("zenostat/Building-v1", num_envs=2, vectorization_mode="vector_entry_point", **form)
    one.reset(seed=1)
    many.reset(seed=[1, 1])
    action = np.array([20.0, 25.0], np.float32)
    for _ in range(60):
        seen, reward, terminated, _, info = one.step(action)
        rows, rewards, ends, _, infos = many.step(np.tile(action, (2, 1)))
        for slot in range(2):
            np.testing.assert_array_equal(rows[slot], seen)
            np.testing.assert_array_equal(infos["fault_free_values"][slot], info["fault_free_values"])
            assert rewards[slot] == reward
            assert ends[slot] == terminated == False  # noqa: E712
        assert np.isfinite(reward)
    one.close()
    many.close()


@pytest.mark.slow
def test_vector_env__slots_that_cannot_go_back_go_on(scratch: Path) -> None:
    env: Any = gym.make_vec("zenostat/Building-v1", num_envs=2, **BOTH)
    actions = np.tile([20.0, 25.0], (2, 1)).astype(np.float32)
    env.reset(seed=1)
    straight = [env.step(actions)[0] for _ in range(10)]
    env.reset(seed=1)
    before = {engine.pid for engine in engines_of(env.local_node.pid)}
    with env.snapshot() as kept:
        kill(next(engine for engine in engines_of(env.local_node.pid) if engine.pid not in before))
        for _ in range(2):
            with pytest.raises(EngineDied):
                env.reset(options={"snapshot": kept})
        np.testing.assert_array_equal([env.step(actions)[0] for _ in range(10)], straight)
    env.close()


@pytest.mark.slow
def test_vector_env__slots_that_go_back_see_the_clock_that_they_saw(scratch: Path) -> None:
    """At an hour's end, where the timestep began within the hour before."""
    fields = ("month", "day_of_month", "hour", "minutes", "current_time")
    env: Any = gym.make_vec("zenostat/Building-v1", num_envs=2, **BOTH, time=fields)
    actions = np.tile([20.0, 25.0], (2, 1)).astype(np.float32)
    env.reset(seed=1)
    begun = [env.step(actions)[0] for _ in range(4)][-1]
    assert begun[:, :5].tolist() == [[7, 3, 0, 60, 1]] * 2
    with env.snapshot() as kept:
        env.step(actions)
        np.testing.assert_array_equal(env.reset(options={"snapshot": kept})[0], begun)
    env.close()
