"""The BOPTEST gateway, by requests as BOPTEST's clients send them; BOPTEST's definitions say what is right."""

import json
import os
import re
import signal

import numpy as np
import pytest
import requests

pytest.importorskip("fastapi", reason="fastapi is not installed")
pytest.importorskip("httptools", reason="httptools is not installed")

from support import data_packs as packs
from support.boptest import DAY_S, Client, serving

from zenostat.bridge.client.local_node import LocalNode
from zenostat.gateways.boptest import episodes, simulation

START_S = 200 * DAY_S  # 20 July
WARMUP_S = DAY_S // 2
COOLING = "core_zn_cooling_setpoint"
AREA_M2 = 511.15740000000005
HVAC = ("heating_electricity_y", "cooling_electricity_y", "fans_electricity_y", "pumps_electricity_y")


@pytest.fixture(scope="module")
def running():
    with serving() as client:
        client.select("office-small")
        yield client


@pytest.fixture
def test(running: Client) -> Client:
    """A test of the small office at midnight of 20 July, with a control step of 15 minutes."""
    running.put("scenario", electricity_price="constant")
    running.put("initialize", start_time=START_S, warmup_period=WARMUP_S)
    running.put("step", step=900)
    return running


@pytest.mark.slow
def test_boptest_gateway__example_flow_of_a_controller_with_kpis_results_and_forecasts(test):
    inputs = test.get("inputs")
    controls = {name: 0 if name.endswith("_activate") else inputs[name]["Minimum"] for name in inputs}
    controls[f"{COOLING}_activate"] = 1
    assert re.fullmatch(r"\d\.\d\.\d", test.request("GET", "/version").json()["payload"]["version"])
    assert test.get("name") == {"name": "office-small"}
    for hour in range(1, 5):
        state = test.put("step", step=3600) and test.advance(**controls)
        assert state["time"] == START_S + 3600 * hour
        assert {*test.get("measurements"), *inputs} | {"time"} == {*state}
        assert state[f"{COOLING}_u"] == pytest.approx(inputs[f"{COOLING}_u"]["Minimum"])
    kpis = test.get("kpi")
    assert {*kpis} == {
        "cost_tot", "emis_tot", "ener_tot", "idis_tot", "pdih_tot", "pele_tot", "pgas_tot", "tdis_tot", "time_rat",
    }  # fmt: skip
    assert kpis["pdih_tot"] is None  # the building has no district heating
    results = test.put("results", point_names=[f"{COOLING}_u"], start_time=START_S, final_time=START_S + 3600)
    assert results["time"] == [START_S + 900 * k for k in range(5)]
    assert test.put("forecast", point_names=["TDryBul"], horizon=0, interval=300)["time"] == [START_S + 4 * 3600]


def test_boptest_gateway__what_is_not_activated_follows_the_baseline_control(test):
    baseline = test.advance()
    test.put("initialize", start_time=START_S, warmup_period=WARMUP_S)
    overridden = test.advance(**{f"{COOLING}_u": 297.15, f"{COOLING}_activate": 1})
    assert (overridden[f"{COOLING}_u"], overridden[f"{COOLING}_activate"]) == (297.15, 1)
    assert baseline[f"{COOLING}_u"] == pytest.approx(302.59)  # the model's schedule at night: 29.44 degC
    for call in ({}, {f"{COOLING}_u": 297.15}, {f"{COOLING}_u": 297.15, f"{COOLING}_activate": 0}):
        state = test.advance(**call)
        assert (state[f"{COOLING}_u"], state[f"{COOLING}_activate"]) == (pytest.approx(302.59), 0)


def test_boptest_gateway__initialize_returns_to_the_same_building_whatever_was_done_to_it(test):
    first = test.put("initialize", start_time=START_S, warmup_period=WARMUP_S)
    for _ in range(3):
        test.advance(**{f"{COOLING}_u": 295.65, f"{COOLING}_activate": 1})
    assert test.put("initialize", start_time=START_S, warmup_period=WARMUP_S) == first
    later = test.put("initialize", start_time=START_S + 900, warmup_period=WARMUP_S)
    assert later["time"] == START_S + 900
    assert test.put("initialize", start_time=START_S, warmup_period=WARMUP_S) == first


def test_boptest_gateway__initialize_begins_and_ends_at_whole_timesteps_and_says_so(test):
    begin_s, warmup_s, end_s = START_S + 567, WARMUP_S + 100, START_S + 3000
    body = {"start_time": begin_s, "warmup_period": warmup_s, "final_time": end_s}
    answer = test.answer("PUT", "initialize", body).json()
    assert (answer["status"], answer["payload"]["time"]) == (200, START_S + 900)
    for name, sent, used in (
        ("start_time", begin_s, START_S + 900),
        ("warmup_period", warmup_s, WARMUP_S),
        ("final_time", end_s, START_S + 2700),
    ):
        reason = "is not a multiple of the building's timestep of 900 s."
        assert f"WARNING: {name} {sent}.0 {reason}  Using {used}.0. ;" in answer["message"]
    assert [test.advance().get("time") for _ in range(3)] == [START_S + 1800, START_S + 2700, None]
    answer = test.answer("PUT", "initialize", {"start_time": START_S, "warmup_period": WARMUP_S}).json()
    assert "WARNING" not in answer["message"]


def test_boptest_gateway__warm_up_can_be_read_and_does_not_count(test):
    name = "electricity_facility_y"
    warmup = test.put("results", point_names=[name], start_time=0, final_time=START_S)
    assert warmup["time"] == [START_S - WARMUP_S + 900 * k for k in range(WARMUP_S // 900 + 1)]
    assert max(warmup[name][1:]) > 0.0
    assert test.get("kpi")["ener_tot"] == 0.0


def test_boptest_gateway__kpis_are_boptests_formulas_over_the_results(test):
    count = 4 * 14  # until 14:00, when the building is in use
    zones = [name[len("LowerSetp[") : -1] for name in test.get("forecast_points") if name.startswith("LowerSetp[")]
    limits = [f"{side}Setp[{zone}]" for side in ("Lower", "Upper") for zone in zones]
    band = test.put("forecast", point_names=limits, horizon=900 * count, interval=900)
    for _ in range(count):
        test.advance(
            **{f"{zone}_cooling_setpoint_{end}": v for zone in zones for end, v in (("u", 301), ("activate", 1))}
        )
    names = [*HVAC, *(f"{zone}_air_temperature_y" for zone in zones)]
    results = test.put("results", point_names=names, start_time=START_S, final_time=START_S + 900 * count)
    power_w = sum(np.array(results[name]) for name in HVAC)[1:]
    kpis = test.get("kpi")
    kwh_m2 = power_w.sum() * 900 / 3.6e6 / AREA_M2
    assert kpis["ener_tot"] == pytest.approx(kwh_m2) != 0.0
    assert kpis["cost_tot"] == pytest.approx(0.15 * kwh_m2)
    assert kpis["emis_tot"] == pytest.approx(0.40 * kwh_m2)
    assert kpis["pele_tot"] == pytest.approx(power_w.max() / 1000 / AREA_M2)
    discomfort_kh = 0.0
    for zone in zones:
        air = np.array(results[f"{zone}_air_temperature_y"])
        low, high = (np.array(band[f"{side}Setp[{zone}]"])[:count] for side in ("Lower", "Upper"))
        for ends in (air[:-1], air[1:]):  # a trapezoid, with the limits of its timestep
            discomfort_kh += (np.maximum(low - ends, 0) + np.maximum(ends - high, 0)).sum() * 900 / 3600 / 2
    assert kpis["tdis_tot"] == pytest.approx(discomfort_kh / len(zones)) != 0.0
    test.put("scenario", electricity_price="dynamic")
    price = test.put("forecast", point_names=["PriceElectricPowerDynamic"], horizon=0, interval=900)
    assert price["PriceElectricPowerDynamic"] == [0.20]
    hours = START_S / 3600 % 24 + np.arange(count) * 0.25
    tariff = np.where((hours >= 7) & (hours < 22), 0.20, 0.105)
    assert test.get("kpi")["cost_tot"] == pytest.approx((tariff * power_w).sum() * 900 / 3.6e6 / AREA_M2)


def test_boptest_gateway__forecast_without_errors_is_what_is_measured_later(test):
    points = ["TDryBul", "Occupancy[core_zn]", "UpperSetp[core_zn]"]
    forecast = test.put("forecast", point_names=dict.fromkeys(points), horizon=12 * 3600, interval=3600)
    test.put("step", step=3600)
    states = [test.advance() for _ in range(12)]
    measured = [state["weaSta_reaWeaTDryBul_y"] for state in states]
    assert forecast["TDryBul"][1:] == pytest.approx(measured)
    assert [state["outdoor_temperature_y"] for state in states] == pytest.approx(measured, abs=0.01)
    names = ["core_zn_occupants_y", f"{COOLING}_u"]
    results = test.put("results", point_names=names, start_time=START_S + 900, final_time="Infinity")
    # A value holds from its time on, so it is that of the timestep which begins then.
    assert forecast["Occupancy[core_zn]"][:12] == pytest.approx(results["core_zn_occupants_y"][::4])
    assert forecast["UpperSetp[core_zn]"][:12] == pytest.approx(results[f"{COOLING}_u"][::4])
    assert max(results["core_zn_occupants_y"]) > 0


_OUTSIDE = {
    "TDryBul": "Outdoor Air Drybulb Temperature",
    "TDewPoi": "Outdoor Air Dewpoint Temperature",
    "PAtm": "Outdoor Air Barometric Pressure",
    "WinSpe": "Wind Speed",
    "WinDir": "Wind Direction",
    "HHorIR": "Horizontal Infrared Radiation Rate per Area",
    "HDirNor": "Direct Solar Radiation Rate per Area",
    "HDifHor": "Diffuse Solar Radiation Rate per Area",
}


@pytest.mark.slow
def test_boptest_gateway__weather_is_what_energyplus_simulates_from_the_first_timestep_on(tmp_path):
    file = tmp_path / "outside.yaml"
    sensors = {f"at_{name}": {"variable": f"Site {text}", "key": "ENVIRONMENT"} for name, text in _OUTSIDE.items()}
    scenario = {"id": "outside", "building": "5zone", "weather": ["USA_CO_Denver"], "steps_per_hour": 4}
    scenario |= {"begin": "2017-01-01", "end": "2017-12-31", "sensors": sensors, "meters": {}, "actuators": {}}
    file.write_text(json.dumps(scenario))
    begin_s = 100 * DAY_S  # 11 April, on which the wind turns over north
    with serving(files=[file]) as test:
        test.select("outside")
        test.put("initialize", start_time=begin_s, warmup_period=0)
        test.put("step", step=DAY_S)
        test.advance()
        names = [name for point in _OUTSIDE for name in (f"at_{point}_y", f"weaSta_reaWea{point}_y")]
        results = test.put("results", point_names=names, start_time=begin_s, final_time=begin_s + DAY_S)
    for point in _OUTSIDE:
        simulated, served = (np.array(results[name]) for name in (f"at_{point}_y", f"weaSta_reaWea{point}_y"))
        assert len(simulated) == 97
        assert np.ptp(simulated) > 0.0
        assert served == pytest.approx(simulated, rel=1e-9, abs=1e-9), point


def test_boptest_gateway__uncertain_forecasts_follow_their_seed_and_are_cleared_by_a_scenario_without_them(test):
    asked = {"point_names": ["TDryBul", "HGloHor"], "horizon": 24 * 3600, "interval": 3600}
    truth = test.put("forecast", **asked)
    test.put("scenario", temperature_uncertainty="high", solar_uncertainty="low", seed=7)
    uncertain = test.put("forecast", **asked)
    assert uncertain["time"] == truth["time"]
    assert np.abs(np.subtract(uncertain["TDryBul"], truth["TDryBul"])).min() > 0.0
    assert test.put("forecast", **asked) == uncertain
    daylight = np.array(truth["HGloHor"]) > 50
    share = np.array(uncertain["HGloHor"])[daylight] / np.array(truth["HGloHor"])[daylight]
    assert (share >= 0.2 - 1e-9).all()
    assert (share <= 2.0 + 1e-9).all()
    assert share.std() > 0
    test.put("scenario", temperature_uncertainty="high", solar_uncertainty="low", seed=8)
    assert test.put("forecast", **asked) != uncertain
    long = test.answer("PUT", "forecast", {**asked, "horizon": 49 * 3600})
    assert long.status_code == 400
    test.put("scenario", electricity_price="constant")
    assert test.put("forecast", **asked) == truth
    assert test.get("scenario")["temperature_uncertainty"] is None


@pytest.mark.slow
def test_boptest_gateway__scenario_begins_a_week_before_its_day_and_ends_after_two_weeks(test):
    peak = test.service.manager.cases.find("office-small").days["peak_cool_day"]
    answer = test.put("scenario", time_period="peak_cool_day", electricity_price="highly_dynamic")
    assert answer["time_period"]["time"] == (peak - 7) * DAY_S
    assert answer["electricity_price"] == "highly_dynamic"
    assert answer["seed"] is None
    warmup = test.put("results", point_names=["outdoor_temperature_y"], start_time=0, final_time=(peak - 7) * DAY_S)
    assert warmup["time"][0] == (peak - 14) * DAY_S
    test.put("step", step=13 * DAY_S)
    assert test.advance()["time"] == (peak + 6) * DAY_S
    test.put("step", step=2 * DAY_S)
    assert test.advance()["time"] == (peak + 7) * DAY_S  # shortened
    over = test.answer("POST", "advance", {}).json()
    assert (over["status"], over["payload"]) == (200, {})
    assert test.get("kpi")["cost_tot"] > 0


@pytest.mark.slow
def test_boptest_gateway__snapshots_and_branches_continue_independently(test):
    override = {f"{COOLING}_u": 295.65, f"{COOLING}_activate": 1}
    test.advance()
    name = test.payload("POST", "snapshot")["snapshot"]
    branch = Client(test.url)
    branch.testid = test.answer("POST", "branch", {}).json()["testid"]
    expected = [test.advance(**override) for _ in range(4)]
    kpis = {**test.get("kpi"), "time_rat": None}
    assert branch.advance() != expected[0]
    for method, operation, body, text in (
        ("PUT", "initialize", {"start_time": 0, "warmup_period": 0}, "cannot be initialized; branch again instead."),
        ("PUT", "scenario", {"time_period": "mix_day"}, "cannot begin a time period; branch again instead."),
        ("POST", "snapshot", {}, "cannot have snapshots; take them of the test that it came from."),
        ("POST", "branch", {}, "cannot be branched; branch the test that it came from."),
    ):
        refused = branch.answer(method, operation, body)
        assert refused.status_code == 400
        assert text in refused.json()["payload"]
    assert branch.answer("PUT", "stop").text == "OK"
    test.put("snapshot", snapshot=name)
    assert [test.advance(**override) for _ in range(4)] == expected
    assert {**test.get("kpi"), "time_rat": None} == kpis
    assert test.payload("DELETE", "snapshot", {"snapshot": name}) == {"snapshot": name}
    assert test.answer("PUT", "snapshot", {"snapshot": name}).status_code == 400


@pytest.mark.slow
def test_boptest_gateway__snapshot_and_branch_outlast_many_other_beginnings(test):
    name = test.payload("POST", "snapshot")["snapshot"]
    branch = Client(test.url)
    branch.testid = test.answer("POST", "branch", {}).json()["testid"]
    test.put("step", step=DAY_S)
    branch.put("step", step=DAY_S)
    expected = test.advance()
    kpis = {**test.get("kpi"), "time_rat": None}
    for count in range(1, 7):
        test.put("initialize", start_time=START_S + 900 * count, warmup_period=WARMUP_S)
        test.get("kpi")
    test.put("snapshot", snapshot=name)
    test.put("step", step=DAY_S)
    for client in (test, branch):
        assert client.advance() == expected
        assert {**client.get("kpi"), "time_rat": None} == kpis
        for _ in range(2):  # beyond what the baseline has simulated
            client.advance()
            assert client.get("kpi")["tdis_tot"] is not None
            assert client.get("baseline")["time"] == client.put("results", point_names=["time"], start_time=0,
                                                                final_time=1e12)["time"][-1]  # fmt: skip
    assert branch.answer("PUT", "stop").text == "OK"
    test.payload("DELETE", "snapshot", {"snapshot": name})
    kept = test.service.manager.get(test.testid).episodes._kept
    for count in range(1, 7):
        test.put("initialize", start_time=START_S + 900 * count, warmup_period=WARMUP_S)
        assert len(kept) <= 5
    assert len(kept) == 4


@pytest.mark.slow
def test_boptest_gateway__branch_ends_when_the_test_is_initialized_on_another_day(test):
    branch = Client(test.url)
    branch.testid = test.answer("POST", "branch", {}).json()["testid"]
    branch.advance()
    test.put("initialize", start_time=START_S + 900, warmup_period=WARMUP_S)
    branch.advance()
    name = test.payload("POST", "snapshot")["snapshot"]
    test.put("initialize", start_time=START_S + 2 * DAY_S, warmup_period=WARMUP_S)
    for method, operation in (("GET", "status"), ("GET", "kpi"), ("POST", "advance"), ("PUT", "stop")):
        refused = branch.answer(method, operation, {})
        assert (refused.status_code, "Invalid testid" in refused.text) == (400, True)
    assert test.service.manager.tests() == [test.testid]
    assert test.answer("PUT", "snapshot", {"snapshot": name}).status_code == 400


@pytest.mark.slow
@pytest.mark.variants
def test_boptest_gateway__snapshots_leave_room_for_beginnings_and_their_baselines(monkeypatch):
    for module in (episodes, simulation):
        monkeypatch.setattr(module, "MAX_COPIES", 12)
    with serving() as client:
        client.select("ref-small-office")
        names = [client.payload("POST", "snapshot")["snapshot"] for _ in range(2)]
        for start_s in range(0, 9000, 900):
            refused = client.answer("POST", "snapshot")
            assert (refused.status_code, "DELETE /snapshot" in refused.text) == (400, True)
            assert client.answer("POST", "branch", {}).status_code == 400
            assert client.get("kpi")["tdis_tot"] is not None
            client.put("initialize", start_time=start_s, warmup_period=0)
        for name in names:
            client.payload("DELETE", "snapshot", {"snapshot": name})
        client.payload("POST", "snapshot")


def test_boptest_gateway__baseline_is_the_building_that_nobody_controls(test):
    free = [test.advance() for _ in range(4)]
    test.put("initialize", start_time=START_S, warmup_period=WARMUP_S)
    for _ in range(4):
        controlled = test.advance(**{f"{COOLING}_u": 295.65, f"{COOLING}_activate": 1})
    baseline = test.get("baseline")
    assert baseline["time"] == controlled["time"]
    for name, value in baseline["measurements"].items():
        assert value == free[-1][name], name
    assert controlled["core_zn_air_temperature_y"] != baseline["measurements"]["core_zn_air_temperature_y"]


@pytest.mark.parametrize(
    ("method", "operation", "body", "text"),
    [
        ("POST", "advance", {"foo_u": 1}, "Unexpected input variable: foo_u."),
        ("POST", "advance", {f"{COOLING}_u": "warm"}, f"Invalid value 'warm' for {COOLING}_u."),
        ("POST", "advance", {f"{COOLING}_activate": 1.2}, f"Invalid value 1.2 for {COOLING}_activate."),
        ("POST", "advance", {f"{COOLING}_activate": "invalid"}, "for core_zn_cooling_setpoint_activate."),
        ("PUT", "initialize", {"start_time": 0}, "'warmup_period'"),
        ("PUT", "initialize", {"start_time": -1, "warmup_period": 0}, "Invalid value -1 for start_time."),
        ("PUT", "initialize", {"start_time": 365 * DAY_S, "warmup_period": 0}, "is not within the year"),
        ("PUT", "initialize", {"start_time": 9, "warmup_period": 0, "final_time": 8}, "must not be before start_time"),
        ("PUT", "step", {"step": "fast"}, "Invalid value 'fast' for step."),
        ("PUT", "scenario", {"electricity_price": "free"}, "Invalid value 'free' for electricity_price"),
        ("PUT", "scenario", {"time_period": "spring"}, "Invalid value 'spring' for time_period"),
        ("PUT", "scenario", {"temperature_uncertainty": "huge"}, "Invalid value 'huge' for temperature_uncertainty"),
        ("PUT", "scenario", {"seed": 1.5}, "Invalid value 1.5 for seed"),
        ("PUT", "scenario", {"electricity_price": "dynamic", "seed": -1}, "Invalid value -1 for seed"),
        ("PUT", "scenario", {"temperature_uncertainty": "low", "solar_uncertainty": "huge"}, "for solar_uncertainty"),
        ("PUT", "results", {"point_names": ["foo"], "start_time": 0, "final_time": 1}, "Invalid point name(s) ['foo']"),
        ("PUT", "results", {"point_names": [], "start_time": "a", "final_time": 1}, "Invalid value 'a' for start_time"),
        ("PUT", "forecast", {"point_names": ["foo"], "horizon": 0, "interval": 1}, "Invalid point name(s) ['foo']"),
        ("PUT", "forecast", {"point_names": [], "horizon": -1, "interval": 1}, "Invalid value -1 for horizon"),
        ("PUT", "forecast", {"point_names": [], "horizon": 1, "interval": 0}, "Invalid value 0 for interval"),
        ("PUT", "forecast", {"point_names": ["TDryBul"], "horizon": 1e12, "interval": 1e-3}, "at most 2000000 can"),
        ("PUT", "snapshot", {"snapshot": "s99"}, "No snapshot 's99'"),
    ],
)
def test_boptest_gateway__bad_requests_are_answered_with_400_and_change_nothing(running, method, operation, body, text):
    def state():
        results = running.put("results", point_names=["time"], start_time=0, final_time=1e12)
        return running.get("kpi"), results, running.get("scenario")

    before = state()
    answer = running.answer(method, operation, body)
    assert answer.status_code == 400
    envelope = answer.json()
    assert (envelope["status"], envelope["message"]) == (400, "Bad Request")
    assert text in envelope["payload"]
    assert state() == before


def test_boptest_gateway__values_beyond_the_bounds_are_clipped_with_a_warning(test):
    answer = test.answer("POST", "advance", {f"{COOLING}_u": 400, f"{COOLING}_activate": "True"}).json()
    assert f"WARNING: value of 400.0 for {COOLING}_u is above maximum of 303.15.  Using 303.15. ;" in answer["message"]
    assert answer["payload"][f"{COOLING}_u"] == pytest.approx(303.15)


@pytest.mark.parametrize(
    ("inputs", "warning"),
    [
        ({"u": None, "activate": 1}, f"{COOLING}_activate is 1, and {COOLING}_u has no value."),
        ({"activate": 1}, f"{COOLING}_activate is 1, and {COOLING}_u has no value."),
        ({"u": 297.15}, f"{COOLING}_u has a value, and {COOLING}_activate is not sent."),
        ({"u": 297.15, "activate": 0}, ""),
        ({"activate": 0}, ""),
    ],
)
def test_boptest_gateway__input_that_is_sent_by_halves_is_warned_of(test, inputs, warning):
    body = {f"{COOLING}_{name}": value for name, value in inputs.items()}
    answer = test.answer("POST", "advance", body).json()
    expected = f" WARNING: {warning}  Using the baseline control. ;" if warning else ""
    assert answer["message"] == f"Advanced simulation successfully from {START_S}.0s to {START_S + 900}.0s.{expected}"
    assert answer["payload"][f"{COOLING}_activate"] == 0


def test_boptest_gateway__results_are_submitted_at_the_end_of_a_period_alone(test):
    body = {"api_key": "key", "unit_test": "True", "tag1": "mine"}
    test.put("initialize", start_time=START_S, warmup_period=WARMUP_S, final_time=START_S + 1800)
    for _ in range(2):
        early = test.answer("POST", "submit", body)
        assert (early.status_code, early.json()["status"], early.json()["payload"]) == (500, 500, None)
        assert "before the end of the scenario's time period" in early.json()["message"]
        assert test.answer("POST", "submit", {"api_key": 1}).status_code == 400
        test.advance()
    record = test.payload("POST", "submit", body)["payload"]["results"][0]
    assert (record["kpis"], record["tags"]) == (test.get("kpi"), ["mine"])
    assert test.answer("POST", "submit", {"api_key": "key"}).status_code == 400


def test_boptest_gateway__infinite_times_are_sent_as_text_where_a_client_refuses_them_as_numbers(test):
    body = {"point_names": ["outdoor_temperature_y"], "start_time": float("-inf"), "final_time": float("inf")}
    with pytest.raises(requests.exceptions.InvalidJSONError):
        test.put("results", **body)
    times = test.put("results", **body | {"start_time": "-Infinity", "final_time": "Infinity"})["time"]
    assert times == [START_S - WARMUP_S + 900 * k for k in range(WARMUP_S // 900 + 1)]


def test_boptest_gateway__step_that_does_not_fit_is_set_and_refused_at_advance(test):
    assert test.put("step", step=101) == {"step": 101.0}
    assert test.get("step") == 101.0
    answer = test.answer("POST", "advance", {})
    assert (answer.status_code, "multiple of the building's timestep of 900 s" in answer.text) == (400, True)


def test_boptest_gateway__forms_and_bare_infinities_are_accepted(test):
    form = test.request("PUT", f"/step/{test.testid}", data={"step": "1800"})
    assert form.json()["payload"] == {"step": 1800.0}
    body = '{"point_names": ["outdoor_temperature_y"], "start_time": -Infinity, "final_time": Infinity}'
    answer = test.request("PUT", f"/results/{test.testid}", data=body, headers={"content-type": "application/json"})
    assert len(answer.json()["payload"]["time"]) == WARMUP_S // 900 + 1


def test_boptest_gateway__unknown_tests_and_test_cases(running):
    unknown = running.request("GET", "/name/foo")
    assert unknown.status_code == 400
    assert unknown.json()["errors"][0]["msg"] == "Invalid testid: foo"
    missing = running.request("POST", "/testcases/ofice-small/select")
    assert (missing.status_code, missing.text.startswith("Not Found")) == (404, True)
    assert "office-small" in missing.text
    assert running.request("GET", "/nothing").status_code == 404
    cases = running.request("GET", "/testcases").json()
    assert {"testcaseid": "office-medium"} in cases
    assert len(cases) >= 32


def test_boptest_gateway__page_lists_all_operations_and_loads_nothing(running):
    page = running.request("GET", "/docs").text
    assert "PUT /scenario/{testid}" in page
    assert not re.search(r"(src|href)=.?https?:", page)
    document = running.request("GET", "/openapi.json").json()
    assert document["paths"]["/initialize/{testid}"]["put"]["requestBody"]


@pytest.mark.slow
def test_boptest_gateway__building_that_dies_fails_its_test_alone_until_it_is_initialized_again(test):
    os.kill(test.service.manager.get(test.testid).episodes.building.pid, signal.SIGKILL)
    answer = test.answer("POST", "advance", {})
    assert (answer.status_code, answer.text.startswith("NodeLost")) == (500, True)
    assert test.get("name") == {"name": "office-small"}
    assert test.put("initialize", start_time=START_S, warmup_period=WARMUP_S)["time"] == START_S
    assert test.advance()["time"] == START_S + 900


@pytest.mark.slow
def test_boptest_gateway__killed_building_that_left_the_bus_before_its_process_ended_is_replaced(test, monkeypatch):
    building = test.service.manager.get(test.testid).episodes.building
    os.kill(building.pid, signal.SIGKILL)
    assert test.answer("POST", "advance", {}).status_code == 500
    end, first_answer = LocalNode.end, [""]  # while the kernel is still taking the process down

    def end_later(node):
        return first_answer.pop() if first_answer else end.fget(node)

    monkeypatch.setattr(LocalNode, "end", property(end_later))
    assert test.put("initialize", start_time=START_S, warmup_period=WARMUP_S)["time"] == START_S


@pytest.mark.slow
def test_boptest_gateway__scenario_of_a_data_pack_is_a_test_case(running):
    packs.sinergym()
    client = Client(running.url)
    assert {"testcaseid": "5zone-hot-continuous-v1"} in client.request("GET", "/testcases").json()
    client.select("5zone-hot-continuous-v1")
    inputs = [name for name in client.get("inputs") if name.endswith("_u")]
    client.put("step", step=900)
    state = client.advance(**{inputs[0]: client.get("inputs")[inputs[0]]["Minimum"]})
    assert state["time"] == 900
    assert client.get("kpi")["tdis_tot"] is not None
    assert client.answer("PUT", "stop").text == "OK"


@pytest.mark.slow
def test_boptest_gateway__tests_without_requests_end_and_paths_without_ids_serve_old_clients():
    with serving(single="ref-small-office", timeout_s=2.0, max_tests=2) as client:
        testid = client.request("POST", "/testcases/office-small/select-async").json()["testid"]
        assert client.request("POST", "/testcases/office-small/select").status_code == 503
        old = client.request("PUT", "/initialize", json={"start_time": 0, "warmup_period": 0}).json()["payload"]
        assert old["time"] == 0
        client.request("PUT", "/step", json={"step": 900})
        assert client.request("POST", "/advance", json={}).json()["payload"]["time"] == 900
        while client.request("GET", f"/status/{testid}").status_code == 200:
            pass  # asking for the status does not keep a test
        assert client.request("GET", "/name").json()["payload"] == {"name": "ref-small-office"}
