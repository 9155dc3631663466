"""Scenarios in real runs: files, variants, control by zone, seeds and weather, and faults that are said beforehand."""

import subprocess
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import psutil
import pytest
import yaml
from support import data_packs as packs
from support.nodes import command_of
from support.run_cli import ZENOSTAT

import zenostat
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.eplus_node.config import read_config
from zenostat.eplus_node.plan import plan
from zenostat.models.catalog import find_weather
from zenostat.models.weather.epw import read
from zenostat.topics import codec
from zenostat.topics.errors import InvalidConfig, UnknownName, UsageError

DAY = {"begin": "07-03", "end": "07-03", "affinity": "off"}
SMALL = "zenostat/ref-small-office-USA_CO_Denver"
OWN: dict[str, Any] = {
    "building": "ref-small-office",
    "weather": ["USA_CO_Denver"],
    "begin": "07-03",
    "end": "07-03",
    "time": ["hour"],
    "sensors": {"core": ["Zone Air Temperature", "Core_ZN"]},
    "meters": {},
    "actuators": {
        "core_cooling": ["Zone Temperature Control", "Cooling Setpoint", "Core_ZN"],
        "west_cooling": ["Zone Temperature Control", "Cooling Setpoint", "Perimeter_ZN_4"],
    },
    "actions": {"cooling": {"actuators": ["core_cooling", "west_cooling"], "low": 23.0}},
    "reward": None,
}


def make(name: str, **arguments: Any) -> BuildingEnv:
    env = gym.make(name, **(DAY | arguments)).unwrapped
    assert isinstance(env, BuildingEnv)
    return env


def written(folder: Path, **changed: Any) -> Path:
    path = folder / "mine.yaml"
    path.write_text(yaml.safe_dump(OWN | changed, sort_keys=False))
    return path


def outdoors(env: BuildingEnv, column: str = "dry_bulb_temperature") -> np.ndarray:
    series = env.weather([column])
    return codec.floats(series.values, (len(series.values) // 8,), column)


def play(env: BuildingEnv, seed: int | None) -> tuple[np.ndarray, dict[str, Any]]:
    """An episode under actions that depend on the seed alone; all its observations and rewards."""
    env.action_space.seed(7)
    observation, info = env.reset(seed=seed)
    rows, ended = [np.append(observation, 0.0)], False
    while not ended:
        observation, reward, _, ended, _ = env.step(env.action_space.sample())
        rows.append(np.append(observation, reward))
    return np.array(rows), info


@pytest.mark.slow
def test_scenarios__shown_scenario_simulates_the_same(scratch: Path) -> None:
    name = "ref-small-office-USA_CO_Denver-discrete-v1"
    show = [*ZENOSTAT, "scenarios", "show", name]
    text = subprocess.run(show, capture_output=True, text=True, check=True).stdout
    (scratch / "mine.yaml").write_text(text)
    results = []
    for env in (make(f"zenostat/{name}"), make("zenostat/Scenario-v1", file=scratch / "mine.yaml")):
        results.append(
            (env.manifest.task.discrete_actions, env.manifest.sensors, env.manifest.actuators, play(env, 1)[0])
        )
        env.close()
    assert results[0][:3] == results[1][:3]
    np.testing.assert_array_equal(results[0][3], results[1][3])


@pytest.mark.slow
def test_scenarios__action_sets_all_its_actuators_and_the_clock_is_observed(scratch: Path) -> None:
    env = make("zenostat/Scenario-v1", file=written(scratch))
    assert env.observation_names == ("hour", "core")
    assert (env.action_space.low.tolist(), env.action_space.high.tolist()) == ([23.0], [30.0])
    observation, _ = env.reset(seed=0)
    hours = []
    for _ in range(12):
        observation, reward, _, _, info = env.step([25.5])
        assert info["effective"].tolist() == [25.5, 25.5]
        assert reward == 0.0
        hours.append(observation[0])
    assert hours == [0.0] * 6 + [1.0] * 6
    env.close()


@pytest.mark.slow
def test_scenarios__control_by_zone_is_a_pair_for_each_zone(scratch: Path) -> None:
    with_zones, whole = make(f"{SMALL}-continuous-v1", control="zone"), make(f"{SMALL}-continuous-v1")
    assert whole.action_names == ("heating_setpoint", "cooling_setpoint")
    assert len(with_zones.action_names) == 2 * 5
    with_zones.reset(seed=0)
    action = with_zones.action_space.sample()
    assert with_zones.step(action)[4]["effective"] == pytest.approx(action)
    with_zones.close()
    whole.close()


@pytest.mark.slow
def test_scenarios__actuators_beside_the_actions_are_context(scratch: Path) -> None:
    """They are the building's own until they are set, keep what they are set to, and can be given back."""
    actions = {"cooling": {"actuators": ["core_cooling"]}}
    env = make("zenostat/Scenario-v1", file=written(scratch, actions=actions))
    env.reset(seed=0)
    own = env.step([26.0])[4]["effective"][1]
    env.set_context({"west_cooling": 28.25})
    assert env.step([26.0])[4]["effective"].tolist() == [26.0, 28.25]
    assert env.step([27.0])[4]["effective"].tolist() == [27.0, 28.25]
    env.set_context({"west_cooling": None})
    assert env.step([27.0])[4]["effective"].tolist() == [27.0, own]
    env.close()


@pytest.mark.slow
def test_scenarios__variant_changes_the_model_and_nothing_is_left_of_it(scratch: Path) -> None:
    """With half the lights there is less electricity; the plain scenario beside it stays as it is."""
    lights = {"Lights": {"*": {"watts_per_floor_area": 2.0}}}
    totals = {}
    for name, edits in (("plain", None), ("dim", lights), ("again", None)):
        env = make(f"{SMALL}-continuous-v1", edits=edits)
        env.reset(seed=0)
        at = env.observation_names.index("electricity_facility")
        ended, total = False, 0.0
        while not ended:
            observation, _, _, ended, _ = env.step([20.0, 26.0])
            total += float(observation[at])
        env.close()
        totals[name] = total
    assert totals["dim"] < 0.8 * totals["plain"]
    assert totals["again"] == totals["plain"]


@pytest.mark.slow
def test_scenarios__same_seed_gives_the_same_trajectory_to_the_bit(scratch: Path) -> None:
    """Also in another process, and whatever was simulated before."""
    first, second = make(f"{SMALL}-continuous-stochastic-v1"), make(f"{SMALL}-continuous-stochastic-v1")
    rows, info = play(first, 5)
    other, _ = play(first, 6)
    on, _ = play(first, None)
    again, info_again = play(first, 5)
    np.testing.assert_array_equal(rows, again)
    np.testing.assert_array_equal(rows, play(second, 5)[0])
    play(second, 6)
    np.testing.assert_array_equal(on, play(second, None)[0])
    assert info["weather_noise"] == info_again["weather_noise"]
    at = first.observation_names.index("outdoor_temperature")
    assert not np.array_equal(rows[:, at], other[:, at])
    assert not np.array_equal(other[:, at], on[:, at])
    first.close()
    second.close()


@pytest.mark.slow
def test_forecasts__read_the_weather_that_is_simulated(scratch: Path) -> None:
    """At whole hours EnergyPlus's outdoor air is the row of the disturbed file, and not of the original."""
    env = make(f"{SMALL}-continuous-stochastic-v1", aggregation="instant")
    rows, _ = play(env, 2)
    at, hour = env.observation_names.index("outdoor_temperature"), round(3600 / env.manifest.step_s)
    simulated, forecast = rows[hour::hour, at], outdoors(env)[:24]
    np.testing.assert_allclose(simulated, forecast, atol=1e-5)
    file = read(find_weather("USA_CO_Denver").path)
    first = next(i for i, row in enumerate(file.times.tolist()) if row[1:3] == [7, 3])
    assert np.abs(file.column("dry_bulb_temperature")[first : first + 24] - forecast).max() > 0.1
    env.close()


@pytest.mark.slow
def test_scenarios__weathers_are_taken_in_order(scratch: Path) -> None:
    names = ["USA_CO_Denver", "USA_FL_Miami", "USA_AZ_Phoenix"]
    env = make(f"{SMALL}-continuous-v1", weather=names, weather_order="sequence")
    seen = []
    for seed in (None, None, None, None, 3, None):
        _, info = env.reset(seed=seed)
        env.step(env.action_space.sample())
        seen.append(info["weather"])
        assert env.link.bus.manifest("building").weather == info["weather"]
    assert seen == [*names, names[0], names[0], names[1]]
    env.close()


@pytest.mark.slow
def test_scenarios__weathers_are_drawn_by_the_seed(scratch: Path) -> None:
    names = ["USA_CO_Denver", "USA_FL_Miami", "USA_AZ_Phoenix"]
    env = make(f"{SMALL}-continuous-v1", weather=names)
    drawn = {seed: env.reset(seed=seed)[1]["weather"] for seed in range(8)}
    assert set(drawn.values()) <= set(names)
    assert len(set(drawn.values())) > 1
    assert env.reset(seed=4)[1]["weather"] == drawn[4]
    env.close()


@pytest.mark.slow
def test_scenarios__environment_on_a_bus_takes_the_scenario_over(scratch: Path) -> None:
    """Spaces, clock and reward come from the manifest of a node that runs elsewhere."""
    own = make(f"{SMALL}-discrete-v1", time=["month", "hour"], reward={"kind": "linear", "weight": 1.0})
    assert own.local_node is not None
    own.link.close()
    guest = gym.make("zenostat/Scenario-v1", connect=own.local_node.endpoint, node="building", affinity="off").unwrapped
    assert isinstance(guest, BuildingEnv)
    assert guest.action_space == gym.spaces.Discrete(10)
    assert guest.observation_names[:2] == ("month", "hour")
    guest.reset(seed=0)
    terms = guest.step(3)[4]["reward_terms"]
    assert terms["energy"] < 0.0
    assert terms["comfort"] == 0.0
    guest.close()
    own.close()


@pytest.mark.slow
def test_model_that_works_against_its_actuators__warns(scratch: Path) -> None:
    packs.sinergym()
    with pytest.warns(UserWarning, match="cooling_setpoint.*no effect.*FlowControlWithApproachTemperatures"):
        env = make("zenostat/smalldatacenter-hot-continuous-v1")
    with zenostat.connect(env.local_node.endpoint) as bus:
        assert "FlowControlWithApproachTemperatures" in bus.manifest("building").warnings[0]
    env.close()


@pytest.mark.slow
def test_scenarios__sinergym_configuration_of_a_users_own(scratch: Path) -> None:
    """A copy of the pack's, changed: another place, another timestep."""
    pack = packs.sinergym()
    original = next(pack.rglob("5ZoneAutoDXVAV.yaml"))
    text = original.read_text().replace("building_config: null", "building_config: {timesteps_per_hour: 2}")
    assert text != original.read_text()
    (scratch / "mine.yaml").write_text(text)
    env = make("zenostat/Sinergym-v1", config=scratch / "mine.yaml", variant="cool-discrete")
    assert env.manifest.step_s == 1800.0
    assert env.manifest.weather == "sinergym/USA_WA_Port.Angeles"
    assert env.action_space == gym.spaces.Discrete(10)
    env.reset(seed=0)
    assert env.step(9)[4]["effective"].tolist() == [21.0, 23.25]  # the last pair of the pack's own table
    env.close()


# What cannot be is said before anything starts


def broken_idf(folder: Path) -> Path:
    path = folder / "broken.idf"
    path.write_text("Version,25.2;\nBuilding,x,0,City,0.04;\nZone,a,0,0,0;\n")
    return path


def other_version(folder: Path) -> Path:
    path = folder / "old.epJSON"
    path.write_text('{"Version": {"v": {"version_identifier": "8.9"}}, "Building": {"b": {}}}')
    return path


def cut_epw(folder: Path) -> Path:
    path = folder / "cut.epw"
    whole = find_weather("USA_CO_Denver").path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    return path


FAULTS: dict[str, tuple[dict[str, Any], type[UsageError], str]] = {
    "a timestep that does not divide the hour": ({"steps_per_hour": 7}, InvalidConfig, "7 does not divide the hour"),
    "no timestep at all": ({"steps_per_hour": 0}, InvalidConfig, "0 does not divide the hour"),
    "a day that is none": ({"begin": "02-30"}, InvalidConfig, "02-30.*is not a calendar date"),
    "the leap day of a common year": ({"begin": "02-29", "end": "03-01"}, InvalidConfig, "02-29.*does not exist in"),
    "the leap day without data": ({"begin": "2020-02-29", "end": "2020-03-01"}, InvalidConfig, "29 February|02-29"),
    "a variable that is not there": ({"sensors": {"t": ["Zone Air Temprature", "Core_ZN"]}}, UnknownName,
        "no variable 'Zone Air Temprature'; did you mean 'Zone Air Temperature'"),
    "bounds upside down": (
        {"actuators": {"c": ["Zone Temperature Control", "Cooling Setpoint", "Core_ZN", 30.0, 20.0]}, "actions": None},
        InvalidConfig,
        "lower bound 30.0 is not below its upper bound 20.0",
    ),
    "a choice outside its action": ({"discrete": [{"actions": ["cooling"], "values": [[24.0], [31.0]]}]},
        InvalidConfig, "row 1: cooling = 31 is outside 23 to 30 degC"),
    "a field that the schema lacks": ({"edits": {"Lights": {"*": {"watts_per_area": 2.0}}}}, InvalidConfig,
        "watts_per_area.*did you mean 'watts_per_floor_area'"),
    "noise on what is no column": ({"weather_noise": {"dry_bulb_temp": {"sigma": 1}}}, UnknownName, "dry_bulb_temp"),
    "negative noise": ({"weather_noise": {"dry_bulb_temperature": {"sigma": -1}}}, InvalidConfig, "sigma"),
    "a field of no scenario": ({"wether": "x"}, InvalidConfig, "wether"),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_scenarios__fault_of_a_file_is_one_clear_error(fault: str, scratch: Path) -> None:
    changed, kind, words = FAULTS[fault]
    with pytest.raises(kind, match=f"(?s){words}"):
        plan(read_config({"scenario": str(written(scratch, **changed))}))


def test_scenarios__reward_of_no_kind_is_refused_by_the_environment(scratch: Path) -> None:
    with pytest.raises(InvalidConfig, match="no kind 'best'"):
        gym.make("zenostat/Scenario-v1", file=written(scratch, reward={"kind": "best"}), affinity="off")


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize(
    ("broken", "field", "kind", "words"),
    [
        (broken_idf, "building", InvalidConfig, r"broken\.idf is not a valid model"),
        (other_version, "building", InvalidConfig, r"8\.9.*25\.2"),
        (cut_epw, "weather", InvalidConfig, r"cut\.epw"),
    ],
)
def test_scenarios__broken_file_is_named(
    broken: Any, field: str, kind: type[Exception], words: str, scratch: Path
) -> None:
    path = broken(scratch)
    noise = {"weather_noise": {"dry_bulb_temperature": {"sigma": 1.0}}}
    with pytest.raises(kind, match=f"(?s){words}"):
        gym.make("zenostat/Scenario-v1", file=written(scratch, **{field: str(path)}, **noise), affinity="off")


def test_scenario_file__reports_all_its_errors_at_once(scratch: Path) -> None:
    file = written(
        scratch,
        weather=["USA_CO_Denver", "Atlantis"],
        steps_per_hour=7,
        sensors={"a": ["Zone Air Temperature", "Attic 7"], "b": ["Nothing Like It", "Core_ZN"]},
        reward={"kind": "linear", "weight": 2.0},
    )
    with pytest.raises(InvalidConfig) as caught:
        gym.make("zenostat/Scenario-v1", file=file, affinity="off")
    for words in ("Atlantis", "7 does not divide", "Attic 7", "Nothing Like It", "weight"):
        assert words in str(caught.value)
    assert not [c for c in psutil.Process().children(recursive=True) if "eplus_node" in " ".join(command_of(c))]


@pytest.mark.slow
def test_scenarios__period_over_new_year_has_all_its_timesteps(scratch: Path) -> None:
    env = make(f"{SMALL}-continuous-v1", begin="2017-12-31", end="2018-01-01", steps_per_hour=4)
    rows, _ = play(env, 0)
    assert len(rows) == 2 * 96 + 1
    env.close()


def test_scenarios__model_without_its_pack_names_the_command(monkeypatch: pytest.MonkeyPatch, scratch: Path) -> None:
    monkeypatch.setenv("ZENOSTAT_CACHE", str(scratch / "empty"))
    with pytest.raises(InvalidConfig, match="zenostat data-packs add sinergym"):
        plan(read_config({"scenario": "5zone-hot-continuous-v1"}))
