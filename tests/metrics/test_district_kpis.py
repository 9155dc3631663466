"""The KPIs of districts, by hand."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.builders import manifest

from zenostat.metrics.district_kpis import DISTRICT_KPIS, DistrictPoints, district_kpis, points_of, relative
from zenostat.metrics.trajectory import Trajectory
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Aggregation, Sensor, Task

HOURS = 3600.0
POINTS = DistrictPoints(
    ["g.import"], ["g.export"], price="g.price", limits={"g.loading": 50.0, "g.line": 80.0}, generation=["g.pv"]
)
UNITS = {
    "g.import": "W",
    "g.export": "W",
    "g.price": "EUR/kWh",
    "g.loading": "percent",
    "g.line": "percent",
    "g.pv": "W",
}


def run(*rows: tuple[float, ...], step_s: float = HOURS, **changes: Any) -> Trajectory:
    """A run with these values of net power (kW), price, two loadings and PV (kW), from sample 0 on."""
    table = np.zeros((len(rows), len(UNITS)))
    for place, (net, price, loading, line, pv) in enumerate(rows):
        table[place] = (1e3 * max(net, 0.0), 1e3 * max(-net, 0.0), price, loading, line, 1e3 * pv)
    base = manifest(sensors=[Sensor(name=name, unit=unit) for name, unit in UNITS.items()], **changes)
    of = base.model_copy(update={"step_s": step_s, "steps": len(rows) - 1})
    count = len(rows)
    return Trajectory(
        manifest=of, step=np.arange(count), values=table, effective=np.zeros((count, 0)),
        source_index=np.zeros((count, 0), np.uint16), sources=("",), fault_free_values=table,
    )  # fmt: skip


def flat(*net_kw: float) -> Trajectory:
    return run((0.0, 0.0, 0.0, 0.0, 0.0), *((net, 0.0, 0.0, 0.0, 0.0) for net in net_kw))


def test_district_kpis__price_that_is_a_mean_is_that_of_its_own_timestep() -> None:
    """Two hours of 2 and 5 kW at 0.2 and 0.3 EUR/kWh, as a market clears them."""
    of = run((9.0, 0.1, 0.0, 0.0, 0.0), (2.0, 0.2, 0.0, 0.0, 0.0), (5.0, 0.3, 0.0, 0.0, 0.0))
    sensors = tuple(
        each.model_copy(update={"aggregation": Aggregation.MEAN}) if each.name == POINTS.price else each
        for each in of.manifest.sensors
    )
    market = replace(of, manifest=of.manifest.model_copy(update={"sensors": sensors}))
    assert district_kpis(market, POINTS)["cost_total"] == pytest.approx(2 * 0.2 + 5 * 0.3)


def test_district_kpis__by_hand() -> None:
    """Four hours of 2, 5, -1 and 3 kW at prices of 0.1, 0.2, 0.3 and 0.4 EUR/kWh."""
    kpis = district_kpis(
        run(
            (9.0, 0.1, 99.0, 99.0, 9.0),
            (2.0, 0.2, 20.0, 0.0, 0.0),
            (5.0, 0.3, 55.0, 0.0, 0.0),
            (-1.0, 0.4, 10.0, 88.0, 4.0),
            (3.0, 0.5, 30.0, 0.0, 0.0),
        ),
        POINTS,
        emissions_kg_kwh=0.5,
    )
    assert list(kpis) == list(DISTRICT_KPIS)
    assert kpis == pytest.approx({
        "electricity_consumption_total": 10.0,
        "zero_net_energy": 9.0,
        "cost_total": 2 * 0.1 + 5 * 0.2 + 3 * 0.4,
        "carbon_emissions_total": 5.0,
        "daily_peak_average": 5.0,
        "all_time_peak_average": 5.0,
        "ramping_average": 3.0 + 4.0,
        "daily_one_minus_load_factor_average": 1 - (9 / 4) / 5,
        "monthly_one_minus_load_factor_average": 1 - (9 / 4) / 5,
        "self_consumption": 1 - 1 / 4,
        "limit_exceeded_h": 2.0,
        "limit_excess": 1.1,
    })  # fmt: skip


def test_district_kpis__days_are_windows_of_24_hours_from_the_first_timestep() -> None:
    kpis = district_kpis(flat(*[1.0] * 23, 3.0, *[2.0] * 24, 6.0, 4.0), POINTS)
    assert kpis["daily_peak_average"] == pytest.approx((3.0 + 2.0 + 6.0) / 3)
    assert kpis["daily_one_minus_load_factor_average"] == pytest.approx((1 - 26 / 24 / 3 + 0.0 + 1 - 5 / 6) / 3)
    assert kpis["all_time_peak_average"] == 6.0


def test_district_kpis__powers_do_not_depend_on_the_timestep() -> None:
    hourly, quarterly = flat(2.0, 5.0), run(*((n, 0.0, 0.0, 0.0, 0.0) for n in (0, *[2] * 4, *[5] * 4)), step_s=900.0)
    assert district_kpis(quarterly, POINTS) == pytest.approx(district_kpis(hourly, POINTS))


def test_district_kpis__what_is_not_known_is_none() -> None:
    kpis = district_kpis(flat(1.0, -2.0), DistrictPoints(["g.import"]))
    unknown = {name for name, value in kpis.items() if value is None}
    assert unknown == {
        "cost_total", "carbon_emissions_total", "self_consumption", "limit_exceeded_h", "limit_excess"
    }  # fmt: skip
    assert district_kpis(flat(-1.0, -2.0), POINTS)["daily_one_minus_load_factor_average"] is None


def test_district_kpis__without_a_value_of_a_step_are_none() -> None:
    complete = run((0.0, 0.1, 0.0, 0.0, 1.0), (2.0, 0.1, 60.0, 0.0, 1.0), (3.0, 0.1, 40.0, 0.0, 1.0))
    unknown = dict[str, set[str]]()
    for point in ("g.import", "g.price", "g.loading"):
        values = complete.values.copy()
        values[1, list(UNITS).index(point)] = np.nan
        kpis = district_kpis(replace(complete, values=values, fault_free_values=values), POINTS, emissions_kg_kwh=0.4)
        unknown[point] = {name for name, value in kpis.items() if value is None}
    of_limits = {"limit_exceeded_h", "limit_excess"}
    assert unknown["g.import"] == {*DISTRICT_KPIS} - of_limits - {"self_consumption"}
    assert unknown["g.price"] == {"cost_total"}
    assert unknown["g.loading"] == of_limits


def test_relative__is_the_ratio_to_the_baseline() -> None:
    ratios = relative({"a": 3.0, "b": 0.0, "c": 1.0, "d": None}, {"a": 4.0, "b": 0.0, "c": 0.0, "d": 1.0})
    assert ratios == {"a": 0.75, "b": 1.0, "c": None, "d": None}


def test_points_of__are_those_of_the_reward() -> None:
    reward = {"kind": "district", "consumption": "g.import", "limits": [{"point": "g.line", "high": 80.0}]}
    points = points_of(run((0.0,) * 5, task=Task(reward=reward)).manifest, ["g.pv"])
    assert points == DistrictPoints(("g.import",), (), None, {"g.line": 80.0}, ["g.pv"])
    with pytest.raises(InvalidConfig, match="no reward of the kind district"):
        district_kpis(flat(1.0))
    with pytest.raises(InvalidConfig, match=r"no point 'g.prise'; did you mean 'g.price'"):
        district_kpis(flat(1.0), DistrictPoints(["g.import"], price="g.prise"))


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"consumption": []}, "consumption: at least one point expected"),
        ({"consumption": "g.import"}, "consumption = 'g.import': a list of points expected"),
        (
            {"consumption": ["g.import"], "limits": {"g.line": 0.0}},
            r"limits\['g.line'\] = 0.0: a finite number above 0",
        ),
        ({"consumption": ["g.import"], "limits": {"g.line": -1}}, "= -1: a finite number above 0"),
        ({"consumption": ["g.import"], "limits": {"g.line": float("nan")}}, "= nan: a finite number above 0"),
    ],
)
def test_district_points__wrong_ones_are_named(fields: dict[str, Any], text: str) -> None:
    with pytest.raises(InvalidConfig, match=text):
        DistrictPoints(**fields)
