"""Requirements of a class that is to be a plant: everything that is missing or wrong, in one error."""

import os
import pickle
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from zenostat.bridge.python_plant.description import ClassDescription, Point, create, describe, load_class
from zenostat.topics.errors import InvalidConfig


class Tank:
    """A plant with no more than it must have."""

    step_s: Any = 60.0
    sensors: ClassVar[Any] = {"temperature": ("degC", 0.0, 100.0)}
    actuators: ClassVar[Any] = {"heater": ("W", 0.0, 3000.0)}

    def reset(self, seed: int) -> dict[str, float]:
        return {"temperature": float(seed)}

    def step(self, commands: dict[str, float]) -> dict[str, float]:
        return {"temperature": commands["heater"]}


def with_attributes(**attributes: Any) -> Any:
    return type("Tank", (Tank,), attributes)()


def described(**attributes: Any) -> ClassDescription:
    return describe(with_attributes(**attributes))


def errors_of(plant: Any) -> list[str]:
    with pytest.raises(InvalidConfig) as error:
        describe(plant)
    return str(error.value).splitlines()


def test_python_plant__class_needs_a_timestep_points_and_two_methods() -> None:
    description = describe(Tank())
    assert description.sensors == (Point("temperature", "degC", 0.0, 100.0),)
    assert description.actuators == (Point("heater", "W", 0.0, 3000.0),)
    assert (description.step_s, description.steps, description.begin) == (60.0, 1440, "2001-01-01T00:00:00")
    assert (description.meters, description.time, description.reward) == ((), (), None)
    assert not description.forkable
    assert not description.has_state


def test_python_plant__action_is_named_once() -> None:
    assert describe(with_attributes(actions=["heater"])).actions == ("heater",)
    assert errors_of(with_attributes(actions=["heater", "heater"]))[0].endswith("actions: 'heater' occurs 2 times")


def test_python_plant__empty_class_gets_everything_that_it_lacks_in_one_error() -> None:
    class Empty:
        pass

    errors = errors_of(Empty())
    assert len(errors) == 5
    assert all(error.startswith("plant Empty: has no ") for error in errors)
    for missing in ("attribute step_s", "attribute sensors", "attribute actuators", "reset(seed)", "step(commands)"):
        assert sum(missing in error for error in errors) == 1, missing


@pytest.mark.parametrize(
    ("name", "hyphenated"), [("Tank", "tank"), ("HeatPump", "heat-pump"), ("Room2Zones", "room2-zones")]
)
def test_python_plant__plants_name_is_its_classs(name: str, hyphenated: str) -> None:
    assert describe(type(name, (Tank,), {})()).name == hyphenated


# Time


@pytest.mark.parametrize("step_s", [0.1, 1, 1.5, 3600, 86400.0, np.float32(60), np.int64(60)])
def test_python_plant__timesteps_from_fractions_of_a_second_to_a_day_are_valid(step_s: Any) -> None:
    description = described(step_s=step_s)
    assert description.step_s == float(step_s)
    assert description.steps * description.step_s == 86400.0


INF, NAN = float("inf"), float("nan")
REFUSED: dict[str, tuple[str, tuple[Any, ...]]] = {
    "step_s": ("step_s = ", (0, -60.0, 86401.0, NAN, INF, "60", True, 10**400, 1 / 3, 1e-9)),
    # not a number of timesteps before the year 10000
    "duration_s": ("duration_s = ", (90.0, 0.0, -60.0, 30.0, INF, "day", 1e13)),
    "begin": ("begin = ", ("soon", 2026, datetime(2026, 1, 1, tzinfo=UTC), "2026-01-01T00:00Z", None)),
    "sensors": ("sensors is no mapping", (["temperature"], "temperature", 5)),
}


@pytest.mark.parametrize(("attribute", "wrong"), [(name, one) for name, (_, all_) in REFUSED.items() for one in all_])
def test_python_plant__attribute_that_is_not_valid_is_named(attribute: str, wrong: Any) -> None:
    (error,) = errors_of(with_attributes(**{attribute: wrong}))
    assert error.startswith(f"plant Tank: {REFUSED[attribute][0]}")


def test_python_plant__begin_is_a_datetime_or_its_text_without_a_time_zone() -> None:
    assert described(begin="2026-01-01T06:00").begin == "2026-01-01T06:00:00"
    assert described(begin=datetime(2026, 1, 1)).begin == "2026-01-01T00:00:00"


def test_python_plant__time_features_have_the_names_of_the_contract() -> None:
    assert described(time=["hour", "day_of_week"]).time == ("hour", "day_of_week")
    assert "did you mean 'hour'" in errors_of(with_attributes(time=("hours",)))[0]
    assert errors_of(with_attributes(time=("hour", "month", "hour")))[0].endswith("time: 'hour' occurs 2 times")
    for wrong in ("hour", 0.0, None):  # an attribute of that name may well be the plant's clock
        (error,) = errors_of(with_attributes(time=wrong))
        assert "a tuple of time features expected" in error


# Points


def test_python_plant__point_has_a_unit_and_bounds_and_an_actuator_a_default() -> None:
    description = described(
        sensors={"a": "degC", "b": ["K", None, 300], "c": ("W", np.float32(0.5))},
        meters={"energy": "J"},
        actuators={"heater": ("W", 0, 3000, 100), "valve": "1"},
    )
    assert description.sensors == (Point("a", "degC"), Point("b", "K", None, 300.0), Point("c", "W", 0.5))
    assert description.meters == (Point("energy", "J"),)
    assert description.actuators == (Point("heater", "W", 0.0, 3000.0, 100.0), Point("valve", "1"))


@pytest.mark.parametrize(
    ("spec", "reason"),
    [
        (5, "a unit, or (unit, low, high, aggregation) expected"),
        ((), "a unit, or (unit, low, high, aggregation) expected"),
        ((0.0, 100.0), "a unit, or (unit, low, high, aggregation) expected"),
        (None, "a unit, or (unit, low, high, aggregation) expected"),
        (("degC", 0.0, 100.0, 20.0), "no aggregation 20.0; there are: mean, sum, instant"),  # a sensor has no default
        (("degC", "0", 100.0), "a finite number or None expected"),
        (("degC", 0.0, float("inf")), "a finite number or None expected"),
        (("degC", True, 100.0), "a finite number or None expected"),
        (("degC", 100.0, 0.0), "low 100 is not below high 0"),
        (("degC", 5.0, 5.0), "low 5 is not below high 5"),
        (("W", None, None, "average"), "no aggregation 'average'"),
    ],
)
def test_python_plant__points_specification_that_is_not_valid_is_named(spec: Any, reason: str) -> None:
    (error,) = errors_of(with_attributes(sensors={"temperature": spec}))
    assert error.startswith("plant Tank: sensors['temperature']: ")
    assert reason in error


def test_python_plant__sensor_has_an_aggregation_and_a_meter_has_none() -> None:
    description = described(sensors={"a": "degC", "b": ("W", None, None, "mean"), "c": ("J", 0.0, None, "sum")})
    assert [sensor.aggregation for sensor in description.sensors] == ["instant", "mean", "sum"]
    (error,) = errors_of(with_attributes(meters={"energy": ("J", 0.0, None, "sum")}))
    assert "a unit, or (unit, low, high) expected" in error


@pytest.mark.parametrize("default", [-1.0, 3001.0])
def test_python_plant__default_is_within_its_bounds(default: float) -> None:
    (error,) = errors_of(with_attributes(actuators={"heater": ("W", 0.0, 3000.0, default)}))
    assert f"the default {default:g} is out of bounds" in error


@pytest.mark.parametrize("name", ["water temperature", "a/b", "", "*", "ä", 1, None])
def test_python_plant__name_must_be_valid_in_a_topic(name: Any) -> None:
    for attribute in ("sensors", "meters", "actuators"):
        (error,) = errors_of(with_attributes(**{attribute: {name: "degC"}}))
        assert error.startswith(f"plant Tank: {attribute}[{name!r}]: ")


def test_python_plant__sensor_and_a_meter_cannot_share_a_name() -> None:
    (error,) = errors_of(with_attributes(meters={"temperature": "J"}))
    assert error == "plant Tank: 'temperature' is both a sensor and a meter"


def test_python_plant__plant_measures_something() -> None:
    (error,) = errors_of(with_attributes(sensors={}))
    assert "at least one sensor or meter" in error
    assert described(sensors={}, meters={"energy": "J"}).sensors == ()
    assert described(actuators={}).actuators == ()


# Methods and the rest


def test_python_plant__methods_take_the_arguments_of_the_interface() -> None:
    async def coroutine(_self: Any, commands: Any) -> Any:
        return commands

    for attributes in (
        {"step": lambda _self: {}},
        {"step": lambda _self, commands, more: {commands: more}},
        {"step": coroutine},
        {"step": None},
        {"reset": lambda _self: {}},
        {"reset": 5},
        {"save": lambda _self, path: path, "restore": lambda _self, state: state},
        {"save": lambda _self: 0, "restore": lambda _self: 0},
    ):
        (error,) = errors_of(with_attributes(**attributes))
        assert f"{next(iter(attributes))}(" in error or "restore(" in error
    assert described(reset=lambda _self, seed, more=0: {seed: more}, step=lambda _self, *args: args).steps == 1440


def test_python_plant__state_is_saved_and_restored_or_neither() -> None:
    def save(_self: Any) -> float:
        return 0.0

    def restore(_self: Any, _state: float) -> None:
        pass

    assert described(save=save, restore=restore).has_state
    assert errors_of(with_attributes(save=save)) == ["plant Tank: has save() without restore(state)"]
    assert errors_of(with_attributes(restore=restore)) == ["plant Tank: has restore() without save()"]


def test_python_plant__forkable_is_a_boolean() -> None:
    assert described(forkable=True).forkable
    assert "forkable = 'no'" in errors_of(with_attributes(forkable="no"))[0]


@pytest.mark.parametrize("reward", ["linear", {"weight": 1.0}, {"kind": "linear", "f": print}, {"kind": "x", "n": {1}}])
def test_python_plant__reward_is_a_kind_with_parameters_that_can_be_sent(reward: Any) -> None:
    assert errors_of(with_attributes(reward=reward))[0].startswith("plant Tank: reward = ")
    assert described(reward={"kind": "linear", "weight": 1}).reward == {"kind": "linear", "weight": 1}


# Loading


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of modules; the import system is as before afterwards."""
    monkeypatch.setattr(sys, "meta_path", [*sys.meta_path])
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.chdir(tmp_path)
    modules = {*sys.modules}
    yield tmp_path
    for name in {*sys.modules} - modules:
        del sys.modules[name]


def test_python_plant__class_is_named_by_file_or_module(folder: Path) -> None:
    (folder / "my-tank.v2.py").write_text("class Tank:\n    def __init__(self, volume=1): self.volume = volume\n")
    (folder / "plant_package").mkdir()
    (folder / "plant_package" / "tanks.py").write_text("class Tank:\n    volume = 3\n")
    assert create("my-tank.v2.py:Tank", {"volume": 2}).volume == 2
    assert create(f"{folder}/my-tank.v2.py:Tank", {}).volume == 1
    assert create("plant_package.tanks:Tank", {}).volume == 3


def test_python_plant__class_imports_modules_beside_its_file_whenever_it_does(folder: Path) -> None:
    present = [*sys.path]
    (folder / "tank_sizes.py").write_text("VOLUME = 3\n")
    (folder / "tank_losses.py").write_text("RATE = 0.5\n")
    (folder / "tank_file.py").write_text(
        "from tank_sizes import VOLUME\nclass Tank:\n    volume = VOLUME\n"
        "    def step(self):\n        from tank_losses import RATE\n        return RATE * self.volume\n"
    )
    for _ in range(2):
        assert create("tank_file.py:Tank", {}).step() == 1.5
        assert sys.path == [*present, str(folder)], "processes that it spawns find them as well"


@pytest.mark.parametrize("plant", ["tank.py", "tank", ":Tank", "tank.py:", "tank.py:2", "", ".tank:Tank"])
def test_python_plant__plant_is_written_as_place_and_class(plant: str) -> None:
    with pytest.raises(InvalidConfig, match=r"write it as FILE:CLASS or MODULE:CLASS"):
        load_class(plant)


def test_python_plant__missing_file_module_or_class_is_named(folder: Path) -> None:
    (folder / "tank_file.py").write_text("from pathlib import Path\nclass Tank: pass\nTonk = 5\n")
    (folder / "folder.py").mkdir()
    for plant, reason in {
        "tonk.py:Tank": f"there is no file {folder / 'tonk.py'}",
        "folder.py:Tank": f"{folder / 'folder.py'} is a folder; expected a Python file",
        ".:Tank": "write it as",
        "no.such.module:Tank": "no module 'no.such.module'",
        "tank_file.py:Tunk": "no class 'Tunk' in tank_file.py; did you mean 'Tank'",
        "tank_file.py:Tonk": "no class 'Tonk' in tank_file.py; did you mean 'Tank'",
    }.items():
        with pytest.raises(InvalidConfig) as error:
            load_class(plant)
        assert reason in str(error.value)


def test_python_plant__module_that_the_users_own_module_lacks_is_no_missing_plant(folder: Path) -> None:
    for name in ("tank_file", "tank_module"):
        (folder / f"{name}.py").write_text("import no_such_library\n")
    for plant in ("tank_file.py:Tank", "tank_module:Tank"):
        with pytest.raises(ModuleNotFoundError, match="no_such_library"):
            load_class(plant)


@pytest.mark.parametrize("name", ["statistics", "zenostat", "json", "my-tank.v2", "2tanks"])
def test_python_plant__file_of_any_name_replaces_no_other_module_and_its_instances_can_be_pickled(
    folder: Path, name: str
) -> None:
    present = sys.modules.get(name)
    (folder / f"{name}.py").write_text("class Tank: pass\n")
    plant_class = load_class(f"{name}.py:Tank")
    assert type(pickle.loads(pickle.dumps(plant_class()))) is plant_class
    assert sys.modules.get(name) is present


def test_python_plant__arguments_that_the_class_does_not_take_are_named(folder: Path) -> None:
    (folder / "tank_file.py").write_text("class Tank:\n    def __init__(self, volume): pass\n")
    for arguments in ({}, {"volume": 1, "colour": 2}):
        with pytest.raises(InvalidConfig, match=r"tank_file.py:Tank.*(volume|colour).*its arguments: \(volume\)"):
            create("tank_file.py:Tank", arguments)


def test_python_plant__file_that_is_written_again_within_a_second_is_the_new_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python's cached bytecode is valid for a text of the same length and time."""
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    monkeypatch.setattr(sys, "meta_path", [*sys.meta_path])
    monkeypatch.setattr(sys, "path", [*sys.path])
    file = tmp_path / "rewritten_tank.py"
    for name in ("push", "pull", "push"):
        monkeypatch.delitem(sys.modules, "rewritten_tank", raising=False)
        file.write_text(f"class Tank:\n    command = {name!r}\n")
        os.utime(file, (1_700_000_000, 1_700_000_000))
        assert load_class(f"{file}:Tank").command == name
    monkeypatch.delitem(sys.modules, "rewritten_tank")
