"""Units of readings, as gateways for devices offer them."""

import pytest

from zenostat.gateways.points import Reading, readings
from zenostat.topics.messages import Aggregation, Manifest, Meter, Mode, Policy, Sensor, Versions
from zenostat.topics.units import conversion, power_kw, units_of


def read(point: Sensor | Meter, step_s: float) -> Reading:
    kind = {"meters" if isinstance(point, Meter) else "sensors": (point,)}
    manifest = Manifest(
        **{"sensors": (), "meters": (), "actuators": (), **kind},
        node="office",
        instance="1",
        building="b",
        begin="",
        end="",
        step_s=step_s,
        steps=1,
        mode=Mode.FREE,
        policy=Policy.WAIT,
        versions=Versions(zenostat="0"),
    )
    (reading,) = readings(manifest)
    return reading


@pytest.mark.parametrize(
    ("point", "unit", "divisor", "note"),
    [
        (Meter(name="x", unit="J"), "W", 600.0, "mean of the timestep"),
        (Meter(name="x", unit="m3"), "m3/s", 600.0, "mean of the timestep"),
        (Meter(name="x", unit="kWh"), "kW", 600.0 / 3600.0, "mean of the timestep"),
        (Meter(name="x", unit="GJ"), "MW", 0.6, "mean of the timestep"),
        (Meter(name="x", unit="count"), "count", 1.0, "total of the timestep"),  # no unit of its rate is on the bus
        (Sensor(name="x", unit="J", aggregation=Aggregation.SUM), "W", 600.0, "mean of the timestep"),
        (Sensor(name="x", unit="J", aggregation=Aggregation.INSTANT), "J", 1.0, ""),  # a stored energy has no rate
        (Sensor(name="x", unit="degC", aggregation=Aggregation.MEAN), "degC", 1.0, "mean of the timestep"),
        (Sensor(name="x", unit="MWh", aggregation=Aggregation.SUM), "MW", 600.0 / 3600.0, "mean of the timestep"),
    ],
)
def test_gateways__amounts_of_a_timestep_are_read_as_mean_rates(point, unit, divisor, note):
    reading = read(point, 600.0)
    assert (reading.unit, reading.divisor, reading.note) == (unit, divisor, note)


@pytest.mark.parametrize("unit", units_of("energy"))
def test_gateways__energy_of_a_timestep_is_read_as_mean_power(unit):
    reading = read(Meter(name="x", unit=unit), 900.0)
    factor, _ = conversion(reading.unit, "kW")
    assert factor / reading.divisor == pytest.approx(power_kw(unit, 900.0))
