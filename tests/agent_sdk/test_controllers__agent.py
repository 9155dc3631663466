"""Controllers as agents of an environment, and controllers by name."""

import math
import os
import random
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.builders import actuator, manifest, view
from support.controller_nodes import COOL, HEAT, ROOM, discrete, node

from zenostat.agent_sdk.controllers import (
    CONTROLLERS,
    Agent,
    BaselineController,
    Controller,
    RuleBasedController,
    action_of,
    load_controller,
    make_controller,
)
from zenostat.bridge.client.sample import SampleView
from zenostat.topics.errors import InvalidAction, InvalidConfig, UnknownName
from zenostat.topics.messages import Action, DiscreteAction, Task

# As an agent


def test_controllers__values_as_an_action() -> None:
    of = node()
    action = action_of(of, {COOL.name: 26.0, HEAT.name: 21.0})
    assert (action.dtype, action.tolist()) == (np.float32, [21.0, 26.0])


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({}, "leaves 'heating_setpoint' to baseline control, but an action always sets a value"),
        ({HEAT.name: None, COOL.name: 25.0}, "if it does at times, use relative actions, or compare recordings"),
        ({HEAT.name: 20.0, COOL.name: 31.0}, "cooling_setpoint = 31; its bounds are 22.5 to 30 degC"),
        ({HEAT.name: 20.0, COOL.name: math.nan}, "cooling_setpoint = nan; expected a finite number"),
        ({HEAT.name: 20.0, COOL.name: 25.0, "fan": 1.0}, "no action of the task sets 'fan'"),
    ],
)
def test_controllers__values_that_no_action_can_say(values: dict[str, float | None], message: str) -> None:
    with pytest.raises(InvalidAction, match=message):
        action_of(node(), values)


class Answer:
    """A controller with prescribed answers."""

    def __init__(self, *answers: Any) -> None:
        self.answers = [*answers]

    def act(self, sample: SampleView) -> Any:
        return self.answers.pop(0)


def generated() -> Iterator[dict[str, float]]:
    yield {HEAT.name: 20.0}


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        ([20.0, 25.0], r"Answer\.act returned \[20.0, 25.0\] in step 0; a mapping of actuators to values expected"),
        (
            generated(),
            r"Answer\.act returned <generator object .*> in step 0; a mapping of actuators to values expected",
        ),
        ({HEAT.name: "20", COOL.name: 25.0}, r"Answer, step 0: heating_setpoint = '20'; a finite number or None"),
        ({HEAT.name: 20.0, COOL.name: True}, r"Answer, step 0: cooling_setpoint = True; a finite number or None"),
        ({HEAT.name: 20.0, COOL.name: math.inf}, r"Answer, step 0: cooling_setpoint = inf; a finite number or None"),
    ],
)
def test_agent__names_the_controller_and_what_it_returned(answer: Any, message: str) -> None:
    for method in ("values", "action"):
        with pytest.raises(InvalidAction, match=message):
            getattr(Agent(Answer(answer)), method)(view(node()))


def test_agent__none_keeps_all_values() -> None:
    agent = Agent(Answer({HEAT.name: 20.0, COOL.name: 25.0}, None, None))
    assert [agent.action(view(node(), step=step)).tolist() for step in range(2)] == [[20.0, 25.0]] * 2
    assert agent.values(view(node(), step=2)) == {}


def test_controllers__one_action_states_one_value() -> None:
    both = Action(name="both", unit="degC", actuators=(HEAT.name, COOL.name))
    of = node(task=Task(actions=(both,)))
    assert action_of(of, {HEAT.name: 22.5, COOL.name: 22.5}).tolist() == [22.5]
    with pytest.raises(InvalidAction, match="sets one value for all its actuators, but got heating_setpoint = 20"):
        action_of(of, {HEAT.name: 20.0, COOL.name: 25.0})


def test_controllers__nearest_choice() -> None:
    rows = ((15.0, 30.0), (20.0, 25.0), (22.0, 23.0))
    one = node(task=discrete(DiscreteAction(actions=(HEAT.name, COOL.name), values=rows)))
    assert action_of(one, {HEAT.name: 20.3, COOL.name: 24.0}) == 1  # 0.09 + 1 against 2.89 + 1
    assert action_of(one, {HEAT.name: 21.0, COOL.name: 24.0}) == 1  # the first of equals
    two = node(
        task=discrete(
            DiscreteAction(actions=(HEAT.name,), values=((16.0,), (20.0,))),
            DiscreteAction(actions=(COOL.name,), values=((24.0,), (27.0,), (30.0,))),
        )
    )
    action = action_of(two, {HEAT.name: 21.0, COOL.name: 28.0})
    assert (action.dtype, action.tolist()) == (np.int64, [1, 1])


def test_controllers__room_setpoints_go_first_among_choices() -> None:
    cooling, water = actuator("cooling_setpoint", 20.0, 30.0), actuator("chw_temperature", 5.0, 10.0)
    actions = node(cooling, water).task.actions
    rows = ((27.0, 6.0), (27.0, 7.0), (29.0, 10.0))
    of = node(
        cooling,
        water,
        task=Task(actions=actions, discrete_actions=(DiscreteAction(actions=(cooling.name, water.name), values=rows),)),
    )
    assert action_of(of, {cooling.name: 26.7, water.name: 10.0}) == 1


def test_controllers__agent_keeps_what_is_not_named_until_the_episode_ends() -> None:
    class Once:
        def __init__(self) -> None:
            self.begun: list[int] = []

        def begin(self, sample: SampleView) -> None:
            self.begun.append(sample.episode)

        def act(self, sample: SampleView) -> dict[str, float | None]:
            return {HEAT.name: 20.0, COOL.name: 25.0} if sample.step == 0 else {COOL.name: 26.0}

    of, once = node(), Once()
    agent = Agent(once)
    assert agent.action(view(of)).tolist() == [20.0, 25.0]
    assert agent.action(view(of, step=1)).tolist() == [20.0, 26.0]
    with pytest.raises(InvalidAction, match="leaves 'heating_setpoint'"):
        agent.action(view(of, episode=1, step=5))  # joined amid an episode
    assert once.begun == [0, 1]
    agent.values(view(of, episode=1))  # a reset of a node that stands at sample 0 already
    assert once.begun == [0, 1, 1]


def test_controllers__buildings_own_control_as_an_agent() -> None:
    empty = manifest(sensors=[ROOM])
    assert Agent(BaselineController(empty)).action(view(empty)).shape == (0,)
    with pytest.raises(InvalidAction, match="all is under baseline control"):
        Agent(BaselineController(node())).action(view(node()))


# Controllers by name


@pytest.fixture
def modules() -> Iterator[dict[str, Any]]:
    """All modules are the same afterwards, but for new ones of the tests' own."""
    for name in [name for name in sys.modules if name.startswith("_controller_")]:
        del sys.modules[name]  # of a test that ran before in this process
    before, finders = dict(sys.modules), list(sys.meta_path)
    yield before
    assert sys.meta_path == finders
    changed = {name for name in before if sys.modules.get(name) is not before[name]}
    for name in set(sys.modules) - set(before):
        del sys.modules[name]
    sys.modules.update(before)
    assert changed == set()


MINE = """
class Mine:
    def __init__(self, manifest, *, setpoint=25.0):
        self.setpoint = setpoint

    def act(self, sample):
        return {"cooling_setpoint": self.setpoint}
"""

NO_CONTROLLERS = """
from zenostat.agent_sdk.controllers import Controller

VALUE = 1

class Idle:
    pass

class Bare:
    def act(self, sample):
        pass
"""


def test_controllers__file_that_is_written_again_within_a_second_is_the_new_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, modules: dict[str, Any]
) -> None:
    """Python's cached bytecode is valid for a text of the same length and time."""
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    file = tmp_path / "mine.py"
    for setpoint in (21.0, 25.0):
        file.write_text(MINE.replace("25.0", str(setpoint)))
        os.utime(file, (1_700_000_000, 1_700_000_000))
        assert load_controller(f"{file}:Mine")(node()).setpoint == setpoint


def test_controllers__short_names() -> None:
    assert set(CONTROLLERS) == {
        "baseline",
        "rbc",
        "random",
        "fixed",
        "setback",
        "offsets",
        "incremental",
        "oracle",
        "pid",
        "coordinator",
        "portable-limit",
        "portable-setback",
    }
    assert load_controller("rbc") is RuleBasedController
    assert all(issubclass(controller, Controller) for controller in CONTROLLERS.values())


def test_controllers__class_of_anybodys_in_a_file(tmp_path: Path, modules: dict[str, Any]) -> None:
    (tmp_path / "mine.py").write_text(MINE)
    controller = make_controller(load_controller(f"{tmp_path}/mine.py:Mine"), node(), {"setpoint": 26.5})
    assert controller.act(view(node())) == {"cooling_setpoint": 26.5}
    with pytest.raises(InvalidConfig, match="Mine has no parameter 'setpint'; did you mean 'setpoint'"):
        make_controller(type(controller), node(), {"setpint": 1})


def test_controllers__module_in_the_present_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, modules: dict[str, Any]
) -> None:
    name = f"brains_{random.randrange(10**9)}"
    (tmp_path / name).mkdir()
    (tmp_path / name / "mine.py").write_text(MINE)
    monkeypatch.chdir(tmp_path)
    path = list(sys.path)
    assert load_controller(f"{name}.mine:Mine").__name__ == "Mine"
    assert sys.path == path
    with pytest.raises(UnknownName, match=rf"there is no module '{name}\.other', neither installed nor in"):
        load_controller(f"{name}.other:Mine")


def test_load_controller__file_beside_modules_with_the_names_of_our_packages(
    tmp_path: Path, modules: dict[str, Any]
) -> None:
    (tmp_path / "models.py").write_text("SETPOINT = 27.5\n")
    (tmp_path / "topics.py").write_text("OFFSET = 0.5\n")
    (tmp_path / "mine.py").write_text(
        "from models import SETPOINT\nfrom topics import OFFSET\nfrom zenostat.models import catalog\n"
        + MINE.replace("self.setpoint}", "SETPOINT + OFFSET}")
    )
    controller = load_controller(f"{tmp_path / 'mine.py'}:Mine")(node())
    assert controller.act(view(node())) == {"cooling_setpoint": 28.0}


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("rcb", UnknownName, r"no controller 'rcb'; .*'rbc'.*path/to/file\.py:MyController"),
        ("training/none", UnknownName, r"there is no folder /.*/training/none to load a controller from"),
        ("nowhere/mine.py", UnknownName, r"no controller 'nowhere/mine\.py'; .*path/to/file\.py:MyController"),
        ("nowhere/mine.py:Mine", UnknownName, r"there is no file .*/nowhere/mine\.py"),
        ("folder.py:Mine", UnknownName, r"/folder\.py is a folder; expected a Python file"),
        ("mine.py:Mien", UnknownName, r"there is no 'Mien' in mine\.py; did you mean 'Mine'"),
        ("mine.py:VALUE", InvalidConfig,
            r"VALUE of mine\.py is not a controller: expected a class with a method act\(sample\)"),
        ("mine.py:Idle", InvalidConfig, r"Idle of mine\.py is not a controller: expected a class with a method act"),
        ("mine.py:Bare", InvalidConfig, r"Bare of mine\.py is not a controller: it has to accept the manifest"),
        ("mine.py:Controller", InvalidConfig,
            r"Controller of mine\.py is not a controller: its act\(sample\) is abstract"),
        ("broken.py:Mine", InvalidConfig, r"loading broken\.py failed: broken\.py, line 3: ZeroDivisionError"),
        ("wrong.py:Mine", InvalidConfig, r"loading wrong\.py failed: SyntaxError"),
        ("quits.py:Mine", InvalidConfig, r"loading quits\.py failed: quits\.py, line 2: SystemExit: 3"),
        ("no.such.module:Mine", UnknownName, r"there is no module 'no\.such\.module'"),
    ],
)  # fmt: skip
def test_controllers__what_is_no_controller(
    text: str,
    error: type[Exception],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    modules: dict[str, Any],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(MINE + NO_CONTROLLERS)
    (tmp_path / "broken.py").write_text("\n\n1 / 0\n")
    (tmp_path / "folder.py").mkdir()
    (tmp_path / "wrong.py").write_text("class\n")
    (tmp_path / "quits.py").write_text("import sys\nsys.exit(3)\n")
    with pytest.raises(error, match=message) as caught:
        load_controller(text)
    assert "\n" not in str(caught.value)


def test_agent__context_of_a_policys_wrappers_is_the_environments() -> None:
    class Policy:
        sets_context = True

        def act(self, sample: SampleView) -> dict[str, float | None]:
            return {HEAT.name: 20.0, COOL.name: 26.0, "fan": 1.0}

    class Environment:
        context: dict[str, float | None] = {}  # noqa: RUF012

        def set_context(self, values: dict[str, float | None]) -> None:
            self.context = values

    env, sample = Environment(), view(node())
    assert Agent(Policy(), env).action(sample).tolist() == [20.0, 26.0]  # type: ignore[arg-type]
    assert env.context == {"fan": 1.0}
    with pytest.raises(InvalidAction, match="no action of the task sets 'fan'"):
        Agent(Policy()).action(sample)
