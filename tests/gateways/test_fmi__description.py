"""Model description of a node's FMU, as FMPy reads and validates it."""

from pathlib import Path
from typing import Any

import pytest

from zenostat.gateways.fmi.description import Interface
from zenostat.gateways.fmi.gateway import FmiGateway
from zenostat.topics.messages import Actuator, Aggregation, Manifest, Meter, Mode, Policy, Sensor, Versions
from zenostat.topics.units import conversion, quantity, units_of

fmpy = pytest.importorskip("fmpy")


def manifest(**fields: Any) -> Manifest:
    points = {
        "sensors": (
            Sensor(name="zone.T", unit="degC", variable="Zone Mean Air Temperature", key="ZONE <1>"),
            Sensor(name="flow", unit="m3/h"),
            Sensor(name="sun", unit="J", aggregation=Aggregation.SUM),
        ),
        "meters": (
            Meter(name="electricity", unit="J", meter="Electricity:Facility"),
            Meter(name="heat", unit="kWh"),
            Meter(name="cars", unit="count"),
        ),
        "actuators": (
            Actuator(name="setpoint", unit="degC", low=15.0, high=22.5, default=26.7),
            Actuator(name="valve", unit="1", low=0.0, high=1.0),
            Actuator(name="power", unit="W"),
        ),
    }
    return Manifest(
        **points
        | {
            "node": "2nd-office.east",
            "instance": "1",
            "building": 'the "old" mill & co',
            "begin": "2017-07-03T00:00:00",
            "end": "2017-07-04T00:00:00",
            "step_s": 900.0,
            "steps": 96,
            "mode": Mode.LOCKSTEP,
            "policy": Policy.WAIT,
            "versions": Versions(zenostat="1.2.3"),
        }
        | fields
    )


def read(folder: Path, described: Manifest) -> Any:
    (folder / "modelDescription.xml").write_bytes(Interface(described).model_description("127.0.0.1:4880"))
    return fmpy.read_model_description(str(folder / "modelDescription.xml"), validate=True)


def test_fmu__points_are_outputs_and_pairs_of_inputs(tmp_path: Path) -> None:
    read_back = read(tmp_path, manifest())
    variables = {variable.name: variable for variable in read_back.modelVariables}
    outputs = {name: variable.unit for name, variable in variables.items() if variable.causality == "output"}
    assert outputs == {"zone.T": "degC", "flow": "m3/h", "sun": "W", "electricity": "W", "heat": "kW", "cars": "count"}
    inputs = [name for name, variable in variables.items() if variable.causality == "input"]
    assert inputs == [f"{name}_{part}" for part in ("u", "activate") for name in ("setpoint", "valve", "power")]
    setpoint, power = variables["setpoint_u"], variables["power_u"]
    assert (setpoint.min, setpoint.max, setpoint.start) == ("15.0", "22.5", "22.5")  # 26.7 is beyond its bounds
    assert (power.min, power.max, power.start) == (None, None, "0.0")
    assert {variables[f"{name}_activate"].start for name in ("setpoint", "valve", "power")} == {"false"}
    assert variables["zone.T"].description == "ZONE <1>, Zone Mean Air Temperature"
    assert variables["electricity"].description == "Electricity:Facility; mean of the communication step"
    assert variables["heat"].description == "mean of the communication step"
    assert variables["cars"].description == "total of the communication step"


def test_fmu__outputs_with_names_of_inputs_or_parameters_are_numbered(tmp_path: Path) -> None:
    names = ("seed", "address", "a_u", "a_u_2", "a_activate", "a")
    sensors, actuators = tuple(Sensor(name=name, unit="W") for name in names), (Actuator(name="a", unit="W"),)
    read_back = read(tmp_path, manifest(sensors=sensors, meters=(), actuators=actuators))
    outputs = [variable.name for variable in read_back.modelVariables if variable.causality == "output"]
    assert outputs == ["seed_2", "address_2", "a_u_3", "a_u_2", "a_activate_2", "a"]


def test_fmu__references_are_unique_and_outputs_are_the_initial_unknowns(tmp_path: Path) -> None:
    read_back = read(tmp_path, manifest())
    reals = [variable.valueReference for variable in read_back.modelVariables if variable.type == "Real"]
    assert reals == list(range(9))
    names = ["zone.T", "flow", "sun", "electricity", "heat", "cars"]
    assert [unknown.variable.name for unknown in read_back.outputs] == names
    assert [unknown.variable.name for unknown in read_back.initialUnknowns] == names


def test_fmu__times_units_and_identifier_are_those_of_the_node(tmp_path: Path) -> None:
    read_back = read(tmp_path, manifest())
    times = read_back.defaultExperiment
    assert (float(times.startTime), float(times.stopTime), float(times.stepSize)) == (0.0, 86400.0, 900.0)
    assert read_back.coSimulation.modelIdentifier == "_2nd_office_east"
    celsius = next(unit for unit in read_back.unitDefinitions if unit.name == "degC").baseUnit
    assert (celsius.K, celsius.offset) == (1, 273.15)


QUANTITIES = ("K", "deltaC", "W", "J", "var", "VA", "V", "A", "kg/s", "m3/s", "Pa", "s", "1")
"""A unit of each quantity that has several."""

BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
"""Base units of FMI 2.0, section 2.2.2."""


@pytest.mark.parametrize(
    ("value", "unit", "in_si", "exponents"),
    [
        (212.0, "degF", 373.15, {"K": 1}),
        (26.85, "degC", 300.0, {"K": 1}),
        (18.0, "delta_degF", 10.0, {"K": 1}),
        (2.5, "kW", 2500.0, {"kg": 1, "m": 2, "s": -3}),
        (2.0, "kWh", 7.2e6, {"kg": 1, "m": 2, "s": -2}),
        (36.0, "m3/h", 0.01, {"m": 3, "s": -1}),
        (60.0, "L/min", 1e-3, {"m": 3, "s": -1}),
        (1.0, "bar", 1e5, {"kg": 1, "m": -1, "s": -2}),
        (0.4, "kV", 400.0, {"kg": 1, "m": 2, "s": -3, "A": -1}),
        (1.5, "hr", 5400.0, {"s": 1}),
        (180.0, "deg", 3.141592653589793, {"rad": 1}),
        (50.0, "percent", 0.5, {}),
        (0.5, "fraction", 0.5, {}),
    ],
)
def test_fmu__units_convert_to_si(
    tmp_path: Path, value: float, unit: str, in_si: float, exponents: dict[str, int]
) -> None:
    sensors = (Sensor(name="point", unit=unit),)
    (described,) = read(tmp_path, manifest(sensors=sensors, meters=(), actuators=())).unitDefinitions
    base = described.baseUnit
    assert {name: power for name in BASE if (power := getattr(base, name))} == exponents
    assert base.factor * value + base.offset == pytest.approx(in_si, rel=1e-12)


def test_fmu__units_of_a_quantity_convert_as_on_the_bus(tmp_path: Path) -> None:
    names = [name for kind in {quantity(unit) for unit in QUANTITIES} for name in units_of(kind)]
    sensors = tuple(Sensor(name=f"point_{number}", unit=unit) for number, unit in enumerate(names))
    described = read(tmp_path, manifest(sensors=sensors, meters=(), actuators=())).unitDefinitions
    bases = {unit.name: unit.baseUnit for unit in described}
    assert set(bases) == set(names)
    for source in names:
        for target in units_of(quantity(source)):
            factor, offset = conversion(source, target) or (0.0, 0.0)
            in_target = (bases[source].factor * 7.0 + bases[source].offset - bases[target].offset) / bases[
                target
            ].factor
            assert in_target == pytest.approx(factor * 7.0 + offset, rel=1e-12, abs=1e-12), (source, target)


def test_fmu__name_that_is_no_known_unit_is_opaque(tmp_path: Path) -> None:
    sensors = (Sensor(name="point", unit="furlong"),)
    (described,) = read(tmp_path, manifest(sensors=sensors, meters=(), actuators=())).unitDefinitions
    assert (described.name, described.baseUnit) == ("furlong", None)


def test_fmu__node_without_points_is_described(tmp_path: Path) -> None:
    empty = {"sensors": (), "meters": (), "actuators": ()}
    assert [variable.name for variable in read(tmp_path, manifest(**empty)).modelVariables] == ["address", "seed"]
    assert "#define LOW_VALUES {0.0}\n" in Interface(manifest(**empty)).header("a:1")


def test_fmu__guid_stands_for_points_and_timesteps() -> None:
    guid = Interface(manifest()).guid
    assert Interface(manifest(node="other", weather="there")).guid == guid
    assert Interface(manifest(step_s=600.0)).guid != guid
    assert Interface(manifest(meters=())).guid != guid
    assert Interface(manifest(actuators=(Actuator(name="setpoint", unit="degC", low=16.0, high=22.5),))).guid != guid


def test_fmu__bounds_of_inputs_are_in_the_binary() -> None:
    header = Interface(manifest()).header('h"\\ost:1')
    assert "#define LOW_VALUES {15.0, 0.0, -INFINITY}\n" in header
    assert "#define HIGH_VALUES {22.5, 1.0, INFINITY}\n" in header
    assert '#define START_ADDRESS "h\\"\\\\ost:1"\n' in header


def test_fmi_gateway__address_in_use_is_named() -> None:
    from zenostat.topics.errors import AddressInUse

    with FmiGateway(None, "office", "127.0.0.1", 0) as gateway:  # type: ignore[arg-type]
        port = int(gateway.address.rpartition(":")[2])
        with pytest.raises(AddressInUse, match=f"127.0.0.1:{port}"):
            FmiGateway(None, "office", "127.0.0.1", port)  # type: ignore[arg-type]
