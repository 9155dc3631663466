"""An electric grid: its power flow against closed solutions, balances, devices, and a file's errors."""

from datetime import datetime, timedelta
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from zenostat.testing import check_plant
from zenostat.topics.errors import InvalidConfig, PlantFailed

pytest.importorskip("power_grid_model")

from zenostat.plants.grid.plant import GridPlant
from zenostat.plants.grid.profiles import Means

LINE = {"from": "lv", "to": "a", "length_m": 400, "resistance_ohm_km": 0.5, "reactance_ohm_km": 0.1, "ampacity_a": 100}
SIMPLE: dict[str, Any] = {
    "source": {"bus": "lv"},
    "buses": {"lv": {"voltage_kv": 0.4}, "a": {"voltage_kv": 0.4}},
    "lines": {"cable": LINE},
    "loads": {"house": {"bus": "a"}},
}
FEEDER: dict[str, Any] = {
    **SIMPLE,
    "source": {"bus": "mv"},
    "buses": {**SIMPLE["buses"], "mv": {"voltage_kv": 10}},
    "transformers": {
        "station": {
            "from": "mv", "to": "lv", "power_kva": 250, "short_circuit_percent": 4, "copper_loss_w": 3250,
            "iron_loss_w": 425, "no_load_percent": 0.3,
        }
    },
    "pv": {"roof": {"bus": "a", "power_w": 20000}},
    "batteries": {"store": {"bus": "a", "capacity_kwh": 10, "power_kw": 5, "initial": 0.2}},
    "chargers": {
        "box": {"bus": "a", "power_kw": 11, "sessions": [{"arrival_h": 0.1, "departure_h": 2, "energy_kwh": 5}]},
        "drawn": {
            "bus": "a", "power_kw": 11, "sessions": {
                "arrival_h": {"mean": 17, "deviation": 1}, "departure_h": {"mean": 7},
                "energy_kwh": {"mean": 12, "deviation": 3},
            },
        },
    },
    "price": {"price": 0.3, "unit": "EUR/kWh"},
}  # fmt: skip


def grid(folder: Path, content: dict[str, Any], **arguments: Any) -> GridPlant:
    path = folder / "grid.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return GridPlant(str(path), **arguments)


# Power flow


def test_grid__voltage_of_two_buses_is_the_closed_solution(tmp_path: Path) -> None:
    """With the impedance R + jX and the load P + jQ, V^4 + (2 (R P + X Q) - E^2) V^2 + |Z|^2 |S|^2 = 0."""
    plant = grid(tmp_path, SIMPLE | {"loads": {"house": {"bus": "a", "power_factor": 0.9}}})
    plant.reset(0)
    for active in (0.0, 5e3, 2e4, 5e4, -3e4):
        values = plant.step({"house_demand": active})
        reactive = active * sqrt(1.0 - 0.9**2) / 0.9
        resistance, reactance, source = 0.2, 0.04, 400.0
        middle = 2.0 * (resistance * active + reactance * reactive) - source**2
        product = (resistance**2 + reactance**2) * (active**2 + reactive**2)
        voltage = sqrt((-middle + sqrt(middle**2 - 4.0 * product)) / 2.0)
        current = sqrt(active**2 + reactive**2) / voltage / sqrt(3.0)
        assert values["a_voltage"] == pytest.approx(voltage / source, abs=1e-9)
        assert values["cable_loading"] == pytest.approx(current, abs=1e-6), "of 100 A"
        assert values["losses"] == pytest.approx(3.0 * resistance * current**2, abs=1e-5)


def test_grid__transformer_has_the_losses_of_its_rating_plate(tmp_path: Path) -> None:
    buses = {"mv": {"voltage_kv": 10}, "lv": {"voltage_kv": 0.4}}
    none: dict[str, Any] = {kind: {} for kind in ("lines", "pv", "batteries", "chargers")}
    plant = grid(tmp_path, {**FEEDER, **none, "buses": buses, "loads": {"house": {"bus": "lv"}}})
    assert plant.reset(0)["losses"] == pytest.approx(425.0, rel=1e-3)
    values = plant.step({"house_demand": 243.6e3})
    assert values["station_loading"] == pytest.approx(100.0, abs=2.0)
    assert values["losses"] == pytest.approx(425.0 + 3250.0 * (values["station_loading"] / 100.0) ** 2, rel=5e-3)


def test_grid__powers_balance_in_each_timestep(tmp_path: Path) -> None:
    plant = grid(tmp_path, FEEDER)
    rng, values = np.random.default_rng(2), plant.reset(5)
    for _ in range(96):
        commands = {
            "house_demand": float(rng.uniform(0.0, 4e4)), "store_setpoint": float(rng.uniform(-5e3, 5e3)),
            "roof_curtailment": float(rng.uniform(0.0, 1.0)), "drawn_limit": float(rng.uniform(0.0, 11e3)),
        }  # fmt: skip
        values = plant.step(commands)
        drawn = sum(values[f"{name}_power"] for name in ("house", "store", "box", "drawn")) - values["roof_power"]
        assert values["import"] - values["export"] == pytest.approx(drawn + values["losses"], abs=1e-5)
        assert values["electricity"] == values["import"] * 900.0
        assert values["losses"] > 0.0
    assert plant.model_name == "grid"


# Devices


def test_grid__battery_stores_with_its_efficiencies_within_its_capacity(tmp_path: Path) -> None:
    plant = grid(tmp_path, FEEDER)
    plant.reset(0)
    charge = [plant.step({"store_setpoint": 5e3}) for _ in range(8)]
    assert charge[0]["store_state_of_charge"] == pytest.approx(0.2 + 5.0 * 0.25 * 0.95 / 10.0)
    assert charge[-1]["store_state_of_charge"] == pytest.approx(1.0)
    drawn_kwh = sum(values["store_power"] for values in charge) * 0.25 / 1e3
    assert drawn_kwh == pytest.approx(8.0 / 0.95), "what it stored over its efficiency"
    discharge = [plant.step({"store_setpoint": -5e3}) for _ in range(10)]
    assert discharge[-1]["store_state_of_charge"] == pytest.approx(0.0, abs=1e-12)
    assert sum(values["store_power"] for values in discharge) * 0.25 / 1e3 == pytest.approx(-10.0 * 0.95)


def test_grid__charger_delivers_what_the_vehicle_needs_while_it_is_there(tmp_path: Path) -> None:
    plant = grid(tmp_path, FEEDER)
    plant.reset(0)
    values = [plant.step({}) for _ in range(8)]
    assert values[0]["box_power"] == pytest.approx(11e3 * (900.0 - 360.0) / 900.0), "it arrives after 6 minutes"
    assert sum(v["box_power"] for v in values) * 900.0 == pytest.approx(5.0 * 3.6e6)
    assert [v["box_connected"] for v in values] == [1.0] * 7 + [0.0]
    assert values[0]["box_departure"] == 2 * 3600.0 - 900.0
    assert (values[3]["box_needed"], values[-1]["box_unmet"]) == (0.0, 0.0)
    plant.reset(0)
    limited = [plant.step({"box_limit": 1e3}) for _ in range(8)]
    assert limited[-1]["box_unmet"] == pytest.approx(5.0 * 3.6e6 - 1e3 * 1.9 * 3600.0)


def test_grid__drawn_sessions_follow_the_seed(tmp_path: Path) -> None:
    plant = grid(tmp_path, FEEDER)

    def episode(seed: int) -> list[float]:
        plant.reset(seed)
        return [plant.step({})["drawn_power"] for _ in range(96)]

    assert episode(1) == episode(1) != episode(2)


@pytest.mark.parametrize("begin", ["2026-07-01T00:00", "2026-07-01T12:00", "2026-07-01T20:00"])
def test_grid__drawn_sessions_have_the_hours_of_the_day(tmp_path: Path, begin: str) -> None:
    """A vehicle arrives at 18:00 and leaves at 7:00, whenever the episode begins; one that is there stays."""
    sessions = {"arrival_h": {"mean": 18}, "departure_h": {"mean": 7}, "energy_kwh": {"mean": 500}}
    chargers = {"box": {"bus": "a", "power_kw": 11, "sessions": sessions}}
    plant = grid(tmp_path, FEEDER | {"chargers": chargers}, begin=begin, duration_s=3 * 86400.0, step_s=900.0)
    first = plant.reset(0)["box_connected"]
    connected = [first, *(plant.step({})["box_connected"] for _ in range(3 * 96))]
    hours = [(datetime.fromisoformat(begin) + timedelta(hours=step / 4)) for step in range(3 * 96 + 1)]
    night = [float(at.hour >= 18 or (at.hour < 7 and at.date() > hours[0].date())) for at in hours]
    assert connected == night


def test_grid__curtailed_pv_feeds_in_less(tmp_path: Path) -> None:
    plant = grid(tmp_path, FEEDER)
    plant.reset(0)
    assert [plant.step({"roof_curtailment": share})["roof_power"] for share in (0.0, 0.25, 1.0)] == [2e4, 1.5e4, 0.0]


# Profiles


def test_means__are_exact_over_any_interval_and_periodic() -> None:
    means = Means(np.array([1.0, 3.0]), 3600.0)
    assert [means.mean(t, t + 900.0) for t in (0.0, 3599.0 - 899.0, 3600.0, 7200.0)] == [1.0, 1.0, 3.0, 1.0]
    assert means.mean(2700.0, 4500.0) == pytest.approx(2.0)
    assert means.mean(0.0, 3.0 * 3600.0) == pytest.approx(5.0 / 3.0)
    assert means.mean(6300.0, 8100.0) == pytest.approx(2.0), "after the last row it begins again"


def test_grid__profiles_and_sessions_are_read_from_csv_files(tmp_path: Path) -> None:
    (tmp_path / "houses.csv").write_text("time,one,two\n0,1000,1.5\n1,3000,2.5\n")
    (tmp_path / "cars.csv").write_text("charger,arrival_h,departure_h,energy_kwh\nbox,0,1,1\nother,0,9,9\n")
    profile = {"file": "houses.csv", "column": "one", "factor": 2.0}
    content = FEEDER | {"loads": {"house": {"bus": "a", "power_w": profile}}}
    content["chargers"] = {"box": {"bus": "a", "power_kw": 4, "sessions": {"file": "cars.csv"}}}
    plant = grid(tmp_path, content)
    assert plant.reset(0)["house_power"] == 2000.0
    values = [plant.step({}) for _ in range(5)]
    assert [v["house_power"] for v in values] == [2000.0] * 4 + [6000.0]
    assert values[0]["box_power"] == 4000.0
    assert set(plant.files) == {"grid", "profile houses.csv", "profile cars.csv"}


@pytest.mark.parametrize(
    ("values", "factor", "text"),
    [
        ("10\n-5\n", 1.0, "pv.csv:3: one = '-5'; a number of at least 0 expected"),
        ("10\n", -2.0, "pv.csv:2: one = '10' with the factor -2; a number of at least 0 expected"),
    ],
)
def test_grid__negative_profile_of_pv_is_refused(tmp_path: Path, values: str, factor: float, text: str) -> None:
    (tmp_path / "pv.csv").write_text(f"one\n{values}")
    profile = {"file": "pv.csv", "column": "one", "factor": factor}
    with pytest.raises(InvalidConfig, match=text):
        grid(tmp_path, FEEDER | {"pv": {"roof": {"bus": "a", "power_w": profile}}})
    plant = grid(tmp_path, FEEDER | {"loads": {"house": {"bus": "a", "power_w": profile}}})
    assert plant.reset(0)["house_power"] == 10.0 * factor


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        ("bocks,0,1,1\n", "cars.csv: no row has the charger 'box'; did you mean 'bocks'"),
        ("box,0,1,1\n\nbox,3,2,1\n", "cars.csv:4: a departure after the arrival"),
    ],
)
def test_grid__wrong_sessions_in_a_file_are_named(tmp_path: Path, rows: str, text: str) -> None:
    (tmp_path / "cars.csv").write_text(f"charger,arrival_h,departure_h,energy_kwh\n{rows}")
    with pytest.raises(InvalidConfig, match=text):
        grid(tmp_path, FEEDER | {"chargers": {"box": {"bus": "a", "power_kw": 4, "sessions": {"file": "cars.csv"}}}})


# A power flow that does not converge


def test_grid__diverged_power_flow_keeps_the_last_good_voltages_and_nothing_flows(tmp_path: Path) -> None:
    plant = grid(tmp_path, SIMPLE)
    plant.reset(0)
    good = plant.step({"house_demand": 2e4})
    kept = plant.step({"house_demand": 2e6})
    assert (good["converged"], kept["converged"], kept["electricity"]) == (1.0, 0.0, 0.0)
    assert kept["a_voltage"] == good["a_voltage"] < 1.0
    assert good["import"] > 2e4
    powers = [name for name in good if name.endswith("_power")]
    assert powers
    assert {kept[name] for name in ("import", "export", "losses", *powers)} == {0.0}
    (text,) = plant.drain_warnings()
    assert text.startswith("the power flow of step 2 does not converge")
    assert "at bus 'a'" in text
    assert plant.drain_warnings() == []
    assert plant.step({"house_demand": 2e4})["a_voltage"] == good["a_voltage"]


def test_grid__diverged_power_flow_may_stop_the_episode(tmp_path: Path) -> None:
    plant = grid(tmp_path, SIMPLE | {"on_divergence": "stop"})
    plant.reset(0)
    with pytest.raises(PlantFailed, match=r"grid grid: the power flow of step 1 does not converge; .* at bus 'a'"):
        plant.step({"house_demand": 2e6})


def test_grid__that_does_not_converge_at_its_begin_fails(tmp_path: Path) -> None:
    plant = grid(tmp_path, SIMPLE | {"loads": {"house": {"bus": "a", "power_w": 2e6}}})
    with pytest.raises(PlantFailed, match="the power flow of sample 0 does not converge"):
        plant.reset(0)


# Copies


def test_grid__passes_the_check_of_plants(tmp_path: Path) -> None:
    bounded = FEEDER | {"loads": {"house": {"bus": "a", "low_w": 0.0, "high_w": 3e4}}}
    grid(tmp_path, bounded)
    check_plant("zenostat.plants.grid.plant:GridPlant", {"file": str(tmp_path / "grid.yaml")})


# Files


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"loads": {"house": {"bus": "b"}}}, "loads.house: there is no bus 'b'"),
        ({"source": {"bus": "hv"}}, "source: there is no bus 'hv'"),
        ({"lines": {}}, "no line or transformer connects the bus a with the source"),
        ({"buses": {"lv": {"voltage_kv": 0.4}, "a": {"voltage_kv": 10}}}, "lines.cable: its buses have 0.4 and 10 kV"),
        ({"lines": {"cable": LINE | {"to": "lv"}}}, "lines.cable: it begins and ends at 'lv'"),
        ({"lines": {"a": LINE}}, "lines.a: buses have this name as well"),
        ({"lines": {"cable": LINE | {"lenght_m": 3}}}, "lines.cable.lenght_m: there is no such field"),
        ({"lines": {"my cable": LINE}}, "the name 'my cable' is not valid"),
        ({"step_s": 0}, "step_s"),
        ({"on_divergence": "ignore"}, "on_divergence"),
        (
            {"chargers": {"box": {"bus": "a", "power_kw": 1, "sessions": [
                {"arrival_h": 5, "departure_h": 4, "energy_kwh": 1}]}}},
            "chargers.box.sessions.0: departure_h 4 is not after arrival_h 5",
        ),
        (
            {"chargers": {"box": {"bus": "a", "power_kw": 1, "sessions": [
                {"arrival_h": 1, "departure_h": 4, "energy_kwh": 1}, {"arrival_h": 3, "departure_h": 5, "energy_kwh": 1}
            ]}}},
            "chargers.box: a vehicle arrives at 3 h, before the previous one departs at 4 h",
        ),
        (
            {"buses": FEEDER["buses"], "source": {"bus": "mv"}, "transformers": {
                "station": FEEDER["transformers"]["station"] | {"copper_loss_w": 50000}}},
            "transformers.station: copper_loss_w is 50000, of which 4 % of short-circuit voltage allow at most 10000",
        ),
        ({"loads": {"house": {"bus": "a", "power_w": {"file": "none.csv", "column": "x"}}}}, "none.csv"),
        (
            {"buses": FEEDER["buses"], "source": {"bus": "mv"}, "transformers": {
                "station": FEEDER["transformers"]["station"] | {"clock": 5},
                "second": FEEDER["transformers"]["station"] | {"clock": 11}}},
            "transformers.second: short circuit: with the other clock numbers, its buses are 180 degrees apart",
        ),
        ({"loads": {"house": {"bus": "a", "power_w": True}}}, "loads.house.power_w: .* got True"),
        ({"network": "cigre_lv"}, "network: 'cigre_lv'; pandapower:NAME expected"),
        ({"network": "pandapower:cigre_vl"}, "no such network; did you mean 'cigre_mv' or 'cigre_lv'"),
    ],
)  # fmt: skip
def test_grid__wrong_file_is_named(tmp_path: Path, change: dict[str, Any], text: str) -> None:
    with pytest.raises(InvalidConfig, match=text.replace("(", r"\(")):
        grid(tmp_path, SIMPLE | change)


def test_grid__errors_have_the_lines_of_the_file(tmp_path: Path) -> None:
    """Those of fields, of rules on several parts, and of merged parts, in the order of the file; all at once."""
    (tmp_path / "grid.yaml").write_text(
        "source: {bus: lv}\n"
        "buses:\n"
        "  lv: {voltage_kv: 0.4}\n"
        "  a: {voltage_kv: 0.4}\n"
        "lines:\n"
        "  cable: &cable\n"
        "    {from: lv, to: b, length_m: 400, resistance_ohm_km: 0.5, reactance_ohm_km: 0.1, ampacity_a: 100}\n"
        "  second: {<<: *cable, to: c}\n"
        "loads:\n"
        "  house: {bus: d}\n"
    )
    with pytest.raises(InvalidConfig) as raised:
        GridPlant(str(tmp_path / "grid.yaml"))
    first, *others = str(raised.value).splitlines()
    path = tmp_path / "grid.yaml"
    assert first == f"{path} has errors:"
    assert [line.strip().partition("; ")[0] for line in others] == [
        f"{path}:6: lines.cable: there is no bus 'b'",
        f"{path}:8: lines.second: there is no bus 'c'",
        f"{path}:10: loads.house: there is no bus 'd'",
    ]
    with pytest.raises(InvalidConfig, match=r"grid\.yaml: step_s: .* got 0$"):  # an argument is in no line
        grid(tmp_path, SIMPLE, step_s=0)


@pytest.mark.parametrize(
    ("content", "text"),
    [("a,b\n1\n", "profile.csv:2: no value of 'b'"), ("a,b\n1,x\n", "profile.csv:2: b = 'x'; a finite number"),
     ("a\n1\n", "no column 'b'"), ("b,a,b\n1,2,3\n", "2 columns 'b'; one expected"),
     ("a,b\n", "a header and at least one row"),
     ("a,b\n\n", "a header and at least one row"), ("", "a header and at least one row")],
)  # fmt: skip
def test_grid__wrong_csv_file_is_named_with_its_line(tmp_path: Path, content: str, text: str) -> None:
    (tmp_path / "profile.csv").write_text(content)
    profile = {"file": "profile.csv", "column": "b"}
    with pytest.raises(InvalidConfig, match=text):
        grid(tmp_path, SIMPLE | {"loads": {"house": {"bus": "a", "power_w": profile}}})
