"""Arguments of an environment, as the settings of a node: no node is started here."""

import json
from datetime import date, datetime
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import zenostat  # noqa: F401  # registers the environments
from zenostat.agent_sdk.envs.arguments import FROM_SCENARIO, check_agent_settings, fields_of_file
from zenostat.agent_sdk.envs.vector_env import check_count, check_mode
from zenostat.bridge.client.node_arguments import for_node
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.eplus_node.config import read_config
from zenostat.models.catalog import find_building
from zenostat.topics.errors import InvalidConfig, UnknownArgument, UsageError
from zenostat.topics.messages import Aggregation
from zenostat.topics.scenario_fields import NODE_ARGUMENTS

BASE: dict[str, Any] = {"building": "office-small", "weather": "USA_CO_Denver"}
TEMPERATURE = ("Zone Air Temperature", "Core_ZN")


@pytest.fixture
def user_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Working folder of the user, with their files."""
    for name in ("mine.idf", "mine.epw", "other.epw", "mine.yaml"):
        (tmp_path / name).write_text("")
    monkeypatch.chdir(tmp_path)
    return tmp_path


# Names


def test_env__short_names_stay_and_the_node_gets_its_own() -> None:
    assert for_node(BASE, "office") == {**BASE, "name": "office"}


def test_env__names_with_a_dot_are_no_paths(user_folder: Path) -> None:
    arguments = {"building": "office-small", "weather": ["USA_CA_San.Francisco", "USA_OK_Oklahoma.City"]}
    assert for_node(arguments, "b") == {**arguments, "name": "b"}


@pytest.mark.parametrize("priority", [0, 17, 2.5, "3", True, float("nan")])
def test_env__invalid_priority_is_refused_before_anything_starts(priority: Any) -> None:
    with pytest.raises(InvalidConfig, match="priority"):
        gym.make("zenostat/Building-v1", **BASE, priority=priority)
    with pytest.raises(InvalidConfig, match="priority"):
        gym.make("zenostat/Building-v1", connect="tcp/127.0.0.1:1", node="office", priority=priority)


def test_env__unknown_placement_is_refused_before_anything_starts() -> None:
    with pytest.raises(InvalidConfig, match="affinity 'x'; there are: apart, node, together, off"):
        gym.make("zenostat/Building-v1", **BASE, affinity="x")


# Paths


@pytest.mark.parametrize("form", [str, Path])
def test_env__file_of_a_plant_is_made_absolute_and_a_module_stays(user_folder: Path, form: Any) -> None:
    assert for_node({"plant": form("tank.py:Tank")}, "b")["plant"] == f"{user_folder}/tank.py:Tank"
    assert for_node({"plant": "my.tanks:Tank"}, "b")["plant"] == "my.tanks:Tank"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({**BASE, "plant_arguments": {}}, r"plant_arguments needs a plant: plant='FILE.py:CLASS', fmu"),
        ({}, "name a building and a weather, a scenario, a file"),
        ({"building": "office-small"}, "name a building and a weather, a scenario, a file"),
        ({"weather": "USA_CO_Denver"}, "name a building and a weather, a scenario, a file"),
        ({"begin": "07-01"}, "name a building and a weather, a scenario, a file"),
        ({"scenario": {"building": "office-small"}}, "the name of a scenario or the path of its file expected"),
        ({"scenario": 3}, "the name of a scenario or the path of its file expected"),
    ],
)
def test_for_node__states_which_argument_is_missing_or_of_another_form(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidConfig, match=message):
        for_node(arguments, "b")


@pytest.mark.parametrize("value", [print, {1, 2}, [object()]])
def test_arguments__of_a_plant_are_what_json_can_represent(value: Any) -> None:
    assert for_node({"plant": "a:B", "plant_arguments": {"size": np.float64(2.0)}}, "b")["plant_arguments"] == {
        "size": 2.0
    }
    with pytest.raises(InvalidConfig, match=r"plant_arguments: size = .* cannot be sent"):
        for_node({"plant": "a:B", "plant_arguments": {"size": value}}, "b")


@pytest.mark.parametrize("form", [str, Path])
def test_env__paths_of_files_are_made_absolute(user_folder: Path, form: Any) -> None:
    arguments = {"building": form("mine.idf"), "weather": form("mine.epw"), "output_dir": form("kept")}
    settings = for_node(arguments, "b")
    assert settings["building"] == str(user_folder / "mine.idf")
    assert settings["weather"] == str(user_folder / "mine.epw")
    assert settings["output_dir"] == str(user_folder / "kept"), "a folder that is still to be made"


@pytest.mark.parametrize("form", [tuple, list])
def test_env__each_of_several_weathers_is_made_absolute(user_folder: Path, form: Any) -> None:
    arguments = {**BASE, "weather": form(["mine.epw", Path("other.epw"), "USA_CO_Denver"])}
    assert for_node(arguments, "b")["weather"] == [
        str(user_folder / "mine.epw"),
        str(user_folder / "other.epw"),
        "USA_CO_Denver",
    ]


def test_env__path_in_the_users_home_is_found(user_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(user_folder))
    settings = for_node({"building": "~/mine.idf", "weather": "~/mine.epw"}, "b")
    assert (settings["building"], settings["weather"]) == (str(user_folder / "mine.idf"), str(user_folder / "mine.epw"))


@pytest.mark.parametrize(
    "use",
    [
        lambda: for_node({**BASE, "output_dir": "kept"}, "b"),
        lambda: find_building("mine.idf"),
        lambda: gym.make("zenostat/Scenario-v1", file="mine.yaml"),
    ],
    ids=["output_dir", "building", "file"],
)
def test_env__relative_path_needs_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, use: Any) -> None:
    folder = tmp_path / "removed"
    folder.mkdir()
    monkeypatch.chdir(folder)
    folder.rmdir()
    with pytest.raises(InvalidConfig, match="is a relative path, and the working directory no longer exists"):
        use()


def test_env__home_of_nobody_is_a_mistake_of_the_users() -> None:
    with pytest.raises(UsageError, match="nobody_of_that_name"):
        read_and_find({"building": "~nobody_of_that_name/x.idf", "weather": "USA_CO_Denver"})


def read_and_find(arguments: dict[str, Any]) -> None:
    """Check the settings as a node does before it starts anything."""
    from zenostat.eplus_node.plan import plan

    plan(read_config(for_node(arguments, "b")))


def test_env__scenario_file_is_the_scenario(user_folder: Path) -> None:
    settings = for_node({"file": Path("mine.yaml"), "begin": "07-01"}, "b")
    assert settings == {"scenario": str(user_folder / "mine.yaml"), "begin": "07-01", "name": "b"}


def test_env__configuration_file_is_made_absolute(user_folder: Path) -> None:
    settings = for_node({"config": "theirs.yaml", "variant": "hot-continuous"}, "b")
    assert settings == {"config": str(user_folder / "theirs.yaml"), "variant": "hot-continuous", "name": "b"}


@pytest.mark.parametrize(
    "scenario", ["office-small-USA_CO_Denver-continuous-v1", "office-small-USA_CA_San.Francisco-discrete-v1"]
)
def test_env__scenarios_id_stays(user_folder: Path, scenario: str) -> None:
    assert for_node({"scenario": scenario}, "b")["scenario"] == scenario


def test_read_config__number_of_kept_folders_needs_a_folder_to_keep_them_in(tmp_path: Path) -> None:
    with pytest.raises(InvalidConfig, match="keep_last needs output_dir, the folder in which output files are kept"):
        read_config({**BASE, "keep_last": 1})
    assert read_config({**BASE, "keep_last": 1, "output_dir": tmp_path}).keep_last == 1


def test_read_config__variant_needs_the_configuration_that_it_is_of() -> None:
    with pytest.raises(InvalidConfig, match="variant needs config, the Sinergym configuration"):
        read_config({**BASE, "variant": "hot-discrete"})


# Values of other classes


@pytest.mark.parametrize(
    "day", [date(2017, 7, 3), datetime(2017, 7, 3), "2017-07-03"], ids=lambda day: type(day).__name__
)
def test_env__days_may_be_dates(day: Any) -> None:
    assert for_node({**BASE, "begin": day, "end": day}, "b") == {
        **BASE, "begin": "2017-07-03", "end": "2017-07-03", "name": "b",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"weather": {"USA_CO_Denver"}}, r"weather = {'USA_CO_Denver'} cannot be sent to the node's process"),
        ({"output_dir": ""}, "output_dir is empty; leave it out, or name a folder"),
        ({"record": ""}, "record is empty; leave it out, or name a file"),
    ],
    ids=["set", "folder", "file"],
)
def test_env__what_cannot_be_sent_is_refused_by_its_name(wrong: dict[str, Any], text: str) -> None:
    with pytest.raises(InvalidConfig, match=text):
        for_node({**BASE, **wrong}, "b")


@pytest.mark.parametrize(
    ("wrong", "error", "text"),
    [
        ({"keys": 3}, InvalidConfig, "keys = 3; a folder, or a certificate in it, expected"),
        ({"seed": 3}, UnknownArgument, r"argument 'seed'; pass it to reset\(seed=…\)"),
        ({"wrappers": []}, UnknownArgument, "argument 'wrappers'; it is a field of scenario files; .*apply_wrappers"),
        ({"lin": 3}, UnknownArgument, r"argument 'lin'; (?!.*'link')"),
    ],
    ids=lambda wrong: next(iter(wrong)) if isinstance(wrong, dict) else "",
)
def test_env__arguments_that_cannot_be(wrong: dict[str, Any], error: type[UsageError], text: str) -> None:
    with pytest.raises(error, match=text):
        gym.make("zenostat/Building-v1", **BASE, **wrong)


@pytest.mark.parametrize(("mode", "text"), [("NEXT_STEP", "did you mean 'NextStep'"), ("next_step", "'NextStep'")])
def test_check_mode__suggests_similar_modes(mode: str, text: str) -> None:
    with pytest.raises(InvalidConfig, match=text):
        check_mode(mode)


@pytest.mark.parametrize("count", [0, 257, 2.0, "2"])
def test_check_count__names_the_whole_numbers(count: Any) -> None:
    with pytest.raises(InvalidConfig, match=f"num_envs = {count!r}; a whole number from 1 to 256 expected"):
        check_count(count)


# What to simulate


@pytest.mark.parametrize(
    "named", [("scenario", "file"), ("scenario", "config"), ("file", "config"), ("scenario", "file", "config")]
)
def test_env__one_thing_states_what_to_simulate(named: tuple[str, ...]) -> None:
    with pytest.raises(InvalidConfig, match=" and ".join(named)):
        for_node(dict.fromkeys(named, "x.yaml"), "b")


def test_env__building_may_stand_beside_a_scenario() -> None:
    settings = for_node({"scenario": "office-small-USA_CO_Denver-continuous-v1", "building": "warehouse"}, "b")
    assert settings["building"] == "warehouse"


# Points


@pytest.mark.parametrize("kind", ["sensors", "actuators"])
@pytest.mark.parametrize("spec", ["Zone Air Temperature", 5, None, 1.5], ids=str)
def test_env__point_is_a_list_of_names(kind: str, spec: Any) -> None:
    with pytest.raises(InvalidConfig, match=rf"{kind} 'core': a tuple of EnergyPlus's names expected"):
        for_node({**BASE, kind: {"core": spec}}, "b")


@pytest.mark.parametrize("kind", ["sensors", "actuators"])
@pytest.mark.parametrize("points", [["core"], "core", 5], ids=str)
def test_env__points_stand_under_names(kind: str, points: Any) -> None:
    with pytest.raises(InvalidConfig, match=kind):
        for_node({**BASE, kind: points}, "b")


def test_env__points_may_be_tuples_lists_or_by_field() -> None:
    by_field = {"variable": "Zone Air Temperature", "key": "Core_ZN", "aggregation": "mean"}
    sensors = {"a": TEMPERATURE, "b": list(TEMPERATURE), "c": (*TEMPERATURE, Aggregation.MEAN), "d": by_field}
    settings = for_node({**BASE, "sensors": sensors}, "b")["sensors"]
    plain = ["Zone Air Temperature", "Core_ZN"]
    assert settings == {"a": plain, "b": plain, "c": [*plain, "mean"], "d": by_field}


def test_env__no_points_is_not_the_same_as_points_left_out() -> None:
    assert for_node({**BASE, "actuators": {}}, "b")["actuators"] == {}
    assert "actuators" not in for_node(BASE, "b")


# As JSON


def test_env__what_travels_is_plain() -> None:
    arguments = {
        **BASE,
        "output_dir": Path("/kept"),
        "time": ("hour", "month"),
        "weather_noise": {"dry_bulb_temperature": {"sigma": (1.0, 2.0)}},
        "actuators": {"core": ("Zone Temperature Control", "Heating Setpoint", "Core_ZN", 15, None)},
        "actions": {"heat": {"actuators": ("core",)}},
        "discrete": ({"actions": ("heat",), "values": ((15.0,), (20.0,))},),
        "edits": {"Material": {"Insulation": {"conductivity": 0.03}, "Other": None}},
    }
    settings = for_node(arguments, "b")
    assert json.loads(json.dumps(settings)) == settings
    assert settings["weather_noise"] == {"dry_bulb_temperature": {"sigma": [1.0, 2.0]}}
    assert settings["discrete"] == [{"actions": ["heat"], "values": [[15.0], [20.0]]}]
    assert settings["edits"] == arguments["edits"]


def test_env__numpys_numbers_are_numbers() -> None:
    arguments = {
        **BASE,
        "steps_per_hour": np.int64(4),
        "actuators": {"core": ("Fan", "Fan Air Mass Flow Rate", "FAN 1", np.float32(0.5), np.float64(2.0))},
        "discrete": [{"actions": ["core"], "values": np.linspace(0.5, 2.0, 4).reshape(-1, 1)}],
    }
    settings = json.loads(json.dumps(for_node(arguments, "b")))
    assert settings["steps_per_hour"] == 4
    assert settings["actuators"]["core"][3:] == [0.5, 2.0]
    assert settings["discrete"][0]["values"] == [[0.5], [1.0], [1.5], [2.0]]


def test_env__node_knows_every_setting_that_is_handed_on() -> None:
    named = dict.fromkeys(set(NODE_ARGUMENTS) - {"file", "plant", "fmu", "grid", "plant_arguments"}, None)
    with pytest.raises(InvalidConfig, match="no setting 'colour'") as raised:
        read_config({**named, "colour": "red"})
    assert str(raised.value).count("no setting") == 1


# The reward in a file


def test_env__reward_of_a_file_is_read(tmp_path: Path) -> None:
    file = tmp_path / "mine.yml"
    file.write_text("building: b\nreward: {kind: linear, weight: 0.25}\n")
    assert fields_of_file(str(file))["reward"] == {"kind": "linear", "weight": 0.25}


@pytest.mark.parametrize(
    "content",
    [
        b"building: b", b"reward: null", b"- reward", b"", b"{", b"a: [", b"reward: {a: b", b"day: 2018-13-45",
        b"reward: \xff\xfe\x00",
    ],
)  # fmt: skip
def test_env__file_without_a_reward_has_none(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "mine.yaml"
    file.write_bytes(content)
    assert fields_of_file(str(file)).get("reward") is None


@pytest.mark.parametrize("scenario", ["", "office-small-USA_CO_Denver-continuous-v1", "gone.yaml"])
def test_env__what_is_no_file_has_no_reward_to_read(user_folder: Path, scenario: str) -> None:
    assert fields_of_file(scenario).get("reward") is None


def test_env__folder_is_no_file(tmp_path: Path) -> None:
    (tmp_path / "folder.yaml").mkdir()
    assert fields_of_file(str(tmp_path / "folder.yaml")).get("reward") is None


def test_env__good_reward_starts_nothing(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("reward: {kind: linear, weight: 0.25}\n")
    for reward in (None, "linear", {"kind": "linear"}, FROM_SCENARIO):
        check_agent_settings(reward, {"scenario": str(file)}, Affinity.OFF)


def test_for_node__reports_a_reward_of_a_wrong_form_once(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("building: no-such-building\nweather: USA_CO_Denver\nreward: 7\nwrappers: [{wrapper: Frames}]\n")
    with pytest.raises(InvalidConfig) as raised:
        check_agent_settings(FROM_SCENARIO, for_node({"file": file}, "b"), Affinity.OFF)
    assert "mine.yaml: reward: a mapping expected, got 7" in str(raised.value)
    assert str(raised.value).count("reward: ") == 1


def test_for_node__reports_a_bad_reward_with_all_other_errors(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("building: no-such-building\nweather: USA_CO_Denver\nreward: {kind: linear, weight: 3}\n")
    with pytest.raises(InvalidConfig) as raised:
        check_agent_settings(FROM_SCENARIO, for_node({"file": file}, "b"), Affinity.OFF)
    assert [w for w in ("reward: weight", "no building 'no-such-building'") if w not in str(raised.value)] == []
