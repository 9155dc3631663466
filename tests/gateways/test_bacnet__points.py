"""Objects of a BACnet device: instance numbers, names, units and bounds, without a network."""

import math
import struct
from types import SimpleNamespace

import pytest
from bacpypes3 import basetypes
from bacpypes3.errors import PropertyError
from bacpypes3.primitivedata import Real
from hypothesis import given
from hypothesis import strategies as st

from zenostat.gateways.bacnet import units
from zenostat.gateways.bacnet.fixed_objects import device_description
from zenostat.gateways.bacnet.point_objects import AnalogOutput, real
from zenostat.gateways.bacnet.points import point_specs
from zenostat.gateways.bacnet.services import NodeApplication
from zenostat.gateways.notices import Notices
from zenostat.gateways.single_precision import double
from zenostat.topics.device_addresses import MAX_INSTANCE, ObjectKind, instance_number, instance_numbers
from zenostat.topics.messages import Actuator, Manifest, Meter, Mode, Policy, Sensor, Versions


def manifest(**points: tuple) -> Manifest:
    return Manifest(
        **{"sensors": (), "meters": (), "actuators": (), **points},
        node="office",
        instance="1",
        building="b",
        begin="",
        end="",
        step_s=600.0,
        steps=1,
        mode=Mode.FREE,
        policy=Policy.WAIT,
        versions=Versions(zenostat="0"),
    )


def test_bacnet__description_of_a_device_has_the_weather_of_buildings_only() -> None:
    plant = manifest()
    assert device_description(plant) == "simulation of b"
    building = plant.model_copy(update={"weather": "USA_CO_Denver"})
    assert device_description(building) == "simulated building b with weather USA_CO_Denver"


@given(st.sets(st.text("abc_", min_size=1, max_size=8), max_size=40))
def test_bacnet__instance_numbers_are_distinct_valid_and_do_not_depend_on_order(names: set[str]) -> None:
    numbers = instance_numbers(names)
    assert numbers == instance_numbers(sorted(names, reverse=True))
    assert len(set(numbers.values())) == len(names)
    assert all(1000 <= number <= MAX_INSTANCE for number in numbers.values())


def test_bacnet__further_point_changes_no_other_number() -> None:
    names = [f"zone_{number}_air_temperature" for number in range(100)]
    before = instance_numbers(names)
    after = instance_numbers([*names, "a_new_sensor"])
    assert after.items() >= before.items()
    assert before["zone_7_air_temperature"] == instance_number("zone_7_air_temperature")


def test_bacnet__two_names_with_one_number_get_two() -> None:
    seen: dict[int, str] = {}
    first = second = ""
    for count in range(100_000):  # about 1,200 pairs are expected
        name = f"point_{count:06}"
        if (number := instance_number(name)) in seen:
            first, second = seen[number], name
            break
        seen[number] = name
    assert instance_numbers([second, first]) == {first: number, second: number + 1}


def test_bacnet__meter_is_its_mean_rate_and_a_unit_that_bacnet_lacks_is_in_the_description() -> None:
    specs = {
        spec.name: spec
        for spec in point_specs(
            manifest(
                sensors=(Sensor(name="infiltration", variable="Air Change Rate", key="Z", unit="ach"),),
                meters=(Meter(name="electricity", meter="Electricity:Facility", unit="J", low=0.0, high=6e8),),
            )
        )
    }
    meter = specs["electricity"]
    assert (meter.unit, meter.divisor, meter.low, meter.high) == ("W", 600.0, 0.0, 1e6)
    assert units.bacnet_unit(meter.unit).name == "watts"
    assert specs["infiltration"].description == "Air Change Rate, Z; unit: ach"


def test_bacnet__names_are_unique_also_where_the_bus_has_one_name_for_several_things() -> None:
    twice = {"unit": "degC", "name": "supply"}
    specs = point_specs(
        manifest(sensors=(Sensor(**twice), Sensor(name="office", unit="1")), actuators=(Actuator(**twice),))
    )
    assert [(spec.kind, spec.object_name) for spec in specs] == [
        (ObjectKind.INPUT, "supply"),
        (ObjectKind.INPUT, "office/input"),
        (ObjectKind.OUTPUT, "supply/output"),
    ]


async def test_bacnet__bound_that_a_client_has_read_can_be_written() -> None:
    low, high, written = -17.77777777777778, 29.444444444444443, []

    class State:
        async def write(self, *command: object) -> None:
            written.append(command)

    (spec,) = point_specs(manifest(actuators=(Actuator(name="a", unit="degC", low=low, high=high),)))
    output = AnalogOutput(State(), spec)
    for read in (output.minPresValue, output.maxPresValue):
        await output.command(Real(struct.unpack(">f", struct.pack(">f", read))[0]), 8)
    assert written == [("a", low, 8), ("a", high, 8)]
    for outside in (low - 1e-5, high + 1e-5, math.inf, math.nan):
        with pytest.raises(PropertyError, match=r"valueOutOfRange|value-out-of-range"):
            await output.command(Real(outside), 8)


def test_bacnet__each_unit_is_in_the_enumeration_of_the_standard() -> None:
    for unit, entry in units._UNITS.items():
        assert isinstance(getattr(basetypes.EngineeringUnits, entry.name), int), unit
    # Numbers of ASHRAE 135, clause 21.
    expected = {"degC": 62, "percent": 98, "W": 47, "J": 16, "kg/s": 42, "m3/s": 85, "Pa": 53, "ppm": 96, "1": 95}
    expected |= {"kW": 48, "MW": 49, "MWh": 146, "degF": 64, "kPa": 54, "bar": 55, "m3/h": 135, "var": 11, "kvar": 12}
    assert {unit: getattr(basetypes.EngineeringUnits, units.bacnet_unit(unit).name) for unit in expected} == expected


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_bacnet__number_in_single_precision_is_read_with_the_fewest_digits(value: float) -> None:
    shortest = double(value)
    assert struct.pack(">f", shortest) == struct.pack(">f", value)
    assert len(repr(shortest).strip("-0.")) <= len(repr(value).strip("-0."))


def test_bacnet__decimal_survives_the_way_through_single_precision() -> None:
    for text in ("21.1", "26.75", "0.35", "-17.8", "100000"):
        assert double(struct.unpack(">f", struct.pack(">f", float(text)))[0]) == float(text)
    assert (real(1e300), real(-1e300)) == (float("inf"), float("-inf"))


def test_bacnet__notification_that_fails_is_named_and_the_others_are_sent() -> None:
    class Criteria:
        cov_subscriptions = (1,)

        def __init__(self, name: str) -> None:
            self.obj = SimpleNamespace(objectName=name)

        def is_due(self) -> bool:
            return True

        def send_cov_notifications(self) -> None:
            if self.obj.objectName == "bad":
                raise ValueError("no such date")
            sent.append(self.obj.objectName)

    sent: list[str] = []
    notices: list[str] = []
    detections = {name: Criteria(name) for name in ("bad", "good")}
    application = SimpleNamespace(_cov_detections=detections, _rejections=Notices(notices.append))
    NodeApplication.notify_subscribers(application)
    assert (sent, notices) == (["good"], ["no notification of bad: ValueError: no such date"])
