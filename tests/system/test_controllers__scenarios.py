"""The controllers on real scenarios: what they set, what comes of it, and `zenostat run`."""

import subprocess
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from support import data_packs as packs
from support.builders import manifest
from support.nodes import SMALL, NodeProgram, node_on_bus
from support.run_cli import ZENOSTAT, error_of

import zenostat
from zenostat.agent_sdk.controllers import (
    Agent,
    Controller,
    IncrementalRules,
    RandomController,
    RuleBasedController,
    action_of,
)
from zenostat.agent_sdk.envs.spaces import action_space
from zenostat.bridge.client.sample import SampleView
from zenostat.eplus_node.config import read_config
from zenostat.eplus_node.plan import plan
from zenostat.topics.messages import Manifest, Sample
from zenostat.topics.points import value_index
from zenostat.topics.scenario_ids import BUILDINGS, WEATHERS, pack_ids

EXAMPLES = Path(__file__).parents[2] / "examples"
BUNDLED = ("office-small", "office-medium", "ref-warehouse", "warehouse", "ref-large-hotel", "hotel-small")
FORMS = {tuple(name.split("-")[::2][:2]): name for name in reversed(pack_ids()) if "stochastic" not in name}
"""The first id of each building of the pack in each of its forms."""


@pytest.fixture(scope="module", autouse=True)
def pack() -> Path:
    """The data pack, fetched if it is not there."""
    return packs.sinergym()


def manifest_of(name: str) -> Manifest:
    """The points and the task of a scenario, without simulating it."""
    planned = plan(read_config({"scenario": name}))
    points = planned.points
    return manifest(sensors=points.sensors, meters=points.meters, actuators=points.actuators, task=planned.task)


def made_up(of: Manifest, at: str, temperature: float, people: float) -> SampleView:
    """A sample in which all temperatures are one, and as many people are in each zone."""
    row = [people if "People" in s.variable else temperature for s in of.sensors] + [0.0 for _ in of.meters]
    wire = Sample(
        episode=[0],
        step=[0],
        time=[at],
        elapsed_s=[0.0],
        flags=[0],
        values=np.array(row, "<f8").tobytes(),
        effective=bytes(8 * len(of.actuators)),
        source_index=bytes(2 * len(of.actuators)),
        sources=[""],
    )
    return SampleView(wire, of, value_index(of))


def check_acts(controller: type[Controller], of: Manifest) -> None:
    """It sets all actuators within their bounds, and its values are an action of the space."""
    acting, space = controller(of), action_space(of)
    for at in ("2017-01-16T03:00:00", "2017-07-17T12:00:00"):
        for temperature in (5.0, 20.5, 24.0, 40.0):
            for people in (0.0, 3.0):
                values = acting.act(made_up(of, at, temperature, people))
                assert set(values) == {a.name for a in of.actuators}
                for actuator in of.actuators:
                    assert actuator.low <= values[actuator.name] <= actuator.high
                assert space.contains(action_of(of, values))


@pytest.mark.variants
@pytest.mark.parametrize("name", [*FORMS.values(), *(f"{b}-{WEATHERS[0]}-discrete-v1" for b in BUNDLED)])
def test_controllers__rules_act_on_each_building_of_the_pack_and_some_of_ours(name: str) -> None:
    check_acts(RuleBasedController, manifest_of(name))
    if not name.startswith("radiant"):
        check_acts(IncrementalRules, manifest_of(name))


def test_controllers__rules_take_the_band_of_a_data_centre() -> None:
    of = manifest_of("datacenter_cw-hot-continuous-v1")
    values = RuleBasedController(of).act(made_up(of, "2017-07-17T12:00:00", 26.5, 0.0))
    # 18 to 27 degC; 26.5 is half way from where the water is warmest (10) to where it is coldest (5).
    assert values == pytest.approx({"cooling_setpoint": 26.0, "chws_supply_temperature": 7.5})


def test_controllers__rules_heat_the_rooms_of_the_radiant_building_that_are_cold() -> None:
    of = manifest_of("radiant-stockholm-discrete-v1")
    sample = made_up(of, "2017-01-16T12:00:00", 20.5, 0.0)
    row = sample.values.copy()
    row[of.names.index("secondfloor_bedroom02_air_temperature")] = 18.0
    cold = SampleView(sample.message.model_copy(update={"values": row.tobytes()}), of, value_index(of))
    values = RuleBasedController(of).act(cold)
    assert [name for name, value in values.items() if value == 1.0] == ["radiant_bed2_availavility"]
    assert values["water_temperature"] == 45.0
    assert action_of(of, values).tolist() == [0, 0, 0, 1, 0, 20]


@pytest.mark.slow
@pytest.mark.parametrize("name", [*pack_ids(), *(f"{b}-{WEATHERS[0]}-continuous-v1" for b in BUILDINGS)])
def test_controllers__rules_act_on_each_id_of_the_pack_and_each_of_our_buildings(name: str) -> None:
    check_acts(RuleBasedController, manifest_of(name))


# Real runs


def day(controller: type[Controller], env: gym.Env[Any, Any], **parameters: Any) -> float:
    """A day's sum of the reward's comfort term."""
    agent = Agent(controller(env.unwrapped.manifest, **parameters))
    env.reset(seed=0)
    comfort, ended = 0.0, False
    while not ended:
        _, _, _, ended, info = env.step(agent.action(env.unwrapped.sample))
        comfort += info["reward_terms"]["comfort"]
    return comfort


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("name", ["5zone-hot-continuous-v1", "5zone-hot-discrete-v1", "ref-small-office"])
def test_controllers__rules_are_more_comfortable_than_chance(name: str) -> None:
    settings = SMALL if name in BUILDINGS else {"scenario": name, "begin": "07-03", "end": "07-03"}
    with gym.make("zenostat/Building-v1", **settings, affinity="off") as env:
        rules, chance = day(RuleBasedController, env), day(RandomController, env, seed=0)
        assert rules > chance
        assert day(RuleBasedController, env) == rules  # nothing is left of the episode before


# `zenostat run`


def run(node: NodeProgram, *arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    command = [*ZENOSTAT, "run", "--node", node.name, "--connect", node.endpoint]
    return subprocess.run([*command, *arguments], capture_output=True, text=True, cwd=cwd, timeout=120)


@pytest.mark.slow
def test_controllers__zenostat_run_with_parameters_seeds_and_classes_of_anybodys(scratch: Path) -> None:
    with node_on_bus(scratch / "node", **SMALL) as (node, bus):

        def rewards(*arguments: str, cwd: Path | None = None) -> list[float]:
            done = run(node, "--reset", *arguments, cwd=cwd)
            assert done.returncode == 0, done.stderr
            latest = bus.latest("office")
            assert latest.step == [96]
            return np.frombuffer(latest.effective, "<f8").tolist()

        fixed = rewards(
            "--controller", "fixed", "--set", "core_zn_cooling_setpoint=27", "--set", "core_zn_heating_setpoint=19.5"
        )
        named = dict(zip((a.name for a in bus.manifest("office").actuators), fixed, strict=True))
        assert (named["core_zn_heating_setpoint"], named["core_zn_cooling_setpoint"]) == (19.5, 27.0)
        assert named["perimeter_zn_1_cooling_setpoint"] == 25.0  # 1 K inside the band of July

        drawn = rewards("--controller", "random", "--seed", "3")
        assert rewards("--controller", "random", "--seed", "3") == drawn
        assert rewards("--controller", "random", "--seed", "4") != drawn

        mine = rewards("--controller", f"{EXAMPLES / 'my_controller.py'}:Mine", "--set", "night=28.5")
        assert mine.count(28.5) == 5  # the last timestep is before midnight
        (scratch / "models.py").write_text("NIGHT = 27.25\n")
        (scratch / "brain.py").write_text(
            "import models\nfrom zenostat.controllers import FixedSetpoints\n\n"
            "class Brain(FixedSetpoints):\n    def __init__(self, manifest):\n"
            "        super().__init__(manifest, core_zn_cooling_setpoint=models.NIGHT)\n"
        )
        assert 27.25 in rewards("--controller", "brain.py:Brain", cwd=scratch)
        assert 27.25 in rewards("--controller", "brain:Brain", cwd=scratch)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--controller", "pid", "--set", "setpoint=21"], "pid takes one sensor: name it by sensor=...;"),
        (["--controller", "pid"], "PIDController needs setpoint: --set setpoint=..."),
        (["--controller", "rbc", "--set", "margin"], "--set margin: expected a name and a value"),
        (["--controller", "rbc", "--set", "margin=1", "--set", "margin=2"], "--set margin occurs twice: 1 and 2"),
        (
            ["--controller", "rbc", "--seed", "1"],
            "--seed 1 has no effect: rbc is not random and joins a running episode",
        ),
        (["--controller", "random", "--seed", "1", "--set", "seed=2"], "use one of them"),
        (["--controller", "mine.py:Mine"], "there is no file"),
    ],
)
def test_controllers__mistakes_are_one_sentence_and_claim_nothing(
    shared_node: NodeProgram, arguments: list[str], message: str
) -> None:
    assert message in error_of("run", "--node", shared_node.name, "--connect", shared_node.endpoint, *arguments)
    with zenostat.connect(shared_node.endpoint, affinity="off") as bus:
        assert bus.status("office").controllers == []
