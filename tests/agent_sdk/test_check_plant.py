"""The conformance checks for plants: good plants pass, and each mutant violates one rule that its error names."""

# ruff: noqa: RUF012  # plants as users write them

import itertools
import re
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from zenostat.agent_sdk.testing import ConformanceError, FakePlant, check_plant
from zenostat.agent_sdk.testing.check_plant import PLANT_CHECKS
from zenostat.topics.errors import InvalidConfig

numbers = itertools.count()


class Good:
    """A tank that cools to 20 degC and has a state."""

    step_s = 60.0
    sensors = {"temperature": ("degC", 20.0, 95.0), "level": "m"}
    meters = {"electricity": ("J", 0.0, None)}
    actuators = {"heater": ("W", 0.0, 3000.0), "valve": ("1", 0.0, 1.0, 0.5), "offset": "K"}

    def __init__(self, start_degc: float = 40.0) -> None:
        self.start_degc = start_degc

    def reset(self, seed: int) -> Any:
        self.temperature, self.level = self.start_degc + seed % 10, 1.0
        return self.values(0.0)

    def step(self, commands: Any) -> Any:
        heat = commands.get("heater", 0.0) * (self.temperature < 90.0)
        self.temperature += 60.0 * (heat - 40.0 * (self.temperature - 20.0)) / 4.2e5
        self.level += 0.01 * (commands["valve"] - 0.5) + 0.0 * commands.get("offset", 0.0)
        return self.values(60.0 * heat)

    def values(self, energy: float) -> Any:
        return {"temperature": self.temperature, "level": self.level, "electricity": energy}

    def save(self) -> Any:
        return self.temperature, self.level

    def restore(self, state: Any) -> None:
        self.temperature, self.level = state


class Forkable(Good):
    forkable = True
    save = restore = None


@pytest.mark.parametrize(("plant", "checks"), [(Good, 9), (Forkable, 9), (FakePlant, 10)])
def test_check_plant__good_plants_pass(plant: Any, checks: int) -> None:
    report = check_plant(plant)
    assert len(report.passed) == checks
    assert not report.skipped
    assert report.subject == plant.__name__


def test_check_plant__each_instance_is_closed_once() -> None:
    open_instances: list[Any] = []

    class Closing(Good):
        def __init__(self) -> None:
            super().__init__()
            open_instances.append(self)

        def close(self) -> None:
            open_instances.remove(self)

    assert "can be closed" in check_plant(Closing).passed
    assert open_instances == []


def test_check_plant__file_its_class_and_arguments(tmp_path: Path) -> None:
    (tmp_path / "tank_of_a_file.py").write_text(
        "class Tank:\n"
        "    step_s, sensors, actuators = 1.0, {'t': ('degC', 0.0, 50.0)}, {}\n"
        "    def __init__(self, start): self.start = start\n"
        "    def reset(self, seed): return {'t': self.start}\n"
        "    def step(self, commands): return {'t': self.start}\n"
    )
    plant = f"{tmp_path}/tank_of_a_file.py:Tank"
    assert check_plant(plant, {"start": 20.0}).subject == "Tank"
    with pytest.raises(ConformanceError, match=r"t = 60; its bounds are 0 to 50 degC \(at sample 0"):
        check_plant(plant, {"start": 60.0})
    with pytest.raises(ConformanceError, match=r"TypeError.*start"):
        check_plant(plant)
    with pytest.raises(InvalidConfig, match=r"no class 'Tonk'.*Tank"):
        check_plant(f"{tmp_path}/tank_of_a_file.py:Tonk")


def test_check_plant__instance_is_refused() -> None:
    with pytest.raises(InvalidConfig, match=r"an instance of Good; its class expected: check_plant\(Good\)"):
        check_plant(Good())  # type: ignore[arg-type]


def test_check_plant__checks_can_be_skipped_and_episodes_limited() -> None:
    class Short(Good):
        duration_s = 120.0

    report = check_plant(Short, skip="commands may be missing")
    assert report.skipped == ("commands may be missing",)
    with pytest.raises(InvalidConfig, match="there is no check 'finite'"):
        check_plant(Good, skip="finite")

    class Late(Good):
        """Leaves its bounds at step 200."""

        steps = 0

        def step(self, commands: Any) -> Any:
            self.steps += 1
            return super().step(commands) | ({"electricity": -1.0} if self.steps == 200 else {})

        def reset(self, seed: int) -> Any:
            self.steps = 0
            return super().reset(seed)

        def save(self) -> Any:
            return self.steps, super().save()

        def restore(self, state: Any) -> None:
            self.steps = state[0]
            super().restore(state[1])

    assert not check_plant(Late, max_steps=199).failed
    with pytest.raises(ConformanceError, match=r"electricity = -1; its bounds are 0 to inf J \(at sample 200, random"):
        check_plant(Late, max_steps=200)


# Mutants


def mutant(base: type = Good, **members: Any) -> type:
    return type("Mutant", (base,), members)


def changed(base: type = Good, **values: Any) -> type:
    """A plant whose values are replaced, or removed if they are None."""

    def replaced(self: Any, energy: float) -> Any:
        all_values = base.values(self, energy) | values
        return {name: value for name, value in all_values.items() if value is not None}

    return mutant(base, values=replaced)


class Shares(Good):
    """Plant with one temperature for all instances, which a reset sets."""

    state: Any = None

    def reset(self, seed: int) -> Any:
        Shares.state = super().reset(seed)
        return Shares.state

    def step(self, commands: Any) -> Any:
        self.temperature = Shares.state["temperature"]
        Shares.state = super().step(commands)
        return Shares.state

    def restore(self, state: Any) -> None:
        super().restore(state)
        Shares.state = {"temperature": self.temperature}


class Remembers(Good):
    """Starts each episode at the level of the previous one."""

    level = 1.0

    def reset(self, seed: int) -> Any:
        level = self.level
        super().reset(seed)
        self.level = level
        return self.values(0.0)


class RestoresOnce(Good):
    earlier = 0.0

    def restore(self, state: Any) -> None:
        super().restore(state)
        self.level += self.earlier
        self.earlier += 1.0


class SaveDisturbs(Good):
    def save(self) -> Any:
        self.temperature, saved = self.temperature + 1.0, super().save()
        return saved


def draws(self: Any, seed: int) -> Any:
    return Good.reset(self, next(numbers))


def needs_the_heater(self: Any, commands: Any) -> Any:
    commands["heater"]
    return Good.step(self, commands)


def no_limit(self: Any, commands: Any) -> Any:
    self.temperature += 60.0 * (commands.get("heater", 0.0) - 30.0 * (self.temperature - 20.0)) / 4.2e5
    return self.values(0.0)


def starts_a_thread(self: Any) -> None:
    done = threading.Event()
    threads.append((threading.Thread(target=done.wait, name="logger", daemon=True), done))
    threads[-1][0].start()
    self.start_degc = 40.0


class Wordless(Exception):
    def __str__(self) -> str:
        raise ValueError


def raises_what_has_no_text(self: Any, commands: Any) -> Any:
    raise Wordless


threads: list[tuple[threading.Thread, threading.Event]] = []

MUTANTS: dict[str, tuple[Any, dict[str, str]]] = {
    "undeclared": (mutant(step_s=0.0, sensors=None),
        {"can be created, reset and stepped": r"InvalidConfig: plant Mutant: step_s = 0.*\n.*no attribute sensors"}),
    "raises": (mutant(step=lambda self, commands: 1 / 0),
        {"can be created, reset and stepped": "raised ZeroDivisionError: division by zero"}),
    "returns a number": (mutant(step=lambda self, commands: 20.0),
        {"can be created, reset and stepped": r"step returned 20.0; expected a dictionary"}),
    "forgets a sensor": (changed(level=None),
        {"returns a value of each sensor and meter": "no value of 'level' at sample 0"}),
    "invents a sensor": (changed(pressure=1.0),
        {"returns a value of each sensor and meter": "'pressure' at sample 0 is neither a sensor nor a meter"}),
    "not a number": (changed(level=float("nan")), {"values are finite": "level = nan at sample 0; expected a finite"}),
    "exits": (mutant(step=lambda self, commands: sys.exit("bye")),
        {"can be created, reset and stepped": "raised SystemExit: bye"}),
    "raises what has no text": (mutant(step=raises_what_has_no_text),
        {"can be created, reset and stepped": "raised Wordless$"}),
    "exits at once": (mutant(__init__=lambda self: sys.exit("bye")),
        {"can be created, reset and stepped": "raised SystemExit: bye"}),
    "exits later": (mutant(save=lambda self: sys.exit("bye")), {"continues from a saved state": "SystemExit: bye"}),
    "a number as a text": (changed(level="1.5"), {"values are finite": "level = '1.5' at sample 0; expected a finite"}),
    "too large": (changed(level=10**400), {"values are finite": "level = 10+ at sample 0; expected a finite"}),
    "warns with a text": (mutant(drain_warnings=lambda self: "hot"),
        {"warnings are texts": "returned 'hot' at sample 0; expected a list of texts"}),
    "warns with numbers": (mutant(drain_warnings=lambda self: [self.level] if self.level != 1.0 else []),
        {"warnings are texts": r"returned \[.*\] at sample [1-9]\d*; expected a list of texts"}),
    "fails to warn": (mutant(drain_warnings=lambda self: self.warned),
        {"warnings are texts": r"drain_warnings\(\) at sample 0 raised AttributeError"}),
    "a text": (changed(level="full"), {"values are finite": "level = 'full' at sample 0; expected a finite"}),
    "too hot": (mutant(step=no_limit),
        {"values are within bounds": r"temperature = 9\d.*; its bounds are 20 to 95 degC \(at sample \d+, "}),
    "needs a command": (
        mutant(step=needs_the_heater),
        {
            "commands may be missing": "^without commands for heater, step raised KeyError: 'heater'\n"
            "without commands for some actuators in some steps, step raised KeyError: 'heater'$"
        },
    ),
    "draws unseeded": (
        mutant(reset=draws),
        {
            "the same seed results in the same episode": "resulted in another episode: temperature is .* at sample 0",
            "a reset during an episode leaves no trace": "",
            "shares no state between instances": "",
            "continues from a saved state": "",
        },
    ),
    "begins otherwise": (mutant(begins_alike=True),
        {"all episodes begin alike if it says so": "another seed resulted in another episode: temperature is 41"}),
    "remembers": (Remembers,
        {"a reset during an episode leaves no trace": "affects the next one: level is 1.0 and [^1]"}),
    "shares": (
        Shares,
        {
            "shares no state between instances": "next to another instance it continued differently: temperature is",
            "continues from a saved state": "",
        },
    ),
    "saves too little": (mutant(save=lambda self: (self.temperature, 1.0)),
        {"continues from a saved state": "a new instance with the saved state continued differently: level is"}),
    "state is not data": (mutant(save=lambda self: (self.temperature, lambda: self.level)),
        {"continues from a saved state": "save, pickling its state, or restore in a new instance raised"}),
    "save disturbs": (SaveDisturbs,
        {"continues from a saved state": r"after save\(\) it continued differently: temperature is"}),
    "restores once": (RestoresOnce,
        {"continues from a saved state": r"after restore\(\) in each step in one instance, it stepped differently"}),
    "forkable with threads": (mutant(Forkable, __init__=starts_a_thread),
        {"starts no threads if it is forkable": "it started logger, which a fork loses"}),
    "closes what an episode opens": (mutant(close=lambda self: self.log.close()),
        {"can be closed": r"close\(\) of a new instance raised AttributeError: .*'log'"}),
}  # fmt: skip


@pytest.mark.parametrize("name", MUTANTS)
def test_check_plant__what_a_bad_plant_violates_is_named(name: str) -> None:
    plant, violations = MUTANTS[name]
    with pytest.raises(ConformanceError) as error:
        check_plant(plant)
    errors = {result.name: "\n".join(result.errors) for result in error.value.report.results if result.errors}
    for check, text in violations.items():
        if text:
            assert re.search(text, errors[check]), errors
    assert set(errors) <= set(violations), errors
    for thread, done in threads:
        done.set()
        thread.join()


def test_check_plant__each_check_has_a_mutant() -> None:
    assert {check for _, violations in MUTANTS.values() for check, text in violations.items() if text} == set(
        PLANT_CHECKS
    )
