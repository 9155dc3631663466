"""Scenario files: read, written, refused, and described by a schema."""

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from support.examples import examples
from support.run_cli import run_python

from zenostat.agent_sdk.rewards import read_reward
from zenostat.cli.scenarios import scenario_schema
from zenostat.eplus_node.config import read_config
from zenostat.eplus_node.plan import plan
from zenostat.models.scenario.schema import (
    ActionSpec,
    ActuatorSpec,
    DiscreteActionSpec,
    Scenario,
    SensorSpec,
    dump,
    load_scenario,
    read_scenario,
    resolve_paths,
)
from zenostat.models.weather.noise import ColumnNoise
from zenostat.topics.errors import InvalidConfig, UnknownName, UsageError
from zenostat.topics.messages import Aggregation

BASE: dict[str, Any] = {"building": "b", "weather": "w"}
SCHEMA = Draft202012Validator(scenario_schema())
DOCS = Path(__file__).parents[2] / "docs" / "scenarios.md"

Load = Callable[[str], Scenario]


@pytest.fixture
def load(tmp_path: Path) -> Load:
    """A scenario from the text of a file; the building and the weather are there."""

    def load(text: str) -> Scenario:
        file = tmp_path / "mine.yaml"
        file.write_text(f"building: b\nweather: w\n{text}\n", encoding="utf-8")
        return load_scenario(file)

    return load


def refused(load: Load, text: str) -> str:
    with pytest.raises(InvalidConfig) as raised:
        load(text)
    return str(raised.value)


# Written and read

# Words that YAML takes for something else than text, if they are not quoted.
TRICKY = (
    "on", "No", "null", "~", "1", "1e-4", "1.5", "0x10", "0o17", "010", "12:30", "2018-07-01", "=", "<<", "", " a",
)  # fmt: skip
BREAKS = "\x85\u2028\u2029"  # line breaks to YAML 1.1
# NEL has a test of its own, and a NUL is refused in a file.
characters = st.characters(exclude_categories=["Cs"], exclude_characters="\x85\0")
words = st.one_of(st.sampled_from(TRICKY), st.text(characters, max_size=12))
names = st.one_of(
    st.sampled_from(("on", "No", "null", "1", "1e-4", "1.5", "010", "2018-07-01", "y")),
    st.from_regex(r"[A-Za-z0-9_][A-Za-z0-9_.\-]{0,20}", fullmatch=True),
)
numbers = st.floats(allow_nan=False, allow_infinity=False)
positive = st.floats(1e-9, 1e9)
scalars = st.one_of(st.none(), st.booleans(), st.integers(), numbers, words)
nested = st.recursive(
    scalars, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(words, inner, max_size=3), max_leaves=5
)


def ranges(of: st.SearchStrategy[float]) -> st.SearchStrategy[Any]:
    return of | st.tuples(of, of).map(sorted)


noises = st.fixed_dictionaries(
    {"sigma": ranges(positive)},
    optional={"mu": ranges(numbers), "tau_h": ranges(positive), "low": st.floats(-9, 0), "high": st.floats(1, 9)},
)
sensors = st.fixed_dictionaries(
    {"variable": words, "key": words}, optional={"aggregation": st.sampled_from(["mean", "sum", "instant", None])}
)
edges = {"low": st.none() | numbers, "high": st.none() | numbers}
actuators = st.fixed_dictionaries({"component_type": words, "control_type": words, "key": words}, optional=edges)
some_names = st.lists(names, min_size=1, max_size=3)
actions = st.fixed_dictionaries({"actuators": some_names}, optional=edges)
rows = st.lists(st.lists(numbers, max_size=3), min_size=1, max_size=3)
choices = st.fixed_dictionaries({"actions": some_names, "values": rows})
bands = st.tuples(st.floats(0, 20), st.floats(21, 40)).map(list)
rewards = st.fixed_dictionaries(
    {"kind": st.just("linear")},
    optional={
        "weight": st.floats(0, 1),
        "lambda_energy": st.floats(0, 1),
        "winter": bands,
        "summer_begin": st.tuples(st.integers(1, 12), st.integers(1, 28)).map(list),
        "power": st.none() | st.lists(names, max_size=2),
        "temperatures": st.none() | st.lists(names, max_size=2),
    },
)
days = st.sampled_from(["01-01", "12-31", "2018-07-01", "2016-02-29"])
times = st.lists(
    st.sampled_from(["year", "month", "day_of_month", "day_of_week", "day_of_year", "hour", "minutes", "current_time"]),
    unique=True,
)
fields = st.fixed_dictionaries(
    {"building": names, "weather": st.lists(names, min_size=1, max_size=3)},
    optional={
        "id": names,
        "about": words | st.text(characters, min_size=120) | st.text("a b\n", min_size=120),
        "weather_order": st.sampled_from(["random", "sequence"]),
        "weather_noise": st.dictionaries(words, noises, max_size=3),
        "sizing": st.sampled_from(["weather", "model"]),
        "begin": days,
        "end": days,
        "steps_per_hour": st.sampled_from([1, 4, 60]),
        "edits": st.dictionaries(words,
            st.dictionaries(words, st.none() | st.dictionaries(words, nested, max_size=3), max_size=3), max_size=2),
        "time": times,
        "sensors": st.none() | st.dictionaries(names, sensors, max_size=3),
        "meters": st.none() | st.dictionaries(names, words, max_size=3),
        "actuators": st.none() | st.dictionaries(names, actuators, max_size=3),
        "aggregation": st.sampled_from(["mean", "instant"]),
        "actions": st.none() | st.dictionaries(names, actions, max_size=3),
        "control": st.sampled_from(["point", "zone", "building"]),
        "discrete": st.none() | st.integers(2, 50) | st.lists(choices, max_size=3),
        "reward": st.none() | rewards,
    },
)  # fmt: skip


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(fields)
def test_scenario__scenario_that_was_written_is_read_back(tmp_path: Path, fields: dict[str, Any]) -> None:
    scenario = read_scenario(fields)
    file = tmp_path / "written.yaml"
    file.write_text(dump(scenario), encoding="utf-8", newline="")
    again = load_scenario(file)
    assert again == scenario
    assert again.model_dump_json() == scenario.model_dump_json(), "equal, but for the kind of some value"


@settings(suppress_health_check=[HealthCheck.too_slow])
@given(fields)
def test_read_scenario__keeps_the_fields_that_are_set(fields: dict[str, Any]) -> None:
    read = read_scenario(fields).model_dump(mode="json", exclude_unset=True)
    assert read == fields


@settings(suppress_health_check=[HealthCheck.too_slow], max_examples=examples(50))
@given(fields)
def test_scenario__schema_accepts_what_the_loader_accepts(fields: dict[str, Any]) -> None:
    SCHEMA.validate(fields)
    SCHEMA.validate(yaml.safe_load(dump(read_scenario(fields))))


@pytest.mark.parametrize("character", BREAKS, ids=ascii)
@pytest.mark.parametrize("text", ["{}", "a{}", "{}a", "a{}b", " {} ", "'{}\"", "{0}{0}", "a\n{}"])
def test_scenario__line_breaks_of_unicode_are_kept(tmp_path: Path, character: str, text: str) -> None:
    value = text.format(character)
    scenario = read_scenario({**BASE, "about": value, "edits": {"M": {value: {value: value}}}})
    file = tmp_path / "written.yaml"
    file.write_text(dump(scenario), encoding="utf-8", newline="")
    assert load_scenario(file) == scenario


def test_scenario__text_of_any_language_is_written_as_it_is() -> None:
    assert "Bürogebäude, 办公楼" in dump(read_scenario({**BASE, "about": "Bürogebäude, 办公楼"}))


def test_scenario__file_states_only_what_differs_from_the_defaults() -> None:
    written = dump(read_scenario({**BASE, "control": "point", "reward": {"kind": "linear"}}))
    assert yaml.safe_load(written) == {"building": "b", "weather": ["w"]}


def test_scenario__no_reward_is_not_the_default_one() -> None:
    without = read_scenario({**BASE, "reward": None})
    assert yaml.safe_load(dump(without))["reward"] is None
    assert read_scenario(BASE).reward == {"kind": "linear"}


def test_scenario__file_is_utf_8_wherever_it_is_read(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("building: b\nweather: w\nabout: Bürogebäude\n", encoding="utf-8")
    program = (
        "import sys; from pathlib import Path; from zenostat.models.scenario.schema import load_scenario; "
        "print(ascii(load_scenario(Path(sys.argv[1])).about))"
    )
    plain = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = run_python("-P", "-c", program, str(file), env={**os.environ, **plain})
    assert done.stdout.strip() == ascii("Bürogebäude"), done.stderr


# Forms that mean the same


def test_scenario__points_may_be_lists_or_named_fields(load: Load) -> None:
    by_field = load(
        """
sensors:
  a: {variable: Zone Air Temperature, key: Core_ZN}
  b: {variable: Zone Air Temperature, key: Core_ZN, aggregation: mean}
actuators:
  c: {component_type: Fan, control_type: Flow, key: FAN 1}
  d: {component_type: Fan, control_type: Flow, key: FAN 1, low: 0, high: 2.5}
  e: {component_type: Fan, control_type: Flow, key: FAN 1, high: 2.5}
"""
    )
    listed = load(
        """
sensors:
  a: [Zone Air Temperature, Core_ZN]
  b: [Zone Air Temperature, Core_ZN, mean]
actuators:
  c: [Fan, Flow, FAN 1]
  d: [Fan, Flow, FAN 1, 0, 2.5]
  e: [Fan, Flow, FAN 1, null, 2.5]
"""
    )
    assert listed == by_field
    assert by_field.sensors is not None
    assert by_field.actuators is not None
    assert [spec.aggregation for spec in by_field.sensors.values()] == [None, Aggregation.MEAN]
    assert [(spec.low, spec.high) for spec in by_field.actuators.values()] == [(None, None), (0.0, 2.5), (None, 2.5)]


def test_scenario__one_weather_is_a_list_of_one(load: Load) -> None:
    assert load("").weather == ("w",)
    assert read_scenario({**BASE, "weather": ["w"]}) == read_scenario(BASE)


def test_scenario__parts_may_be_given_as_they_are() -> None:
    """A scenario that is made in Python, of the parts of another."""
    read = read_scenario(
        {
            **BASE,
            "weather_noise": {"dry_bulb_temperature": {"sigma": [1, 2]}},
            "sensors": {"a": ["Zone Air Temperature", "Core_ZN", "mean"]},
            "actuators": {"c": ["Fan", "Flow", "FAN 1", 0, 2]},
            "actions": {"f": {"actuators": ["c"]}},
            "discrete": [{"actions": ["f"], "values": [[0], [2]]}],
        }
    )
    built = Scenario(
        building="b",
        weather=("w",),
        weather_noise={"dry_bulb_temperature": ColumnNoise(sigma=(1.0, 2.0))},
        sensors={"a": SensorSpec(variable="Zone Air Temperature", key="Core_ZN", aggregation=Aggregation.MEAN)},
        actuators={"c": ActuatorSpec(component_type="Fan", control_type="Flow", key="FAN 1", low=0.0, high=2.0)},
        actions={"f": ActionSpec(actuators=("c",))},
        discrete=(DiscreteActionSpec(actions=("f",), values=((0.0,), (2.0,))),),
    )
    assert built == read


@pytest.mark.parametrize(("written", "day"), [("2018-07-01", "2018-07-01"), ("'2018-07-01'", "2018-07-01"),
                                              ("07-01", "07-01"), ("'07-01'", "07-01")])  # fmt: skip
def test_scenario__day_needs_no_quotes(load: Load, written: str, day: str) -> None:
    scenario = load(f"begin: {written}\nend: {written}")
    assert (scenario.begin, scenario.end) == (day, day)


@pytest.mark.parametrize("number", ["1e-4", "1E-4", "1.0e-4", "1e-04", "0.0001", "+1e-4", ".1e-3"])
def test_scenario__number_is_a_number_however_it_is_written(load: Load, number: str) -> None:
    """YAML 1.1, as PyYAML reads it, takes a number with an exponent and no dot for a text."""
    scenario = load(
        f"""
weather_noise: {{dry_bulb_temperature: {{sigma: {number}, mu: [{number}, 1]}}}}
edits: {{Material: {{Wall: {{conductivity: {number}}}}}}}
actuators: {{a: [Fan, Flow, FAN 1, {number}, 1]}}
reward: {{kind: linear, lambda_energy: {number}}}
"""
    )
    assert scenario.weather_noise["dry_bulb_temperature"] == ColumnNoise(sigma=1e-4, mu=(1e-4, 1.0))
    assert scenario.edits == {"Material": {"Wall": {"conductivity": 1e-4}}}
    assert scenario.actuators is not None
    assert scenario.actuators["a"].low == 1e-4
    assert scenario.reward == {"kind": "linear", "lambda_energy": 1e-4}


def test_scenario__what_only_looks_like_a_number_stays_text(load: Load) -> None:
    fields = {"a": "1e", "b": "e4", "c": "1e-4 m", "d": "1.2.3", "e": "-"}
    written = ", ".join(f"{name}: {text}" for name, text in fields.items() if name != "e") + ", e: '-'"
    assert load(f"edits: {{M: {{n: {{{written}}}}}}}").edits == {"M": {"n": fields}}
    assert load("edits: {M: {n: {a: '1e-4'}}}").edits == {"M": {"n": {"a": "1e-4"}}}


def test_scenario__part_may_be_written_once_and_used_again(load: Load) -> None:
    """YAML's anchors and merges."""
    scenario = load(
        """
weather_noise:
  dry_bulb_temperature: &noise {sigma: 1.0, mu: 0.5}
  wind_speed: *noise
  relative_humidity: {<<: *noise, sigma: 3.0}
"""
    )
    assert scenario.weather_noise["wind_speed"] == ColumnNoise(sigma=1.0, mu=0.5)
    assert scenario.weather_noise["relative_humidity"] == ColumnNoise(sigma=3.0, mu=0.5)


# RequestRejected


@pytest.mark.parametrize(
    ("text", "key", "line"),
    [
        ("control: zone\ncontrol: point", "control", 4),
        ("sensors: {a: [v, k], a: [v, l]}", "a", 3),
        ("edits:\n  Material:\n    Wall:\n      conductivity: 1\n      conductivity: 2", "conductivity", 7),
        ("discrete: [{actions: [a], values: [[1]], actions: [b]}]", "actions", 3),
        ("building: other", "building", 3),
    ],
)
def test_scenario__key_that_is_repeated_is_an_error(load: Load, text: str, key: str, line: int) -> None:
    message = refused(load, text)
    assert f"repeated name {key!r}" in message
    assert f"line {line}" in message


UNKNOWN = {
    "colour": "colour: red",
    "sensors.a.colour": "sensors: {a: {variable: v, key: k, colour: red}}",
    "actuators.a.min": "actuators: {a: {component_type: c, control_type: t, key: k, min: 1}}",
    "actions.a.actuator": "actions: {a: {actuators: [x], actuator: y}}",
    "weather_noise.wind_speed.tau": "weather_noise: {wind_speed: {sigma: 1, tau: 24}}",
    "discrete.0.valuez": "discrete: [{actions: [a], values: [[1]], valuez: [[1]]}]",
}


@pytest.mark.parametrize(("path", "text"), UNKNOWN.items(), ids=UNKNOWN)
def test_scenario__unknown_field_is_named_with_its_path(load: Load, path: str, text: str) -> None:
    assert f"{path}:" in refused(load, text)


WRONG = {
    "control": "control: zones",
    "weather_order": "weather_order: shuffled",
    "sizing": "sizing: none",
    "aggregation": "aggregation: sum",
    "sensors.a.aggregation": "sensors: {a: [v, k, average]}",
    "time.1": "time: [hour, second]",
    "begin": "begin: 5",
    "steps_per_hour": "steps_per_hour: often",
    "discrete": "discrete: 1",
    "discrete.0.values.0.0": "discrete: [{actions: [a], values: [[warm]]}]",
    "discrete.0.values": "discrete: [{actions: [a], values: []}]",
    "actions.a.actuators": "actions: {a: {actuators: []}}",
    "actuators.a.low": "actuators: {a: [c, t, k, .inf, 2]}",
    "weather_noise.wind_speed.sigma": "weather_noise: {wind_speed: {sigma: [2, 1]}}",
    "sensors.a": "sensors: {a: [Zone Air Temperature]}",
    "actuators.a": "actuators: {a: [c, t, k, 1, 2, 3]}",
    "edits.Material": "edits: {Material: thick}",
    "reward": "reward: 1",
}


@pytest.mark.parametrize("rows", ["[[18, 27], [20, 25]]", "{0: [18, 27], 1: [20, 25]}", "[18, 20]"])
def test_scenario__rows_of_discrete_choices_without_their_actions_are_refused_once(load: Load, rows: str) -> None:
    message = refused(load, f"discrete: {rows}")
    assert message.count("values: [[18, 27], [20, 25]]") == 1
    assert "discrete: a number of steps, or for each discrete action" in message


def test_scenario__value_of_an_enumeration_is_refused_with_its_values(load: Load) -> None:
    assert refused(load, "aggregation: max").endswith("aggregation: Input should be 'instant' or 'mean', got 'max'")


def test_scenario__list_of_another_length_is_quoted_once(load: Load) -> None:
    message = refused(load, "sensors: {a: [Zone Air Temperature]}")
    assert message.endswith("2 to 4 items (variable, key, aggregation, lead_h), got ['Zone Air Temperature']")


@pytest.mark.parametrize(("path", "text"), WRONG.items(), ids=WRONG)
def test_scenario__what_cannot_be_is_named_with_its_path(load: Load, path: str, text: str) -> None:
    assert f"{path}:" in refused(load, text)


@pytest.mark.parametrize("field", ["steps_per_hour", "discrete"])
@pytest.mark.parametrize("value", ["true", "yes", "2.5"])
def test_scenario__count_is_a_number(load: Load, field: str, value: str) -> None:
    assert field in refused(load, f"{field}: {value}")


def test_scenario__time_field_is_observed_once(load: Load) -> None:
    assert "time field is named twice" in refused(load, "time: [hour, month, hour]")


def test_unknown_word__is_reported_with_the_allowed_ones(load: Load) -> None:
    assert "'point', 'zone' or 'building', got 'zones'" in refused(load, "control: zones")


def test_scenario__all_faults_are_in_one_report(load: Load) -> None:
    message = refused(load, "\n".join([*UNKNOWN.values(), "control: zones", "begin: 5", "weather_order: shuffled"]))
    wanted = [*UNKNOWN, "control", "begin", "weather_order"]
    assert [path for path in wanted if f"{path}:" not in message] == []


def test_scenario__report_names_the_file(load: Load, tmp_path: Path) -> None:
    assert str(tmp_path / "mine.yaml") in refused(load, "colour: red")
    assert str(tmp_path / "mine.yaml") in refused(load, "a: [")


def test_scenario__building_and_a_weather_are_needed() -> None:
    with pytest.raises(InvalidConfig, match=r"building: it is missing.*weather: it is missing"):
        read_scenario({})
    with pytest.raises(InvalidConfig, match="weather: "):
        read_scenario({"building": "b", "weather": []})


@pytest.mark.parametrize(
    "text", ["", "- building: b", "building", "1: b", "a: [", "? [a, b]\n: c", "a: !!python/name:os"]
)
def test_scenario__what_is_no_mapping_is_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    with pytest.raises(InvalidConfig, match=r"mine\.yaml"):
        load_scenario(file)


def test_scenario__file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    for path in (tmp_path / "gone.yaml", tmp_path):
        with pytest.raises(UnknownName, match=re.escape(str(path))):
            load_scenario(path)
    (tmp_path / "binary.yaml").write_bytes(b"building: \xff\xfe")
    with pytest.raises(UsageError, match=r"binary\.yaml"):
        load_scenario(tmp_path / "binary.yaml")


# Paths


def test_scenario__paths_are_relative_to_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, elsewhere = tmp_path / "scenarios", tmp_path / "elsewhere"
    for directory in (folder / "models", elsewhere):
        directory.mkdir(parents=True)
    for path in ("models/mine.idf", "mine.epw"):
        (folder / path).write_text("")
    text = "building: models/mine.idf\nweather: [mine.epw, USA_CA_San.Francisco, '{}']\n"
    (folder / "mine.yaml").write_text(text.format(folder / "mine.epw"))
    monkeypatch.chdir(elsewhere)
    expected = (
        str(folder / "models/mine.idf"),
        (str(folder / "mine.epw"), "USA_CA_San.Francisco", str(folder / "mine.epw")),
    )
    for named in (folder / "mine.yaml", Path("../scenarios/mine.yaml")):
        scenario = load_scenario(named)
        assert (scenario.building, scenario.weather) == expected
    monkeypatch.chdir(folder)
    assert load_scenario(Path("mine.yaml")).building == expected[0]


def test_scenario__one_weather_by_path(tmp_path: Path) -> None:
    (tmp_path / "mine.epw").write_text("")
    assert resolve_paths({"weather": "mine.epw"}, tmp_path) == {"weather": str(tmp_path / "mine.epw")}


def test_scenario__short_name_is_no_path(tmp_path: Path) -> None:
    (tmp_path / "office-small").write_text("")
    assert resolve_paths({"building": "office-small"}, tmp_path) == {"building": "office-small"}


def test_scenario__what_is_no_text_is_left_for_the_check(tmp_path: Path) -> None:
    fields = {"building": 5, "weather": [None, 1], "begin": "x.epw"}
    assert resolve_paths(fields, tmp_path) == fields


def test_scenario__path_in_the_users_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "mine.idf").write_text("")
    assert resolve_paths({"building": "~/mine.idf"}, tmp_path / "far") == {"building": str(tmp_path / "mine.idf")}


def test_scenario__home_of_nobody_is_a_mistake_of_the_users(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("building: ~nobody_of_that_name/mine.idf\nweather: USA_CO_Denver\n")
    with pytest.raises(UsageError, match="nobody_of_that_name"):
        plan(read_config({"scenario": str(file)}))


# The schema

FULL = {"building": "b", "weather": ["w"]}
SHORT_FORMS = {
    "one weather": {"building": "b", "weather": "w"},
    "sensors": {**FULL, "sensors": {"a": ["v", "k"], "b": ["v", "k", "mean"]}},
    "actuators": {**FULL, "actuators": {"a": ["t", "c", "k"], "b": ["t", "c", "k", None, 2]}},
    "one power": {**FULL, "reward": {"kind": "linear", "power": "p"}},
    "no reward": {**FULL, "reward": None},
}


@pytest.mark.parametrize("form", SHORT_FORMS.values(), ids=SHORT_FORMS)
def test_scenario__schema_accepts_the_short_forms(form: dict[str, Any]) -> None:
    reward = read_scenario(form).reward
    if reward is not None:
        read_reward(reward)
    assert [error.message for error in SCHEMA.iter_errors(form)] == []


def documented() -> dict[str, Any]:
    (block,) = re.findall(r"```yaml\n(.*?)```", DOCS.read_text(encoding="utf-8"), re.S)
    document: dict[str, Any] = yaml.safe_load(block)
    return document


def test_scenario__example_of_the_documentation_is_a_scenario() -> None:
    example = documented()
    reward = read_scenario(example).reward
    assert reward is not None
    read_reward(reward)
    assert [f"{error.json_path}: {error.message}" for error in SCHEMA.iter_errors(example)] == []


NEITHER = {
    "unknown field": {"colour": "red"},
    "unknown field of a sensor": {"sensors": {"a": {"variable": "v", "key": "k", "colour": "red"}}},
    "unknown field of noise": {"weather_noise": {"wind_speed": {"sigma": 1, "tau": 24}}},
    "unknown field of the reward": {"reward": {"kind": "linear", "lambda_enrgy": 1}},
    "unknown kind of reward": {"reward": {"kind": "liner"}},
    "reward without a kind": {"reward": {"weight": 0.5}},
    "weight above 1": {"reward": {"kind": "linear", "weight": 2}},
    "word that is none": {"control": "zones"},
    "time field that is none": {"time": ["second"]},
    "reading that is none": {"aggregation": "average"},
    "one step": {"discrete": 1},
    "more steps than a manifest holds": {"discrete": 1001},
    "no rows": {"discrete": [{"actions": ["a"], "values": []}]},
    "no actuators": {"actions": {"a": {"actuators": []}}},
    "no weather": {"weather": []},
    "name that is none": {"actions": {"a": {"actuators": ["a b"]}}},
}


@pytest.mark.parametrize("wrong", NEITHER.values(), ids=NEITHER)
def test_scenario__schema_and_loader_refuse_the_same(wrong: dict[str, Any]) -> None:
    fields = {**FULL, **wrong}
    with pytest.raises(InvalidConfig):
        read_reward(read_scenario(fields).reward or "linear")
    assert not SCHEMA.is_valid(fields)


def test_scenario__schema_is_one_and_explains_the_reward() -> None:
    Draft202012Validator.check_schema(SCHEMA.schema)
    assert not SCHEMA.is_valid({"building": "b"})
    assert not SCHEMA.is_valid([])
    linear = SCHEMA.schema["$defs"]["LinearReward"]["properties"]
    assert {"weight", "lambda_energy", "winter", "summer", "power", "temperatures"} <= set(linear)
