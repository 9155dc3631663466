"""The Gymnasium environment on real nodes: spaces, episodes, repeatability, rewards, points, files."""

import json
import signal
from collections.abc import Iterator
from datetime import datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from support.nodes import COOLING, SMALL, ZONES, NodeProgram, free_port, new_episode, remains
from support.run_cli import run_python

from zenostat import Bus
from zenostat.agent_sdk.rewards import LinearReward
from zenostat.models.building.model import read_building
from zenostat.models.catalog import find_building
from zenostat.topics.errors import EpisodeChanged, InvalidConfig
from zenostat.topics.messages import Aggregation

N = 96
"""Timesteps of the day that most of these tests simulate."""

HEATING = {f"{zone}_heating_setpoint": ("Zone Temperature Control", "Heating Setpoint", zone.upper()) for zone in ZONES}
POWER = {"power": ("Facility Total HVAC Electricity Demand Rate", "Whole Building")}
TEMPERATURES = {f"{zone}_temperature": ("Zone Air Temperature", zone.upper()) for zone in ZONES}


def make(**arguments: Any) -> gym.Env[Any, Any]:
    return gym.make("zenostat/Building-v1", **{**SMALL, "affinity": "off", **arguments})


@pytest.fixture(scope="module")
def env() -> Iterator[gym.Env[Any, Any]]:
    """The building with all defaults."""
    building = make()
    yield building
    building.close()


def connected(bus: Bus, **arguments: Any) -> gym.Env[Any, Any]:
    """An environment of the node that the tests of this module share."""
    new_episode(bus)
    return gym.make("zenostat/Building-v1", connect=bus.endpoint, node="office", affinity="off", **arguments)


def rollout(env: gym.Env[Any, Any], *, seed: int, steps: int = N) -> list[tuple[Any, ...]]:
    """All that comes out of `steps` random steps, in a form that is equal only to the bit."""
    env.action_space.seed(seed)
    observation, info = env.reset(seed=seed)
    rows: list[tuple[Any, ...]] = [(observation.tobytes(), info["time"], info["step"])]
    for _ in range(steps):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        terms = sorted(info["reward_terms"].items())
        step = (reward, terminated, truncated, info["time"], info["step"], info["effective"].tobytes())
        rows.append((observation.tobytes(), *step, terms))
    return rows


# Spaces and episodes


@pytest.mark.filterwarnings("ignore:.*Box observation space (minimum|maximum) value is (-)?infinity.*")
@pytest.mark.filterwarnings("ignore:.*we recommend using a symmetric and normalized space.*")
def test_env__gymnasiums_own_checker_passes(env: gym.Env[Any, Any]) -> None:
    check_env(env.unwrapped, skip_render_check=True)


def test_env__n_steps_n_plus_one_samples_and_the_last_is_truncated(env: gym.Env[Any, Any]) -> None:
    observation, info = env.reset(seed=1)
    times, ends = [datetime.fromisoformat(info["time"])], []
    assert info["step"] == 0
    for step in range(1, N + 1):
        assert observation.dtype == np.float32
        assert env.observation_space.contains(observation)
        observation, _, terminated, truncated, info = env.step(env.action_space.sample())
        assert (info["step"], terminated) == (step, False)
        times.append(datetime.fromisoformat(info["time"]))
        ends.append(truncated)
    assert env.observation_space.contains(observation)
    assert ends == [False] * (N - 1) + [True]
    assert {after - before for before, after in pairwise(times)} == {timedelta(minutes=15)}
    assert (times[0].month, times[0].day, times[0].hour) == (7, 3, 0)
    assert times[-1] - times[0] == timedelta(days=1)


def test_env__step_after_the_end_raises_and_a_reset_begins_anew(env: gym.Env[Any, Any]) -> None:
    env.reset(seed=1)
    for _ in range(N):
        *_, truncated, _ = env.step(env.action_space.low)
    assert truncated
    with pytest.raises(EpisodeChanged, match=r"the episode is over; call reset\(\)"):
        env.step(env.action_space.low)
    _, info = env.reset()
    assert info["step"] == 0
    *_, truncated, info = env.step(env.action_space.low)
    assert (truncated, info["step"]) == (False, 1)


@pytest.mark.slow
def test_env__step_before_the_first_reset_raises(shared_bus: Bus) -> None:
    with connected(shared_bus) as fresh, pytest.raises(EpisodeChanged, match=r"call reset\(\) before step\(\)"):
        fresh.unwrapped.step(fresh.action_space.low)


def test_env__bounds_come_from_units_and_limits(env: gym.Env[Any, Any]) -> None:
    manifest = env.unwrapped.manifest
    space = env.observation_space
    assert space.shape == (len(manifest.sensors) + len(manifest.meters),)
    bounds = dict(zip(manifest.names, zip(space.low.tolist(), space.high.tolist(), strict=True), strict=True))
    units = {point.name: point.unit for point in (*manifest.sensors, *manifest.meters)}
    humidities = {name for name, unit in units.items() if unit == "percent"}
    assert {"outdoor_humidity", "core_zn_relative_humidity"} <= humidities
    assert {bounds[name] for name in humidities} == {(0.0, 100.0)}
    assert units["core_zn_occupants"] == "1"
    assert bounds["core_zn_occupants"] == (0.0, np.inf)
    assert units["hvac_and_plant_power"] == "W"
    assert bounds["hvac_and_plant_power"] == (0.0, np.inf)
    assert units["electricity_facility"] == "J"
    assert units["core_zn_air_temperature"] == "degC"
    action = env.action_space
    assert (action.dtype, action.shape) == (np.float32, (10,))
    for index, actuator in enumerate(manifest.actuators):
        assert (action.low[index], action.high[index]) == (actuator.low, actuator.high)
        assert actuator.unit == "degC"


# The same again


def test_env__same_seed_gives_the_same_trajectory_to_the_bit(env: gym.Env[Any, Any]) -> None:
    first = rollout(env, seed=7)
    assert rollout(env, seed=7) == first
    assert rollout(env, seed=8) != first, "the actions make no difference"


def test_env__reset_amid_an_episode_leaves_no_trace(env: gym.Env[Any, Any]) -> None:
    first = rollout(env, seed=3, steps=10)
    rollout(env, seed=4, steps=37)
    assert rollout(env, seed=3, steps=10) == first


def test_env__two_environments_give_the_same_trajectory_to_the_bit(env: gym.Env[Any, Any], shared_bus: Bus) -> None:
    with connected(shared_bus) as other:
        assert rollout(other, seed=5) == rollout(env, seed=5)


# Control


@pytest.mark.slow
def test_env__action_at_sample_0_rules_the_first_timestep() -> None:
    """A winter night: heating to 22.5 or 15 degC makes a difference in the first quarter of an hour."""
    sensors = {
        **{f"{zone}_setpoint": ("Zone Thermostat Heating Setpoint Temperature", zone.upper()) for zone in ZONES},
        "heating": ("Zone Air System Sensible Heating Energy", "CORE_ZN"),
        **TEMPERATURES,
        **POWER,
    }
    heated = {}
    with make(begin="01-09", end="01-09", sensors=sensors, actuators=HEATING) as winter:
        for setpoint in (15.0, 22.5):
            start, _ = winter.reset(seed=1)
            observation, _, _, _, info = winter.step(np.full(5, setpoint, np.float32))
            assert info["effective"].tolist() == [setpoint] * 5
            assert observation[:5].tolist() == [setpoint] * 5
            heated[setpoint] = start.tobytes(), *winter.unwrapped.observation_dict(observation).items()
    low, high = heated[15.0], heated[22.5]
    assert low[0] == high[0], "both start from the same state"
    assert dict(high[1:])["heating"] > dict(low[1:])["heating"]
    assert dict(high[1:])["core_zn_temperature"] > dict(low[1:])["core_zn_temperature"]


@pytest.mark.slow
def test_env__no_actuators_is_the_buildings_own_control(shared_bus: Bus) -> None:
    with make(actuators={}) as own:
        assert own.action_space.shape == (0,)
        observation, _ = own.reset(seed=1)
        seen = [observation]
        truncated = False
        while not truncated:
            observation, _, _, truncated, info = own.step(np.zeros(0, np.float32))
            assert info["effective"].shape == (0,)
            seen.append(observation)
    new_episode(shared_bus)
    with shared_bus.controller("office") as link:
        relinquished = [sample.values.astype(np.float32) for sample in link]  # commands nothing
    assert np.array(seen).tobytes() == np.array(relinquished).tobytes()


# Names, points and rewards


def test_env__observation_dict_names_the_values(env: gym.Env[Any, Any]) -> None:
    observation, _ = env.reset(seed=1)
    named = env.unwrapped.observation_dict(observation)
    zones = [f"{zone}_{what}" for what in ("air_temperature", "relative_humidity", "occupants") for zone in ZONES]
    expected = {"outdoor_temperature", "outdoor_humidity", "hvac_and_plant_power", *zones}
    assert expected | {"electricity_facility", "hvac_electricity", "naturalgas_facility"} == set(named)
    assert np.array(list(named.values()), np.float32).tobytes() == observation.tobytes()
    assert 10 < named["outdoor_temperature"] < 40
    assert 15 < named["core_zn_air_temperature"] < 35


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("begin", ["05-31", "09-30"])
def test_env__default_reward_by_hand(begin: str) -> None:
    """Over a change of the comfort band: the day on which the timestep began decides."""
    end = {"05-31": "06-01", "09-30": "10-01"}[begin]
    bands = set()
    with make(begin=begin, end=end) as default:
        default.action_space.seed(1)
        default.reset(seed=1)
        truncated = False
        while not truncated:
            observation, reward, _, truncated, info = default.step(default.action_space.sample())
            values = default.unwrapped.observation_dict(observation)
            began = datetime.fromisoformat(info["time"]) - timedelta(minutes=15)
            low, high = (23.0, 26.0) if 6 <= began.month <= 9 else (20.0, 23.5)
            zones = [values[f"{zone}_air_temperature"] for zone in ZONES]
            outside = sum(max(low - zone, zone - high, 0.0) for zone in zones)
            energy, comfort = -0.5 * 1e-4 * values["hvac_and_plant_power"], -0.5 * 1.0 * outside
            assert reward == pytest.approx(energy + comfort, rel=1e-5, abs=1e-5)  # observations are float32
            terms = info["reward_terms"]
            assert reward == terms["energy"] + terms["comfort"]
            assert terms["energy"] == pytest.approx(energy, rel=1e-6)
            assert terms["comfort"] == pytest.approx(comfort, rel=1e-5, abs=1e-5)
            assert isinstance(reward, float)
            bands.add((low, high))
    assert bands == {(23.0, 26.0), (20.0, 23.5)}


def test_env__reward_of_the_users_and_none(shared_bus: Bus) -> None:
    with connected(shared_bus, reward=LinearReward(weight=1.0, lambda_energy=1.0)) as energetic:
        energetic.reset(seed=1)
        observation, reward, *_ = energetic.step(energetic.action_space.low)
        assert reward == pytest.approx(-energetic.unwrapped.observation_dict(observation)["hvac_and_plant_power"])
    with connected(shared_bus, reward=None) as plain:
        plain.reset(seed=1)
        _, reward, _, _, info = plain.step(plain.action_space.low)
        assert reward == 0.0
        assert "reward_terms" not in info


@pytest.mark.slow
def test_env__sensors_meters_and_actuators_of_the_users() -> None:
    chosen = make(
        sensors={
            "outside": ("site outdoor air drybulb temperature", "environment"),
            "inside": ("Zone Air Temperature", "CORE_ZN", "mean"),
            "cooled": ("Zone Air System Sensible Cooling Energy", "Core_ZN"),
            **POWER,
        },
        meters={"lights": "InteriorLights:Electricity", "all": "Electricity:Facility"},
        actuators={"cooling": (*COOLING["core_zn_cooling_setpoint"], 23, 27.5)},
    )
    with chosen:
        manifest = chosen.unwrapped.manifest
        assert manifest.names == ("outside", "inside", "cooled", "power", "lights", "all")
        readings = {sensor.name: sensor.aggregation for sensor in manifest.sensors}
        assert readings == {
            "outside": Aggregation.INSTANT,
            "inside": Aggregation.MEAN,
            "cooled": Aggregation.SUM,
            "power": Aggregation.MEAN,
        }
        assert [actuator.name for actuator in manifest.actuators] == ["cooling"]
        assert (chosen.action_space.low.tolist(), chosen.action_space.high.tolist()) == ([23.0], [27.5])
        chosen.reset(seed=1)
        for _ in range(50):
            observation, _, _, _, info = chosen.step(np.array([24.0], np.float32))
        values = chosen.unwrapped.observation_dict(observation)
        assert info["effective"].tolist() == [24.0]
        assert 0 < values["lights"] < values["all"]
        assert values["cooled"] > 0


@pytest.mark.slow
def test_env__building_by_path(env: gym.Env[Any, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An IDF by its path and an epJSON by a relative one are the building of that short name."""
    entry = find_building(SMALL["building"])
    epjson = tmp_path / "mine.epJSON"
    epjson.write_text(json.dumps(read_building(entry).objects))
    monkeypatch.chdir(tmp_path)
    expected = rollout(env, seed=2, steps=5)
    for building in (entry.path, "mine.epJSON"):
        with make(building=building) as by_path:
            assert rollout(by_path, seed=2, steps=5) == expected


# Elsewhere


@pytest.mark.slow
def test_env__node_that_runs_elsewhere(folder: Path, env: gym.Env[Any, Any]) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with NodeProgram(folder, **SMALL, listen=[endpoint]) as node:
        with gym.make("zenostat/Building-v1", connect=endpoint, node="office", affinity="off") as remote:
            assert remote.unwrapped.local_node is None
            assert remote.observation_space == env.observation_space
            expected = rollout(remote, seed=6)
        assert node.process.poll() is None, "the node belongs to somebody else and goes on"
        with gym.make("zenostat/Building-v1", connect=endpoint, node="office", affinity="off") as again:
            assert rollout(again, seed=6) == expected
    assert expected == rollout(env, seed=6)


def test_connect__rejects_settings_that_the_node_decides(folder: Path) -> None:
    with pytest.raises(InvalidConfig, match=r"building, begin: the node at tcp/127.0.0.1:1 has its own"):
        gym.make("zenostat/Building-v1", connect="tcp/127.0.0.1:1", node="office", building="x", begin="07-01")
    with pytest.raises(InvalidConfig, match=r"connect='tcp/127.0.0.1:1' needs the node's name"):
        gym.make("zenostat/Building-v1", connect="tcp/127.0.0.1:1")


# Import, files


def test_env__import_is_light() -> None:
    """Neither Rerun nor EnergyPlus nor the rooms of the building's side."""
    text = "import sys, zenostat; zenostat.connect; print(*sorted(sys.modules))"
    done = run_python("-P", "-c", text, check=True)
    loaded = set(done.stdout.split())
    assert "zenostat.bridge.client.bus" in loaded
    assert not loaded & {"rerun", "rerun_sdk", "rerun_bindings", "pyenergyplus"}
    assert not loaded & {"zenostat.eplus_node", "zenostat.models"}


@pytest.mark.slow
def test_output_dir__is_the_only_place_where_files_are_kept(scratch: Path) -> None:
    kept = scratch / "kept"
    with make(output_dir=kept) as keeping:
        rollout(keeping, seed=1)
        rollout(keeping, seed=1, steps=10)  # EnergyPlus keeps no empty files; it reports hourly
    assert remains(scratch) == []
    whole, left_early = sorted(kept.iterdir())
    for episode in (whole, left_early):
        files = {file.name for file in episode.iterdir()}
        assert {"in.epJSON", "eplusout.err", "eplusout.eso"} <= files
        assert "EnergyPlus Completed Successfully" in (episode / "eplusout.end").read_text()


@pytest.mark.slow
def test_env__nothing_is_kept_unasked(scratch: Path) -> None:
    with make() as plain:
        rollout(plain, seed=1)
        assert remains(scratch), "a run has a folder of its own while it lasts"
    assert list(scratch.iterdir()) == []


@pytest.mark.slow
def test_env__close_twice_and_unused(scratch: Path) -> None:
    plain = make()
    plain.close()
    plain.close()
    assert list(scratch.iterdir()) == []


_FORKS = """
import os, sys, signal
import gymnasium as gym
import zenostat
env = gym.make("zenostat/Building-v1", building="ref-small-office", weather="USA_CO_Denver", begin="07-03", end="07-03")
held = env.unwrapped.local_node._processes[0]
child = os.fork()
if not child:
    signal.pause()  # it has inherited all that its parent has open
env.close()
print(held.returncode, flush=True)
os.kill(child, signal.SIGKILL)
os.waitpid(child, 0)
"""


@pytest.mark.slow
def test_env__forked_process_does_not_keep_its_parents_node(scratch: Path) -> None:
    """The node ends by itself, as its owner lets go, and is not killed after a long wait."""
    done = run_python("-P", "-c", _FORKS, check=True, cwd=scratch, timeout=120)
    assert int(done.stdout) != -signal.SIGKILL
