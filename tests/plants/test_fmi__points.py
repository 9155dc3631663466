"""Points and experiment of an FMU: what its model description says, and what is refused by name."""

import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.fmus import build_tank, download_fmus, inputs_of

from zenostat.testing import check_plant
from zenostat.topics.errors import InvalidConfig, PlantFailed

fmpy = pytest.importorskip("fmpy")

from zenostat.plants.fmi import model  # noqa: E402
from zenostat.plants.fmi.plant import FmuPlant  # noqa: E402
from zenostat.plants.fmi.variables import PointNames, inputs, point_name  # noqa: E402

STEP_S = 60.0


@pytest.fixture(scope="module")
def tank(module_scratch: Path) -> Path:
    return build_tank(module_scratch)


# Points


def test_fmu__points_have_units_bounds_and_start_values_of_the_model_description(tank: Path) -> None:
    plant = FmuPlant(str(tank))
    assert plant.model_name == "Tank"
    assert plant.sensors == {"T": ("degC", -50.0, None), "steps": ("1", None, None), "power": ("W", None, None)}
    assert plant.actuators == {
        "heat": ("W", 0.0, 3000.0, 0.0),
        "extra": ("W", 0.0, 500.0),
        "deed": ("1", 0.0, 9.0, 0.0),
        "mode": ("1", 1.0, 2.0, 1.0),
    }
    assert (plant.step_s, plant.duration_s, f"{plant.begin}") == (60.0, 6000.0, "2001-01-01 00:00:00")
    assert (plant.warnings, plant.files) == ([], {"fmu": str(tank)})


def test_fmu__overwrite_pair_is_active_while_it_is_commanded(tank: Path) -> None:
    plant = FmuPlant(str(tank))
    plant.reset(0)
    others = {"heat": 1000.0, "deed": 0.0, "mode": 1.0}
    powers = [plant.step({**others, **extra})["power"] for extra in ({}, {"extra": 300.0}, {"extra": 0.0}, {})]
    assert powers == [1050.0, 1300.0, 1000.0, 1050.0]


def test_fmu__overwrite_pair_that_is_set_to_active_stays_so(tank: Path) -> None:
    plant = FmuPlant(str(tank), set={"extra_u": 300.0, "extra_activate": True})
    plant.reset(0)
    others = {"heat": 1000.0, "deed": 0.0, "mode": 1.0}
    powers = [plant.step({**others, **extra})["power"] for extra in ({}, {"extra": 100.0}, {})]
    assert powers == [1300.0, 1100.0, 1300.0]


@pytest.mark.parametrize(
    ("name", "point"),
    [
        ("T", "T"), ("zone.T[2]", "zone.T.2"), ("k[1,2].x", "k.1.2.x"), ("der(der(x))", "der.der.x"),
        ("heißes Wasser", "hei_esWasser"), ("a'b", "ab"), ("_block1.y", "_block1.y"), ("'-power'", "power"),
        ("-.x-", "x-"), ("-", "_"), ("a" * 95 + "[1].x", "a" * 95),
    ],
)  # fmt: skip
def test_point_name__has_only_characters_of_a_topic(name: str, point: str) -> None:
    assert point_name(name) == point


def test_point_names__equal_names_are_numbered() -> None:
    names = PointNames()
    assert [names.add(name) for name in ("a[1]", "a.1", "a(1)", "b")] == ["a.1", "a.1_2", "a.1_3", "b"]
    long = [names.add("a" * 200 + end) for end in "xy"]
    assert (len({*long}), max(map(len, long))) == (2, 96)


def test_fmu__observed_variable_is_a_sensor(tank: Path) -> None:
    plant = FmuPlant(str(tank), observe=["der(T)"], set={"heat": 418.6, "extra_u": 0.0, "extra_activate": True})
    assert plant.sensors["der.T"] == ("K/s", None, None)
    assert plant.reset(0)["der.T"] == pytest.approx(1e-3)


def variable(causality: str, name: str, attributes: str) -> str:
    """A further variable of the tank of FMI 2.0, with the value of `heat`."""
    head = f'<ScalarVariable name="{name}" valueReference="2" causality="{causality}"'
    return f"{head}><Real {attributes}/></ScalarVariable>"


def test_fmu__input_without_a_start_value_begins_at_the_bound_nearest_to_zero(module_scratch: Path) -> None:
    bounds = {"above": 'min="10" max="20"', "below": 'max="-5"', "around": 'min="-5" max="20"', "free": ""}
    extra = "".join(variable("input", name, attributes) for name, attributes in bounds.items())
    plant = FmuPlant(str(build_tank(module_scratch, "startless.fmu", extra=extra)))
    assert [plant.actuators[name][3] for name in bounds] == [10.0, -5.0, 0.0, 0.0]


def test_fmu__input_with_one_possible_value_keeps_it_and_is_no_actuator(module_scratch: Path) -> None:
    extra = variable("input", "fixed", 'min="950" max="950"') + variable("output", "same", 'min="950" max="950"')
    plant = FmuPlant(str(build_tank(module_scratch, "one-value.fmu", extra=extra)))
    assert "fixed" not in plant.actuators
    assert plant.sensors["same"] == ("1", None, None)
    plant.reset(0)
    assert plant.step({"heat": 0.0})["power"] == 1000.0


@pytest.mark.parametrize(
    ("kind", "limits", "expected"),
    [
        ("UInt8", "", (0.0, 255.0)), ("Int8", "", (-128.0, 127.0)), ("Int16", 'max="9"', (-32768.0, 9.0)),
        ("Int32", 'min="-7"', (-7.0, 2147483647.0)), ("UInt64", "", (0.0, 2.0**53 - 1.0)),
        ("Int64", "", (-(2.0**53), 2.0**53 - 1.0)), ("Float32", "", (None, None)),
    ],
)  # fmt: skip
def test_fmu__whole_numbers_have_the_bounds_of_their_type(
    module_scratch: Path, kind: str, limits: str, expected: tuple[float | None, float | None]
) -> None:
    """FMI's functions would cut a number off that exceeds these."""
    extra = f'<{kind} name="n" valueReference="60" causality="input" variability="discrete" {limits} start="1"/>'
    path = build_tank(module_scratch, f"bounded-{kind}.fmu", 3, extra=extra)
    parameter = next(
        part for part in inputs(fmpy.read_model_description(str(path)), {}, PointNames()) if part.name == "n"
    )
    assert (parameter.low, parameter.high) == expected


def test_fmu__array_needs_a_start_for_each_element(module_scratch: Path) -> None:
    array = '<Float64 name="a" valueReference="60" causality="input" start="1 2"><Dimension start="3"/></Float64>'
    with pytest.raises(InvalidConfig, match="a: its start has 2 values; 3 expected"):
        FmuPlant(str(build_tank(module_scratch, "array.fmu", 3, extra=array)))


def test_fmu__model_exchange_steps_at_any_time(module_scratch: Path) -> None:
    """Half a second after half a century: no step is taken for rounding."""
    path = build_tank(module_scratch, "late.fmu", interfaces=("ModelExchange",))
    late, early = (
        FmuPlant(str(path), start_s=start_s, begin="2024-01-01T00:00", step_s=0.5, duration_s=60.0)
        for start_s in (1.7e9, 0.0)
    )
    late.reset(0), early.reset(0)
    command = {"heat": 3000.0, "deed": 0.0, "mode": 1.0}
    temperatures = [[plant.step(command)["T"] for _ in range(8)] for plant in (late, early)]
    assert len({*temperatures[0]}) == 8
    assert temperatures[0] == pytest.approx(temperatures[1], abs=1e-6)


def test_fmu__that_is_too_large_is_not_unpacked(tank: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model, "MAX_BYTES", 1000)
    with pytest.raises(InvalidConfig, match=r"would take [\d,]+ bytes unpacked; at most 1,000 are allowed"):
        FmuPlant(str(tank))


def test_fmu__tolerance_of_the_description_that_is_none_is_not_used(module_scratch: Path) -> None:
    path = build_tank(module_scratch, "tolerant.fmu", interfaces=("ModelExchange",))
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    changed = module_scratch / "intolerant.fmu"
    with zipfile.ZipFile(changed, "w") as archive:
        for name, content in parts.items():
            archive.writestr(name, re.sub(rb'tolerance="[^"]*"', b'tolerance="-1"', content))
    plant = FmuPlant(str(changed))
    assert "the tolerance of the model description, -1, is not above 0, and not used" in plant.warnings
    plant.reset(0)
    plant.step({"heat": 100.0, "deed": 0.0, "mode": 1.0})


# Settings


def test_fmu__start_values_of_parameters_and_inputs_are_set(tank: Path) -> None:
    plant = FmuPlant(str(tank), set={"body.loss[1,2]": 10.0, "heat": 950.0, "T": 30.0}, duration_s=1e7, step_s=5e4)
    assert plant.actuators["heat"] == ("W", 0.0, 3000.0, 950.0)
    assert plant.reset(0)["T"] == 30.0
    values = [plant.step({"heat": 950.0, "deed": 0.0, "mode": 1.0}) for _ in range(20)]
    assert values[-1]["T"] == pytest.approx(20.0 + 1000.0 / 10.0), "the steady state of its equation"


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"set": {"los": 1.0}}, "the FMU has no variable 'los'"),
        ({"set": {"heta": 1.0}}, "did you mean 'heat'"),
        ({"set": {"heat": 5000.0}}, "heat = 5000.0: out of bounds; at least 0 and at most 3000 expected"),
        ({"set": {"heat": "much"}}, "heat = 'much': a number expected"),
        ({"set": {"body.loss[1,2]": float("inf")}}, "= inf: a finite number expected"),
        ({"set": {"deed": float("nan")}}, "deed = nan: a finite number expected"),
        ({"set": ["heat"]}, r"set = \['heat'\]: values by name expected"),
        ({"set": "heat"}, "set = 'heat': values by name expected"),
        ({"set": {"mode": 1.5}}, "mode = 1.5: a whole number expected"),
        ({"set": {"deed": 3e9}}, "deed = 3000000000.0: out of bounds; at least 0 and at most 9 expected"),
        ({"set": {"power": 1.0}}, "power = 1.0: it is an output that the FMU calculates"),
        ({"set": {"heat": [1.0, 2.0]}}, "1 value expected"),
        ({"set": {"los": 1.0, "heat": -1.0}}, "los(?s:.*)heat = -1.0: out of bounds"),
        ({"observe": ["Q"]}, "observe: the FMU has no variable 'Q'"),
        ({"observe": ["heat"]}, "observe: 'heat' is an input; its value is the effective one of its actuator"),
        ({"observe": [1]}, r"observe = \[1\]: a list of names expected"),
        ({"observe": 1}, "observe = 1: a list of names expected"),
        ({"tolerance": "tight"}, "tolerance = 'tight': a number expected"),
        ({"tolerance": float("nan")}, "tolerance = nan: a finite number expected"),
        ({"tolerance": -1}, "tolerance = -1: a number above 0 expected"),
        ({"tolerance": 0.0}, "tolerance = 0.0: a number above 0 expected"),
        ({"step_s": 0.0}, "step_s = 0: a number of seconds above 0 expected"),
        ({"step_s": "soon"}, "step_s = 'soon': a number of seconds expected"),
        ({"interface": "ModelExchange"}, "has the interface CoSimulation, not ModelExchange"),
        ({"interface": "me"}, "interface 'me': CoSimulation or ModelExchange expected"),
    ],
)
def test_fmu__wrong_argument_is_named(tank: Path, arguments: dict[str, Any], text: str) -> None:
    with pytest.raises(InvalidConfig, match=text):
        FmuPlant(str(tank), **arguments)


def test_fmu__whole_number_may_be_written_as_another_number(tank: Path) -> None:
    for value in (7, 7.0, "7.0"):
        assert FmuPlant(str(tank), set={"deed": value}).actuators["deed"] == ("1", 0.0, 9.0, 7.0)


def test_fmu__without_a_step_size_states_which_one_it_gets(module_scratch: Path) -> None:
    plant = FmuPlant(str(build_tank(module_scratch, "stepless.fmu", step_s="")))
    assert plant.step_s == 10.0
    assert plant.warnings == ["the FMU names no step size; step_s = 10 (set another: --plant-argument step_s=60)"]
    assert FmuPlant(str(plant.files["fmu"]), step_s=7.0).duration_s == 5999.0, "rounded down to whole timesteps"


@pytest.mark.parametrize(("preferred", "step_s"), [("60", 60.0), ("", 10.0)])
def test_fmu__preferred_step_size_precedes_the_fixed_internal_one(
    module_scratch: Path, preferred: str, step_s: float
) -> None:
    fields = {"fixedInternalStepSize": "10"}
    path = build_tank(module_scratch, f"fixed{preferred}.fmu", 3, step_s=preferred, fields=fields)
    assert FmuPlant(str(path)).step_s == step_s


# What is refused, and what is stated once


CLOCK = (
    '<Clock name="tick" valueReference="50" causality="input" variability="discrete" intervalVariability="constant"/>'
)
TEXT = '<String name="label" valueReference="51" causality="output" variability="discrete"/>'


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"platform": "win64"}, "has binaries for win64; one for linux64 is needed"),
        ({"version": 3, "extra": CLOCK}, r"has input clocks \(tick\), which are not supported"),
        ({"version": 3, "interfaces": ("ModelExchange",)}, "model exchange of FMI 3.0 is not supported"),
        ({"version": 3, "interfaces": ("ScheduledExecution",)}, "has the interface ScheduledExecution, not Co"),
    ],
)
def test_fmu__what_cannot_be_simulated_is_refused_by_name(
    module_scratch: Path, options: dict[str, Any], text: str
) -> None:
    with pytest.raises(InvalidConfig, match=text):
        FmuPlant(str(build_tank(module_scratch, "refused.fmu", **options)))


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"step_s": "NaN"}, "stepSize of the model description = 'NaN': a finite number expected"),
        (
            {"step_s": "", "version": 3, "fields": {"fixedInternalStepSize": "x"}},
            "fixedInternalStepSize .* = 'x': a nu",
        ),
        ({"extra": variable("input", "x", 'min="abc"')}, "x: its min is 'abc'; a number expected"),
        ({"extra": variable("output", "x", 'max="abc"')}, "x: its max is 'abc'; a number expected"),
        ({"extra": variable("input", "x", 'start="abc"')}, "x: its start is 'abc'; a number expected"),
    ],
)
def test_fmu__value_of_the_model_description_that_is_not_a_number_is_named(
    module_scratch: Path, options: dict[str, Any], text: str
) -> None:
    with pytest.raises(InvalidConfig, match=text):
        FmuPlant(str(build_tank(module_scratch, "malformed.fmu", **options)))


def test_fmu__argument_replaces_a_step_size_that_is_not_a_number(module_scratch: Path) -> None:
    assert FmuPlant(str(build_tank(module_scratch, "malformed.fmu", step_s="NaN")), step_s=60.0).step_s == 60.0


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"files": {"terminalsAndIcons/terminalsAndIcons.xml": "<x/>"}}, "the FMU's terminals are not used"),
        ({"version": 3, "fields": {"providesIntermediateUpdate": "true"}}, "the FMU's intermediate update is not used"),
        ({"version": 3, "fields": {"hasEventMode": "true"}}, "the FMU's event mode is not used"),
        ({"version": 3, "extra": CLOCK.replace("input", "output")}, "the FMU's clocks are not used: tick"),
        ({"version": 3, "extra": TEXT}, "the FMU's texts and binary values are no points: label"),
        ({"extra": "<Wrong/>"}, "the FMU's model description is not valid"),
    ],
)
def test_fmu__what_is_not_used_is_stated_once(module_scratch: Path, options: dict[str, Any], text: str) -> None:
    plant = FmuPlant(str(build_tank(module_scratch, "noted.fmu", **options)))
    assert [warning for warning in plant.warnings if text in warning], plant.warnings


def test_fmu__threads_of_its_own_are_stated(tank: Path) -> None:
    plant = FmuPlant(str(tank), set={"threaded": True})
    assert plant.warnings == ["the FMU has threads of its own, so it has no snapshots, branches and trial steps"]


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"no zip", "it is not a ZIP file"),
        (None, r"there is no file .*/other\.fmu"),
        ("folder", "is a folder; expected an"),
    ],
)
def test_fmu__other_files_are_named(tmp_path: Path, content: bytes | str | None, text: str) -> None:
    path = tmp_path / "other.fmu"
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        path.mkdir()
    with pytest.raises(InvalidConfig, match=text):
        FmuPlant(str(path))


# Trajectories


def commands(steps: int) -> list[dict[str, float]]:
    """Return inputs by the FMU's names, which change every seven steps."""
    powers = np.random.default_rng(3).choice([0.0, 250.0, 1234.5], steps)
    rows = []
    for step in range(steps):
        active = 30 <= step < 60
        heat = float(powers[step - step % 7]) if step >= 7 else 0.0
        extra = {"extra_u": 300.0 if active else 100.0, "extra_activate": float(active)}
        rows.append({"heat": heat, **extra, "deed": 0.0, "mode": 1.0})
    return rows


def of_points(row: dict[str, float]) -> dict[str, float]:
    extra = {"extra": row["extra_u"]} if row["extra_activate"] else {}
    return {"heat": row["heat"], **extra, "deed": row["deed"], "mode": row["mode"]}


@pytest.mark.parametrize(("version", "interface"), [(2, "CoSimulation"), (3, "CoSimulation"), (2, "ModelExchange")])
def test_fmu__trajectory_is_that_of_simulate_fmu_to_the_bit(module_scratch: Path, version: int, interface: str) -> None:
    path = build_tank(module_scratch, f"{interface}{version}.fmu", version, interfaces=(interface,))
    plant, rows = FmuPlant(str(path)), commands(100)
    temperatures = [plant.reset(0)["T"], *(plant.step(of_points(row))["T"] for row in rows)]
    result = fmpy.simulate_fmu(
        str(path), stop_time=6000.0, output_interval=STEP_S, input=inputs_of(rows, STEP_S), output=["T"],
        record_events=False,
    )  # fmt: skip
    _, first = np.unique(result["time"], return_index=True)
    assert result["T"][first].tolist() == temperatures
    assert max(temperatures) > 25.0


def test_fmu__model_exchange_is_the_exact_solution_within_its_tolerance(module_scratch: Path) -> None:
    both = build_tank(module_scratch, "both.fmu", interfaces=("ModelExchange", "CoSimulation"))
    plants = [FmuPlant(str(both), interface=kind) for kind in ("ModelExchange", "CoSimulation")]
    for plant in plants:
        plant.reset(0)
    for row in commands(100):
        integrated, exact = (plant.step(of_points(row))["T"] for plant in plants)
        assert integrated == pytest.approx(exact, rel=1e-4)


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize(
    ("deed", "text"), [(3, r"failed after 60 s: fmi.DoStep failed"), (4, "ended the simulation at 60 s")]
)
def test_fmu__failure_is_named_with_its_time(module_scratch: Path, version: int, deed: int, text: str) -> None:
    plant = FmuPlant(str(build_tank(module_scratch, f"failing{version}.fmu", version)))
    plant.reset(0)
    plant.step({})
    with pytest.raises(PlantFailed, match=f"FMU Tank: it {text}"):
        plant.step({"deed": float(deed)})


def test_fmu__passes_the_check_of_plants(module_scratch: Path) -> None:
    path = build_tank(module_scratch, "checked.fmu", deeds=False)
    check_plant("zenostat.plants.fmi.plant:FmuPlant", {"file": str(path)})


@pytest.mark.slow
def test_fmu__those_of_other_tools_equal_simulate_fmu(module_scratch: Path) -> None:
    for path in download_fmus(module_scratch):
        plant = FmuPlant(str(path))
        steps = min(100, round(plant.duration_s / plant.step_s))
        defaults = {name: spec[3] for name, spec in plant.actuators.items()}
        rows = [plant.reset(0), *(plant.step(defaults) for _ in range(steps))]
        outputs = [v.name for v in plant._outputs]
        result = fmpy.simulate_fmu(
            str(path), stop_time=steps * plant.step_s, output_interval=plant.step_s, output=outputs
        )
        for variable in plant._outputs:
            expected = np.asarray(result[variable.name]).reshape(steps + 1, -1)
            assert np.array_equal(expected, [[row[point] for point in variable.points] for row in rows]), path.name
