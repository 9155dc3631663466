"""BOPTEST's points: names, SI units, bounds; stored samples."""

import numpy as np
import pytest

from zenostat.gateways.boptest.points import PointTable
from zenostat.gateways.boptest.simulation import row_range
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Actuator, Manifest, Meter, Mode, Policy, Sensor, Versions


def table(**fields):
    manifest = Manifest(
        node="a", instance="b", building="c", begin="2017-01-01T00:00:00", end="2017-01-02T00:00:00", step_s=900,
        steps=96, mode=Mode.LOCKSTEP, policy=Policy.WAIT, versions=Versions(zenostat="0"),
        **{"sensors": (), "meters": (), "actuators": (), **fields},
    )  # fmt: skip
    return PointTable(manifest), manifest.step_s


def test_boptest_points__values_are_converted_to_si_units_and_meters_to_mean_power():
    sensors = tuple(
        Sensor(name=name, unit=unit)
        for name, unit in (("t", "degC"), ("rh", "percent"), ("wind", "deg"), ("co2", "ppm"), ("dt", "delta_degC"))
    )
    points, step_s = table(sensors=sensors, meters=(Meter(name="gas", unit="J"),))
    assert [point.unit for point in points.measurements] == ["K", "1", "rad", "ppm", "K", "W"]
    values = points.si_values(np.array([20.0, 50.0, 180.0, 400.0, 2.0, 900.0]))
    assert values == pytest.approx([293.15, 0.5, np.pi, 400.0, 2.0, 900.0 / step_s])


def test_boptest_points__amounts_of_a_timestep_are_mean_rates():
    meters = (
        Meter(name="water", unit="m3", meter="Water:Facility"),
        Meter(name="heat", unit="kWh"),
        Meter(name="rain", unit="L"),
        Meter(name="cars", unit="count"),
    )
    gain = Sensor(name="gain", unit="J", variable="Zone Total Internal Total Heating Energy", aggregation="sum")
    points, step_s = table(sensors=(gain,), meters=meters)
    assert [(point.unit, point.description) for point in points.measurements] == [
        ("W", "Zone Total Internal Total Heating Energy (mean)"),
        ("m3/s", "Mean rate of Water:Facility in the last timestep"),
        ("W", "Mean power of heat in the last timestep"),
        ("m3/s", "Mean rate of rain in the last timestep"),
        ("1", "Total of cars in the last timestep"),
    ]
    values = points.si_values(np.array([step_s, 2.0 * step_s, 0.5, 3e3 * step_s, 7.0]))
    assert values == pytest.approx([1.0, 2.0, 0.5 * 3.6e6 / step_s, 3.0, 7.0])


def test_boptest_points__inputs_have_bounds_and_convert_back():
    bounded = Actuator(name="setpoint", unit="degC", low=15.0, high=30.0)
    points, _ = table(actuators=(bounded, Actuator(name="valve", unit="1")))
    assert [(p.name, p.minimum, p.maximum) for p in points.inputs] == [
        ("setpoint_u", 288.15, 303.15),
        ("valve_u", -1e9, 1e9),
    ]
    assert points.activates == ("setpoint_activate", "valve_activate")
    assert points.bus_input(0, 295.15) == pytest.approx(22.0)
    assert points.si_inputs(np.array([22.0, 1.0])) == pytest.approx([295.15, 1.0])


def test_boptest_points__rounded_bounds_are_those_of_the_actuator():
    points, _ = table(actuators=(Actuator(name="setpoint", unit="degC", low=22.6, high=29.9),))
    maximum, minimum = points.inputs[0].maximum, points.inputs[0].minimum
    assert maximum - 273.15 > 29.9
    assert points.bus_input(0, maximum) == 29.9
    assert points.bus_input(0, minimum) == pytest.approx(22.6)
    assert points.bus_input(0, minimum - 1e-9) == 22.6


def test_boptest_points__clients_that_replace_u_anywhere_in_a_name_reach_the_switch():
    name = "core_upper_zone_unit_setpoint"
    points, _ = table(actuators=(Actuator(name=name, unit="degC", low=15.0, high=30.0),))
    assert points.inputs[0].name.replace("_u", "_activate") == points.activates[0]
    assert points.inputs[0].name == "core_Upper_zone_Unit_setpoint_u"


def test_boptest_points__names_that_coincide_are_refused():
    with pytest.raises(InvalidConfig, match="differ only by case"):
        table(sensors=(Sensor(name="a_ub", unit="1"), Sensor(name="a_Ub", unit="1")))


def test_boptest_points__rows_are_those_of_a_closed_range_of_times():
    for start, final, rows in (
        (1000, 1600, (0, 3)),
        (1001, 1599, (1, 2)),
        (1001, 1299, (0, 0)),
        (-np.inf, np.inf, (0, 600)),
        (np.inf, np.inf, (0, 0)),
        (0, 999, (0, 0)),
        (1e9, 2e9, (0, 0)),
        (1600, 1000, (0, 0)),
    ):
        assert row_range(start, final, 1000, 300, 600) == rows, (start, final)
