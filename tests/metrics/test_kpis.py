"""BOPTEST's KPIs: by hand, by properties, and on the meters of a real building."""

import json
import math
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.box_model import box_model
from support.builders import manifest, meter, sensor, view
from support.examples import examples
from support.nodes import SMALL

from zenostat.agent_sdk.testing import FakeBuilding, FakeLink
from zenostat.lab.evaluate import evaluate
from zenostat.metrics.energy_meters import WITH_PLANT, WITHOUT_PLANT, hvac_sources
from zenostat.metrics.episode_metrics import EpisodeMetrics, MetricsAccumulator
from zenostat.metrics.fuel_rates import read_emissions, read_prices
from zenostat.metrics.kpis import CO2_LIMIT_PPM, KPIS, PeakPower
from zenostat.metrics.roles import roles
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Aggregation, Manifest, Sensor, Task

KWH = 3.6e6
BEGIN = datetime(2017, 7, 3)
BAND = {"kind": "linear", "temperatures": ["core", "south"], "power": ["power"]}
SENSORS = (
    sensor("core"),
    sensor("south"),
    sensor("power", "Facility Total HVAC Electricity Demand Rate", "Whole Building", "W"),
)
METERS = (
    meter("heating_gas", "HVAC:NaturalGas"),
    meter("cooling", "HVAC:Electricity"),
    meter("lights", "InteriorLights:Electricity"),
    meter("all_gas", "NaturalGas:Facility"),
    meter("district", "HVAC:DistrictHeatingWater"),
)
FACILITY = (meter("e"), meter("g", "NaturalGas:Facility"))
GROUPS = (meter("group", "Electricity:HVAC"), meter("gas_group", "NaturalGas:HVAC"))


def office(*, step_s: float = 900.0, area_m2: float | None = 100.0, **update: Any) -> Manifest:
    """Two zones, of July, with meters of end uses."""
    of = manifest(sensors=SENSORS, meters=METERS, task=Task(reward=BAND))
    return of.model_copy(update={"step_s": step_s, "floor_area_m2": area_m2, **update})


def accumulated(of: Manifest, rows: list[dict[str, float]], **rates: Any) -> EpisodeMetrics:
    """Samples that end a timestep each after the first; what a row lacks is 24 (degC) or 0."""
    metrics = MetricsAccumulator(of, None, **rates)
    for step, row in enumerate(rows):
        at = BEGIN + timedelta(seconds=step * of.step_s)
        idle = {point.name: 24.0 if point.unit == "degC" else 0.0 for point in of.points}
        metrics.add(view(of, at, step=step, **{**idle, **row}))
    return metrics.result()


def kpi(metrics: EpisodeMetrics, name: str) -> float:
    value = metrics.kpis[name]
    assert value is not None
    return value


def test_kpis__three_timesteps_by_hand() -> None:
    # The band of July is 23 to 26 degC. Timesteps of a quarter of an hour on 100 m2.
    metrics = accumulated(
        office(),
        [
            {"core": 27.0, "south": 24.0},  # 1 K at the beginning
            {"core": 29, "south": 22, "heating_gas": 2 * KWH, "cooling": 1.5 * KWH, "lights": 9 * KWH},
            {"core": 25, "south": 21, "heating_gas": 0, "cooling": 4 * KWH, "all_gas": 9 * KWH},
            {"core": 26.0, "south": 23.0, "cooling": 0.5 * KWH, "district": 2 * KWH},
        ],
        prices={"electricity": 0.3, "gas": 0.1, "district_heating": 0.2},
        emissions={"electricity": 0.4, "natural_gas": 0.2, "district_heating_water": 0.1},
    )  # fmt: skip
    # Trapezoids of the deviations, core 1, 3, 0, 0 K and south 0, 1, 2, 0 K, in K times a quarter of an hour.
    core, south = (1 + 3) / 2 + (3 + 0) / 2 + 0, (0 + 1) / 2 + (1 + 2) / 2 + (2 + 0) / 2
    assert kpi(metrics, "tdis_tot") == pytest.approx((core + south) * 0.25 / 2)
    electricity, gas, heat = 1.5 + 4 + 0.5, 2.0, 2.0  # neither lights nor the kitchen's gas
    assert kpi(metrics, "ener_tot") == pytest.approx((electricity + gas + heat) / 100)
    assert kpi(metrics, "cost_tot") == pytest.approx((0.3 * electricity + 0.1 * gas + 0.2 * heat) / 100)
    assert kpi(metrics, "emis_tot") == pytest.approx((0.4 * electricity + 0.2 * gas + 0.1 * heat) / 100)
    assert kpi(metrics, "pele_tot") == pytest.approx(4 * 4 / 100)  # 4 kWh in a quarter of an hour
    assert kpi(metrics, "pgas_tot") == pytest.approx(2 * 4 / 100)
    assert kpi(metrics, "pdih_tot") == pytest.approx(2 * 4 / 100)
    assert kpi(metrics, "idis_tot") == 0.0
    assert metrics.metrics()["kpi.ener_tot"] == kpi(metrics, "ener_tot")
    assert [name for name in metrics.metrics() if name.startswith("kpi.")] == [f"kpi.{name}" for name in KPIS]


def test_kpis__what_is_unknown_is_none() -> None:
    row = {"cooling": KWH}
    for rows in ([row], []):  # not a single timestep
        metrics = accumulated(office(), rows).metrics()
        assert {metrics[f"kpi.{name}"] for name in KPIS} == {None}
    assert {k: v for k, v in accumulated(office(), [row, row]).kpis.items() if v is None} == dict.fromkeys(
        ("cost_tot", "emis_tot")
    )
    without_area = accumulated(office(area_m2=None), [row, row], prices={"electricity": 1.0})
    assert {k for k, v in without_area.kpis.items() if v is not None} == {"tdis_tot", "idis_tot"}
    no_reward = accumulated(office(task=Task()), [row, row])
    assert no_reward.kpis["tdis_tot"] is None
    empty = accumulated(office(meters=(), sensors=SENSORS[:2]), [{}, {}])
    assert {k for k, v in empty.kpis.items() if v is not None} == {"tdis_tot", "idis_tot"}
    electric = accumulated(office(meters=METERS[1:3]), [row, row])
    assert (electric.kpis["pgas_tot"], electric.kpis["pdih_tot"]) == (None, None)


def test_kpis__cost_without_a_price_for_a_fuel_in_use_is_unknown() -> None:
    only_electricity: dict[str, Any] = {"prices": {"electricity": 0.3}}
    idle, heated = {"cooling": KWH}, {"heating_gas": KWH}
    assert kpi(accumulated(office(), [idle, idle], **only_electricity), "cost_tot") == pytest.approx(0.003)
    assert accumulated(office(), [idle, heated, idle], **only_electricity).kpis["cost_tot"] is None
    text = MetricsAccumulator(office(), None, **only_electricity).sources["kpi.cost_tot"]
    assert text.endswith("unknown if natural_gas, district_heating_water is used, for which no price was given")


def test_kpis__price_is_that_of_the_hour_in_which_a_timestep_begins() -> None:
    table = {"table": [{"value": 300.0, "hours": [1, 2]}], "otherwise": 100.0, "unit": "EUR/MWh"}
    metrics = accumulated(office(), [{"cooling": KWH}] * 10, prices={"electricity": table})  # 0:00 to 2:15
    assert kpi(metrics, "cost_tot") == pytest.approx((4 * 0.1 + 4 * 0.3 + 1 * 0.1) / 100)


def test_kpis__means_over_the_timestep_are_not_averaged_again() -> None:
    mean = {"aggregation": Aggregation.MEAN}
    of = office(sensors=(SENSORS[0].model_copy(update=mean), *SENSORS[1:]))
    metrics = accumulated(of, [{"core": 30.0}, {"core": 28.0}, {"core": 27.0}])
    assert kpi(metrics, "tdis_tot") == pytest.approx((2 + 1) * 0.25 / 2)


def test_kpis__excess_of_carbon_dioxide_counts_for_all_zones_with_a_sensor() -> None:
    sensors = (*SENSORS, *(sensor(f"co2_{n}", "Zone Air CO2 Concentration", n, "ppm") for n in ("core", "south")))
    metrics = accumulated(
        office(sensors=sensors), [{}, {"co2_core": CO2_LIMIT_PPM + 100, "co2_south": CO2_LIMIT_PPM}, {}]
    )
    assert kpi(metrics, "idis_tot") == pytest.approx((100 / 2 + 100 / 2) * 0.25 / 2)


def test_kpis__season_of_an_interval_holds_at_both_of_its_ends() -> None:
    of = office()
    metrics = MetricsAccumulator(of)
    for step in range(2):  # the last quarter of an hour of September: 23 to 26 degC, and not 20 to 23.5
        metrics.add(view(of, datetime(2017, 9, 30, 23, 45) + step * of.timestep, step=step, core=22.0, south=24.0))
    assert metrics.result().kpis["tdis_tot"] == pytest.approx(0.25 / 2)


# Energy


@pytest.mark.parametrize(
    ("meters", "sensors", "electricity", "gas"),
    [
        (METERS, SENSORS, "meter HVAC:Electricity", "meter HVAC:NaturalGas"),
        ((*GROUPS, *METERS), SENSORS, "meter HVAC:Electricity", "meter HVAC:NaturalGas"),
        (GROUPS, SENSORS, f"meter Electricity:HVAC, {WITHOUT_PLANT}", f"meter NaturalGas:HVAC, {WITHOUT_PLANT}"),
        ((), SENSORS, f"sensor power, W times the timestep, read at its end (an approximation), {WITH_PLANT}", None),
        (FACILITY, SENSORS[:2], None, None),
        ((meter("cooling", "Cooling:Electricity"),), SENSORS[:2], None, None),
    ],
)  # fmt: skip
def test_kpis__best_points_are_used_and_named(
    meters: Any, sensors: Any, electricity: str | None, gas: str | None
) -> None:
    sources = {fuel: source.source for fuel, source in hvac_sources(office(meters=meters, sensors=sensors)).items()}
    assert (sources.get("electricity"), sources.get("natural_gas")) == (electricity, gas)


def test_hvac_sources__a_mean_demand_rate_is_preferred_to_a_state() -> None:
    power = SENSORS[2].model_copy(update={"name": "mean", "aggregation": Aggregation.MEAN})
    source = hvac_sources(office(meters=(meter("e"),), sensors=(SENSORS[2], power)))["electricity"]
    assert (source.index, source.source) == (1, f"sensor mean, W times the timestep, {WITH_PLANT}")
    assert source.to_kwh * 4000.0 == pytest.approx(1.0)  # a quarter of an hour


def test_kpis__gas_of_the_whole_building_is_not_hvac_gas() -> None:
    """A kitchen burns gas too: where only the building's gas is measured, what the HVAC used of it is unknown."""
    of = office(meters=(METERS[1], FACILITY[1]))
    rows = [{}, {"cooling": KWH, "g": 5 * KWH}]
    rates = {"prices": {"electricity": 0.3, "gas": 0.1}, "emissions": {"electricity": 0.4, "gas": 0.2}}
    kpis = accumulated(of, rows, **rates).kpis
    assert [kpis[name] for name in ("ener_tot", "cost_tot", "emis_tot", "pgas_tot")] == [None] * 4
    assert kpis["pele_tot"] == pytest.approx(4 / 100)
    assert "natural_gas" in MetricsAccumulator(of).sources["kpi.ener_tot"]
    without_gas = accumulated(of, [{}, {"cooling": KWH}], **rates).kpis  # the building burned none
    assert (without_gas["ener_tot"], without_gas["pgas_tot"]) == (pytest.approx(1 / 100), 0.0)


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("electricity", "W"), ("electricity_power", "kW"), ("electricity_facility_power", "W"), ("power", "W"),
        ("heater_electric_power", "W"), ("hvac_electricity_power", "kW"), ("electricity_hvac", "W"),
    ],
)  # fmt: skip
def test_metrics__plant_that_measures_only_a_power_has_an_energy_and_a_peak(name: str, unit: str) -> None:
    of = manifest(sensors=[Sensor(name="temperature", unit="degC"), Sensor(name=name, unit=unit)])
    kw = {"W": 1000.0, "kW": 1.0}[unit]
    metrics = accumulated(of, [{name: power * kw} for power in (9.0, 1.0, 2.0, 1.0)])  # quarters of an hour
    is_hvac = "hvac" in name
    (energies, without), shown = (metrics.energy_kwh, metrics.hvac_kwh), roles(of)
    if is_hvac:
        energies, without = without, energies
    assert (energies, without) == ({"electricity": pytest.approx(1.0)}, {})
    assert (metrics.mean_power_w, metrics.peak_kw) == (pytest.approx(4000.0 / 3.0), pytest.approx(2.0))
    source = shown.hvac_power if is_hvac else shown.facility_power
    assert source is not None
    assert (source.index, source.to_kw, source.label) == (1, 1.0 / kw, "HVAC" if is_hvac else "Whole building")
    assert (shown.hvac_power is None, shown.facility_power is None) == (not is_hvac, is_hvac)


def test_kpis__a_plant_that_is_no_building_counts_whole() -> None:
    own = tuple(meter(name).model_copy(update={"meter": ""}) for name in ("electricity", "natural_gas"))
    metrics = accumulated(office(meters=own, sensors=SENSORS[:2]), [{}, {"electricity": KWH, "natural_gas": 5 * KWH}])
    assert kpi(metrics, "ener_tot") == pytest.approx(6 / 100)
    assert metrics.hvac_kwh == {}


# Peaks


def resampled(durations_s: list[float], kw: list[float], begin_s: float) -> float:
    """The highest mean of the bins of 15 minutes of a power that is sampled each second, as BOPTEST resamples."""
    each = np.repeat(kw, [int(duration) for duration in durations_s])
    bins = (begin_s + np.arange(len(each))) // 900
    return max(float(each[bins == number].mean()) for number in np.unique(bins))


@settings(max_examples=examples(200), deadline=None)
@given(
    step_s=st.sampled_from([60, 180, 300, 600, 720, 900, 1200, 1800, 3600, 5000]),
    kw=st.lists(st.floats(0.0, 100.0), min_size=1, max_size=20),
    begin_min=st.integers(0, 40),
)
def test_kpis__peak_is_the_highest_mean_of_a_quarter_of_an_hour(step_s: int, kw: list[float], begin_min: int) -> None:
    begin_s, peak = 60.0 * begin_min, PeakPower(2)
    for number, power in enumerate(kw):
        peak.add(begin_s + number * step_s, begin_s + (number + 1) * step_s, np.array([power, -power]))
    expected = resampled([step_s] * len(kw), kw, begin_s)
    assert peak.result()[0] == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_kpis__timestep_of_ten_minutes_is_split_between_bins() -> None:
    of = office(step_s=600.0)
    metrics = accumulated(of, [{}, {"cooling": 1 * KWH}, {"cooling": 3 * KWH}, {"cooling": 0.0}])
    # 6 kW and 18 kW: ten minutes of the first and five of the second; then five of the second and ten of nothing.
    assert kpi(metrics, "pele_tot") == pytest.approx(max((10 * 6 + 5 * 18) / 15, 5 * 18 / 15) / 100)


# Rates


def test_kpis__forms_of_a_rate(tmp_path: Path) -> None:
    hours = [0.1 + 0.01 * (hour % 24) for hour in range(8760)]
    plain, dated, described = tmp_path / "plain.csv", tmp_path / "dated.csv", tmp_path / "tariff.yaml"
    plain.write_text("\n".join(map(str, hours)))
    dated.write_text("hour,price\n" + "\n".join(f"{hour},{price}" for hour, price in enumerate(hours)))
    described.write_text("csv: dated.csv\ncolumn: price\nunit: EUR/kWh\n")
    (tmp_path / "comma.csv").write_text("\n".join(f"{price:.2f}".replace(".", ",") for price in hours))
    comma = tmp_path / "comma.yaml"
    comma.write_text("csv: comma.csv\ncolumn: 1\nheader_row: 0\ndelimiter: ;\ndecimal: ','\n")
    numbered = tmp_path / "numbered.csv"
    numbered.write_text("\n".join(f"{hour},{price}" for hour, price in enumerate(hours)))
    forms = {
        "fuel_oil_1": comma, "fuel_oil_2": numbered,
        "other_fuel_1": np.array(hours), "other_fuel_2": np.float64(0.25),
        "electricity": plain, "gas": str(dated), "propane": hours, "coal": described, "diesel": 0.25,
        "gasoline": {"value": 250.0, "unit": "EUR/MWh"},
    }  # fmt: skip
    rates = read_prices(forms)
    at = datetime(2017, 7, 3, 7, 45)
    assert [rates[fuel].at(at) for fuel in ("electricity", "natural_gas", "propane", "coal")] == pytest.approx(
        [0.17] * 4
    )
    assert [rates[fuel].at(at) for fuel in ("fuel_oil_1", "fuel_oil_2", "other_fuel_1")] == pytest.approx([0.17] * 3)
    assert rates["other_fuel_2"].at(at) == 0.25
    assert rates["diesel"].at(at) == rates["gasoline"].at(at) == pytest.approx(0.25)
    assert read_prices(rates) == rates
    assert read_emissions({"gas": {"value": 200.0, "unit": "g/kWh"}})["natural_gas"].at(at) == pytest.approx(0.2)
    assert read_prices({"electricity": -0.01})["electricity"].at(at) == -0.01  # as on power exchanges


@pytest.mark.parametrize(
    ("rates", "text"),
    [
        ({"electricty": 0.3}, "no fuel 'electricty'.*'electricity'"),
        ({"gas": 0.1, "natural_gas": 0.2}, "natural_gas is given twice"),
        ({"gas": math.nan}, "gas: a finite number expected, got nan"),
        ({"gas": True}, "gas: a finite number expected, got True"),
        ({"gas": [0.1] * 8759}, "gas: .*8760 or 8784 hours expected, got 8759"),
        ({"gas": {"value": 0.1, "unit": "EUR"}}, "gas: a unit per energy expected"),
        ({"gas": {"price": 0.1}}, "gas: .*a time series expected"),
        ({"gas": "no.csv"}, r"gas: there is no file .*/no\.csv"),
        ({"gas": "SHORT"}, "gas: .*a year has 8760 hours.*the file has 24"),
        ({"gas": "TEXT"}, "gas: .*has no number in line 3"),
        (
            {"gas": "COMMA"},
            "gas: .*no header, and of their two numbers the first ones are no times.*if the comma is the",
        ),
        ({"gas": "COMMA_BELOW"}, "gas: .*line 2 has more cells than the header, line 1; if the comma is the decimal"),
        ({"gas": "TIMES"}, r"gas: .*no header, and their last two cells are whole numbers \(0, 25\); if the comma is"),
        (0.3, "a mapping from fuels to numbers or time series expected, got 0.3"),
    ],
)
def test_kpis__mistakes_are_one_sentence(rates: Any, text: str, tmp_path: Path) -> None:
    (tmp_path / "short.csv").write_text("\n".join(["0.1"] * 24))
    (tmp_path / "text.csv").write_text("price\n0.1\nnan\n" + "\n".join(["0.1"] * 8758))
    (tmp_path / "comma.csv").write_text("\n".join(["0,25"] * 8760))
    (tmp_path / "comma_below.csv").write_text("price\n" + "\n".join(["0,25"] * 8760))
    (tmp_path / "times.csv").write_text("\n".join(f"2026-01-01T{hour},0,25" for hour in range(8760)))
    files = {name.upper(): tmp_path / f"{name}.csv" for name in ("short", "text", "comma", "comma_below", "times")}
    if isinstance(rates, dict):
        rates = {fuel: files.get(rate, rate) if isinstance(rate, str) else rate for fuel, rate in rates.items()}
    for read in (read_prices, read_emissions):
        with pytest.raises(InvalidConfig, match=text):
            read(rates)


def test_kpis__prices_in_two_currencies_are_refused() -> None:
    prices = {"gas": {"value": 8.0, "unit": "ct/kWh"}, "coal": {"value": 80.0, "unit": "EUR/MWh"}, "propane": 0.1}
    with pytest.raises(InvalidConfig, match="prices: natural_gas in ct and coal in EUR; prices in one currency"):
        read_prices(prices)


def test_kpis__emission_factors_are_not_negative() -> None:
    factors = [0.4] * 8760
    factors[5000] = -0.1
    for wrong in (-0.1, factors):
        with pytest.raises(InvalidConfig, match=r"electricity has the factor -0\.1; numbers of at least 0 expected"):
            read_emissions({"electricity": wrong})


def test_kpis__wrong_rate_is_an_error_before_anything_starts() -> None:
    with pytest.raises(InvalidConfig, match="no fuel 'wood'"):
        evaluate({"link": None}, ["no-such-controller"], prices={"wood": 0.1})


def test_kpis__all_controllers_of_a_comparison_have_the_same_rates() -> None:
    link = FakeLink(FakeBuilding(2))
    link.building.manifest = link.manifest = link.manifest.model_copy(update={"floor_area_m2": 50.0})
    evaluation = evaluate({"link": link}, ["rbc", "fixed"], prices={"electricity": 0.5})
    for row in evaluation.rows:
        energy, cost = kpi(row.result, "ener_tot"), kpi(row.result, "cost_tot")
        assert energy > 0.0
        assert cost == pytest.approx(0.5 * energy)
    assert evaluation.sources["kpi.cost_tot"].endswith("per m² of 50 m² floor area")


# A real building


@pytest.mark.slow
@pytest.mark.process
def test_kpis__energy_is_that_of_energyplus_own_meters_and_of_its_demand_rate() -> None:
    with gym.make(
        "zenostat/Building-v1", **{**SMALL, "begin": "01-17", "end": "01-17"}, monitoring=True, affinity="off"
    ) as env:
        building: Any = env.unwrapped
        of: Manifest = building.manifest
        metrics = MetricsAccumulator(
            of, prices={"electricity": 1.0, "gas": 10.0}, emissions={"electricity": 1.0, "gas": 0}
        )
        env.reset(seed=1)
        metrics.add(building.sample)
        rows, ended = [], False
        while not ended:
            *_, ended, _ = env.step(env.action_space.sample())
            metrics.add(building.sample)
            rows.append(building.sample.values)
    values = dict(zip(of.names, np.array(rows).T, strict=True))
    joules = {m.meter: values[m.name] for m in of.meters}
    hvac = ("Heating", "Cooling", "Fans", "Pumps", "HeatRejection", "Humidifier", "HeatRecovery")
    electricity, gas = (
        sum(joules[f"{use}:{fuel}"] for use in hvac if f"{use}:{fuel}" in joules)
        for fuel in ("Electricity", "NaturalGas")
    )
    area_m2, result = of.floor_area_m2 or 0.0, metrics.result()
    assert kpi(result, "ener_tot") * area_m2 == pytest.approx((electricity.sum() + gas.sum()) / KWH)
    assert kpi(result, "cost_tot") * area_m2 == pytest.approx((electricity.sum() + 10.0 * gas.sum()) / KWH)
    assert kpi(result, "emis_tot") * area_m2 == pytest.approx(electricity.sum() / KWH)
    assert kpi(result, "pele_tot") * area_m2 == pytest.approx(electricity.max() / 900.0 / 1000.0)
    assert kpi(result, "pgas_tot") * area_m2 == pytest.approx(gas.max() / 900.0 / 1000.0)
    assert gas.sum() > 0.0
    assert gas.sum() < joules["NaturalGas:Facility"].sum()  # without hot water
    # EnergyPlus's own sum of the HVAC's electricity, by another way than meters.
    np.testing.assert_allclose(electricity, values["hvac_and_plant_power"] * 900.0, rtol=1e-6)


@pytest.mark.process
def test_kpis__fuels_that_only_other_end_uses_have_are_zero(tmp_path: Path) -> None:
    model = box_model()
    stove = {name: value for name, value in model["Lights"]["Lights"].items() if name != "lighting_level"}
    model["GasEquipment"] = {
        "Stove": stove | {"design_level_calculation_method": "EquipmentLevel", "design_level": 50.0}
    }
    (tmp_path / "box.epJSON").write_text(json.dumps(model))
    settings: dict[str, Any] = {"building": str(tmp_path / "box.epJSON"), "weather": SMALL["weather"], "reward": None}
    with gym.make("zenostat/Building-v1", **settings, monitoring=True, affinity="off") as env:
        building: Any = env.unwrapped
        metrics = MetricsAccumulator(building.manifest, prices={"electricity": 1.0, "gas": 1.0})
        env.reset(seed=1)
        metrics.add(building.sample)
        for _ in range(96):
            env.step(env.action_space.sample())
            metrics.add(building.sample)
    totals = metrics.result().metrics()
    # 100 W of lights and 50 W of gas for a day.
    assert (totals["electricity_kwh"], totals["natural_gas_kwh"]) == pytest.approx((2.4, 1.2))
    assert (totals["hvac_electricity_kwh"], totals["hvac_natural_gas_kwh"]) == (0.0, 0.0)
    kpis = ("ener_tot", "cost_tot", "pele_tot", "pgas_tot")
    assert [totals[f"kpi.{name}"] for name in kpis] == [0.0] * len(kpis)
