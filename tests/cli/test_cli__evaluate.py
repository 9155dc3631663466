"""`zenostat evaluate` as a program, from a folder that is not the project's."""

import json
import math
import re
import signal
import sys
from pathlib import Path

import pytest
from support.csv_files import csv_rows
from support.nodes import SMALL, interrupted
from support.run_cli import ZENOSTAT, error_of, run_program

from zenostat.cli.evaluate import INTERVAL_NOTE, check_file, metric_text, write
from zenostat.metrics.statistics import summarize
from zenostat.topics.errors import InvalidConfig

SCENARIO = f"""
building: {SMALL["building"]}
weather: {SMALL["weather"]}
steps_per_hour: {SMALL["steps_per_hour"]}
begin: "07-03"
end: "12-31"
weather_noise: {{dry_bulb_temperature: {{sigma: 1.0, mu: 0.0, tau_h: 24.0}}}}
reward: {{kind: linear}}
"""
DAY = ["--begin", "07-03", "--end", "07-03"]


@pytest.mark.slow
def test_metric_text__after_the_sign_stands_half_the_interval_as_in_reports() -> None:
    pytest.importorskip("scipy")
    # 1, 2 and 6.5: standard deviation 2.92973; Student's t for two degrees of freedom 4.302653 (any table of it).
    assert metric_text(summarize([1.0, 2.0, 6.5])) == f"3.17 ± {4.302653 * 2.92973 / 3**0.5:.2f}"
    assert metric_text(summarize([1.25])) == "1.25"


@pytest.mark.parametrize("values", [[math.nan], [math.inf], [math.nan, 1.0], [math.inf, 1.0], [-math.inf, 1.0, 2.0]])
def test_metric_text__of_what_is_no_finite_number_is_not_available(values: list[float]) -> None:
    assert metric_text(summarize(values)) == "n/a"


@pytest.mark.slow
def test_cli__two_runs_give_the_same_table_and_the_same_parquet(scratch: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    (scratch / "office.yaml").write_text(SCENARIO)
    call = ["office.yaml", "--controller", "baseline", "--controller", "rbc", "--set", "margin=0.5", "--episodes", "2"]
    runs = [run_program("evaluate", *call, *DAY, "--seed", "3", "--out", f"{run}.parquet", cwd=scratch) for run in "ab"]
    for done in runs:
        assert done.returncode == 0, done.stderr
    one, other = (done.stdout[done.stdout.index("baseline  ") :].splitlines() for done in runs)
    shown = [line for line in one if not line.startswith("episodes:") and "steps/s" not in line]
    assert shown == [line for line in other if not line.startswith("episodes:") and "steps/s" not in line]
    assert re.search(r"electricity \(kWh\)\s+[\d,.]+ ± [\d.]+\s+[\d,.]+ ± [\d.]+", "\n".join(shown))
    assert INTERVAL_NOTE in shown
    assert "electricity (kWh), mean power (W), peak (kW): meter Electricity:Facility" in shown
    assert (scratch / "a.parquet").read_bytes() == (scratch / "b.parquet").read_bytes()
    rows = parquet.read_table(scratch / "a.parquet").to_pylist()
    assert [(row["controller"], row["episode"], row["seed"], row["weather"]) for row in rows] == [
        (name, k, 3 + k, SMALL["weather"]) for name in ("baseline", "rbc") for k in range(2)
    ]
    assert rows[0]["electricity_kwh"] != rows[1]["electricity_kwh"]  # other noise on the weather
    assert rows[0]["electricity_kwh"] != rows[2]["electricity_kwh"]
    assert {row["steps"] for row in rows} == {96}
    assert sorted(path.name for path in scratch.glob("*.parquet")) == ["a.parquet", "b.parquet"]


@pytest.mark.slow
def test_cli__json_is_the_table_of_the_episodes_and_csv_the_same(scratch: Path) -> None:
    (scratch / "mine.py").write_text(
        "from zenostat.agent_sdk.controllers import FixedSetpoints\n\n\n"
        "class Mine(FixedSetpoints):\n    def __init__(self, manifest, *, core=26.0):\n"
        "        super().__init__(manifest, cooling_setpoint=core)\n"
    )
    call = ["ref-small-office-USA_CO_Denver-continuous-v1", "--controller", "mine.py:Mine", "--set", "core=25.5"]
    call += ["--price", "electricity=0.5", "--price", "gas=0", "--emissions", "electricity=0.25"]
    done = run_program("evaluate", *call, *DAY, "--json", "--out", "rows.csv", cwd=scratch)
    assert done.returncode == 0, done.stderr
    (row,) = json.loads(done.stdout)
    assert row["controller"] == "mine.py:Mine"
    assert row["reward"] == pytest.approx(row["reward.energy"] + row["reward.comfort"])
    assert row["mean_power_w"] == pytest.approx(row["electricity_kwh"] / 24 * 1e3)
    assert row["kpi.cost_tot"] > 0.0
    assert row["kpi.cost_tot"] < 0.5 * row["kpi.ener_tot"]  # gas costs nothing
    assert row["kpi.emis_tot"] in (None, pytest.approx(row["kpi.cost_tot"] / 2))  # None if gas was used
    (read,) = csv_rows(scratch / "rows.csv")
    assert {name: "" if value is None else str(value) for name, value in row.items()} == read


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--controller", "rbc", "--out", "rows.txt"], "--out rows.txt: expected a .parquet or .csv file"),
        (["--controller", "rbc", "--out", "/dev/null/rows.csv"], "/dev/null is not a folder that can be written to"),
        (["--controller", "rbcc"], "no controller 'rbcc'; did you mean 'rbc'"),
        (["--controller", "rbc", "--controller", "rbc"], "the controller rbc is listed twice"),
        (["--controller", "rbc", "--set", "mergin=1"], "none of the controllers has the parameter 'mergin'"),
        (["--controller", "rbc", "--set", "margin"], "--set margin: expected a name and a value"),
        (["--controller", "mine.py:Mine"], "there is no file"),
        (["--controller", "rbc", "--begin", "13-01"], "13-01"),
        (["--controller", "rbc", "--price", "gas"], "--price gas: expected a fuel and a number or file"),
        (["--controller", "rbc", "--price", "gas=1", "--price", "gas=2"], "--price gas occurs twice: 1.0 and 2.0"),
        (["--controller", "rbc", "--emissions", "electricity=-1"], "electricity has the factor -1"),
    ],
)
def test_cli__mistakes_are_one_sentence(scratch: Path, arguments: list[str], message: str) -> None:
    assert message in error_of("evaluate", "ref-small-office-USA_CO_Denver-continuous-v1", *arguments, cwd=scratch)
    assert list(scratch.glob("rows*")) == []


def test_cli__unknown_scenario_lists_near_ones(scratch: Path) -> None:
    scenario = "ref-smal-office-USA_CO_Denver-continuous-v1"
    error = error_of("evaluate", scenario, "--controller", "rbc", cwd=scratch)
    assert "ref-small-office-USA_CO_Denver-continuous-v1" in error


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_evaluate__a_signal_leaves_nothing(scratch: Path, number: signal.Signals) -> None:
    (scratch / "office.yaml").write_text(SCENARIO)
    (scratch / "signals.py").write_text(
        "from zenostat.agent_sdk.controllers import RuleBasedController\n\n\n"
        "class Signals(RuleBasedController):\n    def act(self, sample):\n"
        "        if sample.step == 40:\n            open('step-40', 'w').close()\n        return super().act(sample)\n"
    )
    command = [*ZENOSTAT, "evaluate", "office.yaml", "--controller", "signals.py:Signals", "--out", "rows.csv"]
    interrupted(command, (scratch / "step-40").exists, "it simulates", cwd=scratch, number=number)
    assert list(scratch.glob("*rows*")) == []


def test_write__creates_the_folder_of_a_table(tmp_path: Path) -> None:
    path = tmp_path / "runs" / "july" / "rows.csv"
    check_file(path)
    assert not path.parent.exists()  # nothing is written before there are results
    write([{"a": 1, "b": None}], path)
    assert path.read_text() == "a,b\n1,\n"


def test_cli__parquet_needs_its_extra(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(InvalidConfig, match=r"pip install -e '\S+\[parquet\]'"):
        check_file(tmp_path / "rows.parquet")
    check_file(tmp_path / "rows.csv")


def test_cli__file_is_there_whole_or_not_at_all(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="dict contains fields"):
        write([{"controller": "rbc"}, {"else": 1}], tmp_path / "rows.csv")
    assert list(tmp_path.iterdir()) == []
    write([{"controller": "rbc", "peak_kw": None, "reward": -0.1}], tmp_path / "rows.csv")
    assert (tmp_path / "rows.csv").read_text() == "controller,peak_kw,reward\nrbc,,-0.1\n"
