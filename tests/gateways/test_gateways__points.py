"""Units of readings, as gateways for devices offer them."""

import pytest

from zenostat.gateways.points import readings
from zenostat.topics.messages import Aggregation, Manifest, Meter, Mode, Policy, Sensor, Versions


@pytest.mark.parametrize(
    ("point", "unit", "divisor", "note"),
    [
        (Meter(name="x", unit="J"), "W", 600.0, "mean of the timestep"),
        (Meter(name="x", unit="m3"), "m3/s", 600.0, "mean of the timestep"),
        (Meter(name="x", unit="kWh"), "kWh", 1.0, "total of the timestep"),  # no unit of its rate is on the bus
        (Sensor(name="x", unit="J", aggregation=Aggregation.SUM), "W", 600.0, "mean of the timestep"),
        (Sensor(name="x", unit="J", aggregation=Aggregation.INSTANT), "J", 1.0, ""),  # a stored energy has no rate
        (Sensor(name="x", unit="degC", aggregation=Aggregation.MEAN), "degC", 1.0, "mean of the timestep"),
        (Sensor(name="x", unit="kWh", aggregation=Aggregation.SUM), "kWh", 1.0, "total of the timestep"),
    ],
)
def test_gateways__amounts_of_a_timestep_are_read_as_mean_rates(point, unit, divisor, note):
    kind = {"meters" if isinstance(point, Meter) else "sensors": (point,)}
    manifest = Manifest(
        **{"sensors": (), "meters": (), "actuators": (), **kind},
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
    (reading,) = readings(manifest)
    assert (reading.unit, reading.divisor, reading.note) == (unit, divisor, note)
