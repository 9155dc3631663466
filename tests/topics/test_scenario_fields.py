"""One definition of a scenario's arguments serves environments, scenario files, the command line and the docs."""

import inspect
import re
from pathlib import Path
from typing import Any

import pytest
from support.arguments_page import PAGE, options, page
from typer.main import get_command
from typer.testing import CliRunner

import zenostat.cli.node
from zenostat.agent_sdk.env_factory import make, make_vec
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.agent_sdk.envs.vector_env import BuildingVectorEnv
from zenostat.bridge.python_plant.node import PlantSettings
from zenostat.cli.commands import app
from zenostat.cli.scenarios import scenario_schema
from zenostat.eplus_node.config import NodeConfig, read_config
from zenostat.models.scenario.schema import Scenario, read_scenario
from zenostat.topics.errors import InvalidConfig, UnknownArgument
from zenostat.topics.scenario_fields import MEANING, NODE_ARGUMENTS, FileFields, expand_arguments

FILE_ONLY = set(FileFields.__annotations__)


def test_scenario_fields__fields_of_a_file_are_those_that_the_schema_validates() -> None:
    assert set(Scenario.model_fields) <= MEANING.keys()
    assert set(Scenario.model_fields) - set(NODE_ARGUMENTS) == FILE_ONLY


def test_scenario_fields__each_argument_is_a_setting_of_a_node() -> None:
    settings = {*NodeConfig.model_fields, *Scenario.model_fields, *PlantSettings.model_fields}
    assert set(NODE_ARGUMENTS) - settings == {"file"}  # becomes `scenario`


@pytest.mark.parametrize("name", MEANING)
def test_scenario_fields__meaning_is_one_sentence(name: str) -> None:
    assert re.fullmatch(r"[A-Z](?:[^.]|\.(?=\w))*\.", MEANING[name])


@pytest.mark.parametrize("env_type", [BuildingEnv, BuildingVectorEnv])
def test_scenario_fields__signature_of_an_environment_lists_each_argument(env_type: type) -> None:
    parameters = inspect.signature(env_type).parameters
    assert set(NODE_ARGUMENTS) <= parameters.keys()
    assert {parameters[name].default for name in NODE_ARGUMENTS} == {None}
    assert not any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values())
    assert not FILE_ONLY - {"reward"} & parameters.keys()


def test_scenario_fields__building_and_weather_may_be_positional() -> None:
    names = list(inspect.signature(BuildingEnv).parameters.values())
    assert [p.name for p in names if p.kind is p.POSITIONAL_OR_KEYWORD] == ["building", "weather"]


def test_scenario_fields__function_keeps_its_own_parameters() -> None:
    def function(self: Any, building: str = "own", *, more: int = 2, **arguments: Any) -> None:
        raise NotImplementedError

    parameters = inspect.signature(expand_arguments(function)).parameters
    assert list(parameters)[:3] == ["self", "building", "more"]
    assert (parameters["building"].default, parameters["more"].default) == ("own", 2)
    assert set(parameters) == {"self", "more", *NODE_ARGUMENTS}


@pytest.mark.parametrize("function", [BuildingEnv, BuildingVectorEnv, make, make_vec])
def test_scenario_fields__unknown_argument_is_named_with_a_near_one(function: Any) -> None:
    with pytest.raises(
        UnknownArgument, match="unexpected keyword argument 'wheather'; did you mean 'weather'"
    ) as raised:
        function(building="office-small", wheather="USA_CO_Denver", sizng="model")
    assert "'sizng'; did you mean 'sizing'" in str(raised.value)


def _settings(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> dict[str, Any]:
    """The settings that `zenostat node` hands to the node."""
    runs: list[dict[str, Any]] = []
    monkeypatch.setattr(zenostat.cli.node, "_run", lambda settings, **_: runs.append(settings))
    result = CliRunner().invoke(app, ["node", *arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return runs[0]


def test_scenario_fields__command_line_has_the_defaults_of_a_node(monkeypatch: pytest.MonkeyPatch) -> None:
    config, _ = zenostat.cli.node._read(_settings(monkeypatch))
    assert config.monitoring  # on the bus there may be a monitor; an environment has none by default
    assert config.model_copy(update={"scenario_fields": {}, "monitoring": False}) == NodeConfig()


def test_scenario_fields__each_option_sets_its_argument(monkeypatch: pytest.MonkeyPatch) -> None:
    values = {
        "scenario": "mine.yaml", "building": "b", "weather": "w", "begin": "07-01", "end": "07-02",
        "steps_per_hour": 6, "output_dir": "/o", "keep_last": 2, "monitoring": False, "systems": True,
        "baseline": True, "branches": 3,
        "unresponsive_s": 4.5, "shrink_caches": False, "faults": "f.yaml", "alarms": "a.yaml", "plant": "tank.py:Tank",
        "record": "runs", "record_on_full": "stop", "fmu": "tank.fmu", "grid": "feeder.yaml",
    }  # fmt: skip
    flags = {name: option for name, option in options().items() if name in NODE_ARGUMENTS}
    assert flags.keys() == values.keys()
    words = [[flags[name]] if isinstance(value, bool) else [flags[name], str(value)] for name, value in values.items()]
    settings = _settings(monkeypatch, *(word for pair in words for word in pair))
    paths = {name: Path(values[name]) for name in ("output_dir", "faults", "alarms", "record")}
    expected = {**values, "weather": ["w"], **paths}
    assert {name: settings[name] for name in values} == expected


def test_scenario_fields__settings_that_are_no_arguments_follow_their_options(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = _settings(
        monkeypatch, "--mode", "paced", "--speed", "60", "--grace", "1.5", "--deadline", "2.5", "--no-listen",
        "--connect", "tcp/127.0.0.1:1", "--slots", "2", "--name", "office",
    )  # fmt: skip
    config, _ = zenostat.cli.node._read(settings)
    assert (config.mode, config.speed, config.grace_s, config.deadline_s) == ("paced", 60.0, 1.5, 2.5)
    assert (config.listen, config.connect, config.slots, config.name) == ([], ["tcp/127.0.0.1:1"], 2, "office")


@pytest.mark.parametrize(
    ("command", "names"),
    [
        ("node", [name for name in options() if name in NODE_ARGUMENTS]),
        ("evaluate", ["begin", "end"]),
        ("probe", ["begin", "end"]),
        ("demo", ["building"]),
    ],
)
def test_scenario_fields__help_of_a_command_has_the_same_sentence(command: str, names: list[str]) -> None:
    parameters = get_command(app).commands[command].params  # type: ignore[attr-defined]
    help_texts = {parameter.name: parameter.help for parameter in parameters}
    described = [name for name in names if f"no_{name}" not in help_texts]  # an option that turns it off says that
    assert [name for name in described if not help_texts[name].startswith(MEANING[name])] == []


def test_scenario_fields__help_of_an_option_that_turns_something_off_says_so() -> None:
    parameters = get_command(app).commands["node"].params  # type: ignore[attr-defined]
    help_texts = {parameter.name: parameter.help for parameter in parameters if parameter.name.startswith("no_")}
    assert {"no_monitoring", "no_shrink_caches"} <= help_texts.keys()
    assert [name for name, text in help_texts.items() if not text.startswith(("Do not ", "Leave ", "Only "))] == []


def test_scenario_fields__schema_of_scenario_files_describes_each_field() -> None:
    properties = scenario_schema()["properties"]
    assert {name: schema["description"] for name, schema in properties.items()} == {
        name: MEANING[name] for name in Scenario.model_fields
    }


def test_scenario_fields__page_is_what_the_code_gives() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert page(text) == text, "python tests/support/arguments_page.py writes it again"


@pytest.mark.parametrize(
    ("name", "values"), [("branches", (0, 4096)), ("keep_last", (1,)), ("unresponsive_s", (0.001,))]
)
def test_scenario_fields__values_of_a_range_are_accepted(name: str, values: tuple[float, ...]) -> None:
    assert [getattr(read_config({"output_dir": "/o", name: value}), name) for value in values] == [*values]


@pytest.mark.parametrize(
    ("name", "values"), [("branches", (-1, 4097)), ("keep_last", (0,)), ("unresponsive_s", (0.0, -1.0))]
)
def test_scenario_fields__value_outside_its_range_is_rejected(name: str, values: tuple[float, ...]) -> None:
    for value in values:
        with pytest.raises(InvalidConfig, match=name):
            read_config({"output_dir": "/o", name: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [("discrete", 1), ("terminate", [{"points": ["t"], "low": 1.0, "duration_h": -0.5}]), ("sizing", "weathr")],
)
def test_scenario_fields__field_outside_its_range_is_rejected(name: str, value: Any) -> None:
    with pytest.raises(InvalidConfig, match=name):
        read_scenario({"building": "b", "weather": "w", name: value})
