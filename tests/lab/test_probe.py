"""`zenostat probe`: what holding each actuator changes, on real buildings."""

import json
import re
import subprocess
from contextlib import closing
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import data_packs as packs
from support.nodes import SMALL, command_of, interrupted, nothing_left, programs_of
from support.run_cli import ZENOSTAT, error_of

from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.lab.probe import ProbeReport, ProbeRequest, probe
from zenostat.lab.probe_effects import HoldExperiment, Ranges, effect_of
from zenostat.topics.errors import InvalidConfig, UnknownName
from zenostat.topics.messages import Actuator, Aggregation, Manifest, Meter, Mode, Policy, Sensor, Versions

BEGIN = datetime(2017, 7, 3, 7)

OFFICE: dict[str, Any] = {
    **SMALL,
    "affinity": "off",
    "sensors": {
        "core_air": ("Zone Air Temperature", "Core_ZN"),
        "core_asked": ("Zone Thermostat Cooling Setpoint Temperature", "Core_ZN"),
        "outdoor": ("Site Outdoor Air Drybulb Temperature", "Environment"),
        "people": ("Zone People Occupant Count", "Core_ZN"),
    },
    "meters": {"electricity": "Electricity:Facility"},
    "actuators": {
        "core_cooling": ("Zone Temperature Control", "Cooling Setpoint", "Core_ZN", 22.5, 29.0),
        "core_heating": ("Zone Temperature Control", "Heating Setpoint", "Core_ZN", 10.0, 15.0),
    },
}


@pytest.fixture(scope="module")
def office() -> ProbeReport:
    """A summer Monday, two hours from 10 and from 15 o'clock."""
    return probe(OFFICE, hours=2, days=1, at=(10, 15))


# What is right of a real building


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("begin", ["01-16", "07-03"])
def test_probe__one_zone_data_centre_does_not_feel_its_only_action(begin: str, scratch: Path) -> None:
    """Approach temperatures rule its supply air; the node knows it from the model, and the probe sees it."""
    packs.sinergym()
    result = probe("smalldatacenter-hot-continuous-v1", days=1, begin=begin, end=begin, affinity="off")
    (effect,) = result.effects
    assert (effect.actuator, effect.responses, effect.first_min, effect.identical) == (
        "cooling_setpoint",
        (),
        None,
        True,
    )
    assert effect.pass_through == ("cooling_setpoint",)
    assert effect.tracked  # the schedule was what it was told to be: it is the building that does not care
    assert any("FlowControlWithApproachTemperatures" in note for note in effect.notes)


@pytest.mark.slow
def test_probe__two_zone_data_centre_does(scratch: Path) -> None:
    packs.sinergym()
    result = probe("datacenter_dx-hot-continuous-v1", days=1, begin="07-03", end="07-03", affinity="off")
    (effect,) = result.effects
    assert {"west_zone_air_temperature", "HVAC_electricity_demand_rate"} <= {felt.point for felt in effect.responses}
    assert effect.pass_through == ("cooling_setpoint",)


@pytest.mark.slow
def test_probe__cooling_setpoint_is_felt_by_its_zone_and_the_meter_and_by_nothing_that_is_given(
    office: ProbeReport,
) -> None:
    cooling, _ = office.effects
    felt = {one.point: one for one in cooling.responses}
    assert set(felt) == {"core_air", "electricity"}  # neither weather nor people
    assert 2.0 < felt["core_air"].difference <= 29.0 - 22.5
    assert 0.0 < felt["core_air"].share <= 1.0
    assert felt["core_air"].unit == "degC"
    assert cooling.first_min == 15.0
    assert (cooling.low, cooling.high, cooling.tracked) == (22.5, 29.0, True)
    assert cooling.pass_through == ("core_asked",)


@pytest.mark.slow
def test_probe__heating_setpoint_far_below_a_summer_s_day_changes_nothing(office: ProbeReport) -> None:
    _, heating = office.effects
    assert (heating.responses, heating.identical, heating.pass_through) == ((), True, ())


@pytest.mark.slow
def test_probe__branching_is_only_a_shortcut(scratch: Path) -> None:
    """Three whole episodes, two of them held from 15 o'clock on, differ as the branches do, to the last bit."""
    step, length = 15 * 4, 8
    holds = {"alone": {}, "low": {"core_cooling": 22.5}, "high": {"core_cooling": 29.0}}
    rows: dict[str, list[Any]] = {name: [] for name in holds}
    for name, hold in holds.items():
        with closing(BuildingEnv(**OFFICE, reward=None)) as env:
            env.link.reset(seed=0)
            for k in range(step + length):
                env.link.send(hold if k == step else None)
                rows[name].append(env.link.receive().values)
    apart = {side: np.abs(np.array(rows[side]) - np.array(rows["alone"])) for side in ("low", "high")}
    assert not apart["low"][:step].any()
    assert not apart["high"][:step].any()
    result = probe(OFFICE, hours=2, days=1, at=(15,))
    felt = {one.point: one for one in result.effects[0].responses}
    assert result.times == (datetime(2017, 7, 3, 15),)
    for place, name in ((0, "core_air"), (4, "electricity")):
        one, by_side = felt[name], {side: of[step:, place] for side, of in apart.items()}
        assert one.difference == max(of.max() for of in by_side.values())
        assert one.difference == by_side[one.side][round(one.after_min / 15.0) - 1]


@pytest.mark.slow
def test_probe__branch_that_energyplus_gives_up_in_is_a_note(scratch: Path) -> None:
    """A heating setpoint above the cooling setpoint ends EnergyPlus; the others' branches go on."""
    wide = ("Zone Temperature Control", "Heating Setpoint", "Core_ZN", 15.0, 40.0)
    actuators = OFFICE["actuators"] | {"core_heating": wide}
    result = probe({**OFFICE, "actuators": actuators}, hours=1, days=1, at=(15,))
    cooling, heating = result.effects
    assert [
        note for note in heating.notes if note.startswith("EnergyPlus failed in 1 of the branches that held it high")
    ]
    assert cooling.responses
    assert cooling.notes == ()


# What cannot be


@pytest.mark.slow
def test_probe__reports_all_errors_at_once(scratch: Path) -> None:
    people = {"people": ("People", "Number of People", "Core_ZN People")}
    settings = {**OFFICE, "actuators": people}
    with nothing_left(scratch), pytest.raises(InvalidConfig) as caught:
        probe(settings, points=["cores_*"], low={"peple": 1.0}, at=(24,))
    message = str(caught.value)
    assert "no sensor or meter 'cores_*'" in message
    assert "no actuator 'peple'; did you mean 'people'" in message
    assert "one hour from 0 to below 24" in message
    assert "people has no bound to hold it at" in message
    assert "add --high people=VALUE" in message  # its least is 0


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"hours": 30.0}, "no branch of 120 timesteps"),
        ({"hours": float("nan")}, "got 0 timesteps"),
        ({"low": {"core_cooling": 29.0}}, "low 29 is not below high 29"),
        ({"high": {"core_heating": 16.0}}, "--high core_heating=16: its bounds are 10 to 15 degC"),
        ({"actuators": {}}, "no actuators"),
        ({"wether": "USA_CO_Denver"}, "did you mean 'weather'"),
    ],
)
def test_probe__mistake(arguments: dict[str, Any], message: str, scratch: Path) -> None:
    with pytest.raises(InvalidConfig, match=re.escape(message)):
        probe(OFFICE, **arguments)


@pytest.mark.slow
def test_probe__counts_the_requested_points_only(scratch: Path) -> None:
    result = probe(OFFICE, hours=1, days=1, at=(15,), points=["core_*", "outdoor"])
    assert [felt.point for felt in result.effects[0].responses] == ["core_air"]
    with pytest.raises(UnknownName, match="no sensor or meter 'air'"):
        probe(OFFICE, points=["air"])


# The comparison, by hand


def _manifest(**fields: Any) -> Manifest:
    sensors = (
        Sensor(name="air", variable="Zone Air Temperature", key="Z", unit="degC", aggregation=Aggregation.MEAN),
        Sensor(name="asked", variable="Schedule Value", key="S", unit="", aggregation=Aggregation.INSTANT),
        Sensor(name="lamp", variable="Lights Electricity Rate", key="L", unit="W", aggregation=Aggregation.MEAN),
    )
    actuator = Actuator(
        name="setpoint", component_type="Schedule:Constant", control_type="Schedule Value", key="S", unit="1",
        low=20.0, high=30.0, feedback="Schedule Value",
    )  # fmt: skip
    whole: dict[str, Any] = {
        "node": "n", "instance": "1", "building": "b", "weather": "w", "location": "l", "begin": "2017-07-03T00:00:00",
        "end": "2017-07-04T00:00:00", "step_s": 900.0, "steps": 96, "mode": Mode.LOCKSTEP, "policy": Policy.WAIT,
        "sensors": sensors, "meters": (Meter(name="used", meter="Electricity:Facility", unit="J"),),
        "actuators": (actuator,), "versions": Versions(zenostat="1", energyplus="25.2"),
    }  # fmt: skip
    return Manifest(**{**whole, **fields})


def test_probe__temperature_without_bounds_is_held_two_kelvin_from_what_it_was() -> None:
    (bounded,) = _manifest().actuators
    free = bounded.model_copy(update={"unit": "degC", "low": None, "high": None})
    asked = ProbeRequest(_manifest(actuators=(free,)), 1.0, 1, (7,), (), {}, {})
    assert asked.hold_values(free, 24.0) == (("low", 22.0), ("high", 26.0))
    half = free.model_copy(update={"low": 20.0})
    assert asked.hold_values(half, 24.0) == (("low", 20.0), ("high", 26.0))
    silent = free.model_copy(update={"feedback": None})
    with pytest.raises(InvalidConfig, match="add --low setpoint=VALUE and --high setpoint=VALUE"):
        ProbeRequest(_manifest(actuators=(silent,)), 1.0, 1, (7,), (), {}, {})


@pytest.mark.parametrize(
    ("begin", "steps", "days", "times"),
    [
        ("2017-01-01", 365 * 96, 4, ["2017-01-16", "2017-04-17", "2017-07-17", "2017-10-16"]),  # all Mondays
        ("2017-07-03", 96, 4, ["2017-07-03"]),
        ("2017-07-08", 96, 1, ["2017-07-08"]),  # nothing but a Saturday
    ],
)
def test_probe__branches_are_spread_over_the_working_days(begin: str, steps: int, days: int, times: list[str]) -> None:
    manifest = _manifest(begin=f"{begin}T00:00:00", steps=steps)
    first = datetime.fromisoformat(begin)
    starts = [
        first + timedelta(minutes=15 * step) for step in ProbeRequest(manifest, 3.0, days, (7,), (), {}, {}).steps
    ]
    assert starts == [datetime.fromisoformat(f"{day}T07:00") for day in times]


def _effect(
    points: list[list[float]], alone: list[list[float]], *, side: Any = "high", value: float = 30.0, **fields: Any
):
    manifest = _manifest(**fields)
    one = HoldExperiment(side, value, BEGIN, np.array(points), np.array(alone), np.full(len(points), value))
    ranges = Ranges(4)
    ranges.add(one.points)
    ranges.add(one.reference)
    return effect_of(manifest, manifest.actuators[0], [one], range(4), ranges.spans)


def test_probe__share_is_of_the_range_and_the_first_felt_is_the_end_of_its_timestep() -> None:
    alone = [[22.0, 24.0, 0.0, 5.0], [20.0, 24.0, 0.0, 5.0], [21.0, 24.0, 0.0, 5.0]]
    points = [[22.0, 30.0, 0.0, 5.0], [20.5, 30.0, 0.0, 5.0], [24.0, 30.0, 0.0, 6.0]]
    effect = _effect(points, alone)
    air, used = sorted(effect.responses, key=lambda felt: felt.point)
    assert (air.difference, air.share, air.after_min) == (3.0, 3.0 / 4.0, 45.0)
    assert (used.difference, used.share, used.after_min) == (1.0, 1.0, 45.0)
    assert [felt.point for felt in effect.responses] == ["used", "air"]
    assert effect.first_min == 30.0
    assert effect.pass_through == ("asked",)


def test_probe__rounding_is_no_effect_and_not_identical() -> None:
    effect = _effect([[22.0 * (1 + 1e-12), 30.0, 0.0, 5.0]], [[22.0, 24.0, 0.0, 5.0]])
    assert (effect.responses, effect.first_min, effect.identical) == ((), None, False)


def test_probe__load_that_is_what_it_was_set_to_is_an_effect() -> None:
    """Only variables that say what is asked for are echoes: power that repeats the command is real."""
    effect = _effect([[22.0, 30.0, 30.0, 5.0]], [[22.0, 24.0, 0.0, 5.0]])
    assert [felt.point for felt in effect.responses] == ["lamp"]


def test_probe__warning_of_the_node_is_with_its_actuator() -> None:
    warnings = ("actuator 'setpoint': an EMS program sets it", "actuator 'other': nothing")
    same = [[22.0, 24.0, 0.0, 5.0]]
    assert _effect(same, same, warnings=warnings).notes == warnings[:1]


# The command


def _probe(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*ZENOSTAT, "probe", *arguments], capture_output=True, text=True, cwd=cwd, timeout=90)


SCENARIO = "ref-small-office-USA_CO_Denver-continuous-v1"
DAY = ["--begin", "07-03", "--end", "07-03", "--days", "1", "--at", "15", "--hours", "0.5"]


@pytest.mark.slow
def test_probe__command_tells_json_and_a_table(scratch: Path) -> None:
    zones = ["--set", "control=zone", *DAY]
    done = _probe(SCENARIO, *zones, "--json", cwd=scratch)
    assert done.returncode == 0, done.stderr
    output = json.loads(done.stdout)
    assert (output["times"], output["hours"], output["timestep_min"]) == (["2017-07-03T15:00:00"], 0.5, 10.0)
    by_name = {effect["actuator"]: effect for effect in output["actuators"]}
    cooling = by_name["core_zn_cooling_setpoint"]
    assert "core_zn_air_temperature" in {felt["point"] for felt in cooling["responses"]}
    shown = _probe(SCENARIO, *zones, "--points", "core_*", cwd=scratch)
    assert shown.returncode == 0, shown.stderr
    assert re.search(r"core_zn_cooling_setpoint +22\.5, 30 degC +10 min +core_zn_air_temperature", shown.stdout)
    assert "core_zn_heating_setpoint" in shown.stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--low", "core", "--set", "x"], "--low core: expected an actuator and a number"),
        (["--low", "core=1", "--low", "core=2"], "--low core occurs twice: 1.0 and 2.0"),
        (["--set", "colour=red"], "colour: not an argument of a scenario"),
        (["--points", "roof"], "no sensor or meter 'roof'"),
    ],
)
def test_probe__mistakes_in_the_call_are_sentences(scratch: Path, arguments: list[str], message: str) -> None:
    assert message in error_of("probe", SCENARIO, *DAY, *arguments, cwd=scratch)


@pytest.mark.slow
def test_probe__ctrl_c_leaves_nothing_behind(scratch: Path) -> None:
    """In the midst of the branches: a year's probe with more engines than the trunk's."""
    command = [*ZENOSTAT, "probe", SCENARIO, "--set", "control=zone", "--begin", "07-03", "--hours", "24", "--json"]

    def branches() -> bool:
        return len([p for p in programs_of(scratch) if "zenostat.eplus_node.engine" in command_of(p)]) > 2

    interrupted(command, branches, "it branches", cwd=scratch)
