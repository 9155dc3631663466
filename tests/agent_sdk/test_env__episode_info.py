"""Infos of an episode: how it ended, the sources of its values, its files, a picture."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import psutil
import pytest
from support.builders import manifest, sensor
from support.nodes import command_of, until
from support.run_cli import run_python

from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.agent_sdk.envs.termination import TerminationLimits
from zenostat.topics.errors import EpisodeChanged, InvalidConfig
from zenostat.topics.messages import Task, TerminationLimit

NAME = "zenostat/ref-small-office-USA_CO_Denver-continuous-v1"
DAY = {"begin": "07-03", "end": "07-03", "steps_per_hour": 4, "affinity": "off"}


def make(**arguments: Any) -> BuildingEnv:
    env = gym.make(NAME, **(DAY | arguments)).unwrapped
    assert isinstance(env, BuildingEnv)
    return env


def limits(*of: TerminationLimit) -> TerminationLimits:
    """Limits of a node with the sensors north and south, four timesteps an hour."""
    return TerminationLimits(manifest(sensors=[sensor("north"), sensor("south")], task=Task(terminate=of)))


def broken_at(watch: TerminationLimits, rows: list[tuple[float, float]]) -> list[int]:
    return [i for i, row in enumerate(rows) if watch.violated(np.array(row))]


def test_env__limit_without_patience_ends_at_once() -> None:
    rows = [(20.0, 20.0), (26.0, 20.0), (26.1, 20.0), (20.0, 17.9)]
    assert broken_at(limits(TerminationLimit(points=("north", "south"), low=18.0, high=26.0)), rows) == [2, 3]


def test_env__limit_with_patience_counts_hours_without_a_break() -> None:
    """Half an hour is two timesteps of a quarter; a break begins anew; each point counts for itself."""
    watch = limits(TerminationLimit(points=("north", "south"), high=26.0, duration_s=1800.0))
    rows = [(27.0, 20.0), (20.0, 27.0), (27.0, 20.0), (27.0, 20.0), (20.0, 20.0)]
    assert broken_at(watch, rows) == [3]


def test_env__new_episode_forgets_what_was_outside() -> None:
    watch = limits(TerminationLimit(points=("north",), high=26.0, duration_s=1800.0))
    assert not watch.violated(np.array([27.0, 0.0]))
    watch.reset()
    assert not watch.violated(np.array([27.0, 0.0]))
    assert "north = 27" in watch.violated(np.array([27.0, 0.0]))


@pytest.mark.slow
def test_env__episode_ends_when_comfort_was_left_for_two_hours(scratch: Path) -> None:
    """With cooling as good as off on a July day; the step that says so is the eighth outside, and the last."""
    env = make(terminate=[{"points": ["core_zn_air_temperature"], "high": 26.0, "duration_h": 2}])
    observation, _ = env.reset(seed=0)
    at, outside, ended = env.observation_names.index("core_zn_air_temperature"), 0, False
    while not ended:
        observation, _, ended, truncated, info = env.step([15.0, 30.0])
        assert not truncated
        outside = outside + 1 if observation[at] > 26.0 else 0
        assert ended == (outside == 8)
    assert "core_zn_air_temperature" in info["terminated_by"]
    with pytest.raises(EpisodeChanged, match="over"):
        env.step([15.0, 30.0])
    env.reset()
    assert env.step([15.0, 30.0])[4]["terminated_by"] == ""
    env.close()


@pytest.mark.variants
@pytest.mark.parametrize(
    ("limit", "words"),
    [
        ({"points": ["core"], "high": 26.0}, "terminate.0.*no sensor or meter 'core'; did you mean 'core_zn_"),
        ({"points": ["core_zn_air_temperature"]}, "terminate.0.*a low or a high"),
        ({"points": ["core_zn_air_temperature"], "low": 3.0, "high": 2.0}, "low 3 is not below high 2"),
    ],
)
def test_env__limit_that_cannot_be_is_refused(limit: dict[str, Any], words: str, scratch: Path) -> None:
    with pytest.raises(InvalidConfig, match=words):
        make(terminate=[limit])


@pytest.mark.slow
def test_info__has_commands_and_value_sources(scratch: Path) -> None:
    env = make(control="building")
    env.reset(seed=0)
    _, _, _, _, info = env.step([20.0, 25.0])
    names = [a.name for a in env.manifest.actuators]
    expected = [20.0 if "heating" in name else 25.0 for name in names]
    assert info["action"].tolist() == info["effective"].tolist() == expected
    assert set(info["value_source"]) == {"agent"}
    assert len(info["value_source"]) == len(names)
    assert sum(info["reward_terms"].values()) == pytest.approx(env.step([20.0, 25.0])[1], abs=1.0)
    env.close()


@pytest.mark.slow
def test_info__has_what_a_person_sets(scratch: Path) -> None:
    """A write at a higher priority rules over the agent, and the step says so."""
    import zenostat

    env = make()
    env.reset(seed=0)
    with zenostat.connect(env.local_node.endpoint) as bus:
        bus.write("building", "core_zn_cooling_setpoint", 29.0, priority=8, source="facility_manager")
    at = [a.name for a in env.manifest.actuators].index("core_zn_cooling_setpoint")
    info = env.step([20.0, 25.0])[4]
    assert info["value_source"][at] == "facility_manager"
    assert (info["effective"][at], info["action"][at]) == (29.0, 25.0)
    env.close()


@pytest.mark.slow
def test_env__last_step_states_where_the_files_are(scratch: Path) -> None:
    env = make(output_dir=scratch / "kept")
    env.reset(seed=0)
    ended = False
    while not ended:
        assert env.sample.step < 96
        *_, ended, info = env.step([20.0, 25.0])
        assert bool(info["output_dir"]) == ended
    env.close()
    assert (Path(info["output_dir"]) / "eplusout.err").is_file()


@pytest.mark.slow
def test_env__picture_of_the_last_day(scratch: Path) -> None:
    """It is one of the form that Gymnasium asks for, and changes when something happens."""
    env = make(render_mode="rgb_array")
    env.reset(seed=0)
    first = env.render()
    for _ in range(20):
        env.step([20.0, 25.0])
    later = env.render()
    assert (later.dtype, later.ndim, later.shape[2]) == (np.uint8, 3, 3)
    assert first.shape == later.shape
    assert (first != later).any()
    env.close()


@pytest.mark.slow
def test_env__pictures_measure_more_than_the_agent_observes(scratch: Path) -> None:
    plain, shown = make(), make(render_mode="rgb_array")
    assert shown.observation_names == plain.observation_names
    assert shown.observation_space == plain.observation_space
    assert len(shown.manifest.points) > len(plain.manifest.points)
    plain.close()
    shown.close()
    without = make(render_mode="rgb_array", monitoring=False)
    assert without.manifest.points == plain.manifest.points
    without.close()


def test_env__render_mode_that_is_none_is_refused_before_anything_starts(scratch: Path) -> None:
    with pytest.raises(InvalidConfig, match="rgb_array, rerun"):
        BuildingEnv("ref-small-office", "USA_CO_Denver", render_mode="human")


@pytest.mark.slow
def test_env__live_view_opens_with_the_environment_and_ends_with_it(
    scratch: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    env = make(render_mode="rerun")

    def monitors() -> list[psutil.Process]:
        return [c for c in psutil.Process().children() if "monitor" in command_of(c)]

    until(lambda: len(monitors()) == 1, "the view is a program")  # at its very begin it has no command line
    env.reset(seed=0)
    assert env.render() is None
    env.close()
    assert not monitors()


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["sync", "async"])
def test_env__gymnasiums_vector_environments_hold_buildings_of_their_own(mode: str, scratch: Path) -> None:
    """Each slot is the single environment of its seed; asked of a program, since async ones start by fork or spawn."""
    code = f"""
import gymnasium as gym, numpy as np
import zenostat
given = dict(begin="07-03", end="07-03", steps_per_hour=1, affinity="off")
name = {NAME.replace("continuous", "continuous-stochastic")!r}
if __name__ == "__main__":
    many = gym.make_vec(name, num_envs=2, vectorization_mode={mode!r}, **given)
    rows = [many.reset(seed=[3, 4])[0]]
    action = np.array([[20.0, 25.0], [20.0, 25.0]], np.float32)
    for _ in range(5):
        rows.append(many.step(action)[0])
    many.close()
    for slot, seed in enumerate([3, 4]):
        one = gym.make(name, **given)
        alone = [one.reset(seed=seed)[0]] + [one.step(action[0])[0] for _ in range(5)]
        one.close()
        assert np.array_equal(np.array(alone), np.array(rows)[:, slot]), slot
    print("equal")
"""
    script = scratch / "program.py"
    script.write_text(code)
    done = run_python(str(script))
    assert (done.stdout, done.returncode) == ("equal\n", 0), done.stderr[-2000:]


@pytest.mark.slow
def test_env__environment_goes_to_one_file_and_returns_equal(scratch: Path) -> None:
    from zenostat import load_env, save_env
    from zenostat.agent_sdk.rewards import LinearReward
    from zenostat.agent_sdk.wrappers import apply_wrappers, wrappers_of

    wrappers = [{"wrapper": "CyclicTime"}, {"wrapper": "ReducedObservation", "keep": ["core_zn_air_temperature"]}]
    task = {"reward": LinearReward(weight=0.25), "control": "zone", "max_episode_steps": 3}
    env = apply_wrappers(gym.make(NAME, **DAY, **task), wrappers)
    save_env(env, scratch / "one.yaml")
    again = load_env(scratch / "one.yaml", affinity="off")
    save_env(again, scratch / "two.yaml")
    assert (scratch / "one.yaml").read_text() == (scratch / "two.yaml").read_text()
    assert (again.observation_space, again.action_space) == (env.observation_space, env.action_space)
    assert again.unwrapped.reward == env.unwrapped.reward
    assert wrappers_of(again) == wrappers_of(env)
    outcomes = []
    for one in (env, again):
        observation, _ = one.reset(seed=1)
        one.action_space.seed(3)
        steps = [one.step(one.action_space.sample()) for _ in range(3)]
        outcomes.append((observation.tolist(), [(reward, truncated) for _, reward, _, truncated, _ in steps]))
        assert [truncated for *_, truncated, _ in steps] == [False, False, True]
        one.close()
    assert outcomes[0] == outcomes[1]


def test_env__wrapper_that_cannot_be_leaves_nothing_behind(scratch: Path) -> None:
    file = scratch / "mine.yaml"
    file.write_text(
        "building: ref-small-office\nweather: USA_CO_Denver\nbegin: 07-03\nend: 07-03\n"
        "wrappers: [{wrapper: CyclicTimes}]\n"
    )
    with pytest.raises(InvalidConfig, match="no wrapper 'CyclicTimes'; did you mean 'CyclicTime'"):
        gym.make("zenostat/Scenario-v1", file=file, affinity="off")


@pytest.mark.slow
def test_env__own_reward_cannot_be_written(scratch: Path) -> None:
    from zenostat import save_env

    def mine(values: Any, begin: Any) -> dict[str, float]:
        return {"heat": -float(values["core_zn_air_temperature"])}

    env = gym.make(NAME, **DAY, reward=mine)
    with pytest.raises(InvalidConfig, match="code of your own"):
        save_env(env, scratch / "mine.yaml")
    env.close()
