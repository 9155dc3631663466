"""`--report` and `--figures` of the commands that run episodes."""

import json
import re
from pathlib import Path

import pytest
from support.csv_files import csv_rows
from support.nodes import SMALL
from support.run_cli import error_of, run_program

from zenostat.views.report.totals import number

SCENARIO = f"""
building: {SMALL["building"]}
weather: {SMALL["weather"]}
steps_per_hour: {SMALL["steps_per_hour"]}
begin: "07-03"
end: "07-03"
reward: {{kind: linear}}
"""


@pytest.mark.slow
def test_cli__evaluation_writes_report_and_figures_with_its_own_numbers(scratch: Path) -> None:
    pytest.importorskip("matplotlib")
    (scratch / "my office.yaml").write_text(SCENARIO)
    call = ["my office.yaml", "--controller", "baseline", "--controller", "rbc", "--json", "--price", "electricity=0.2"]
    done = run_program("evaluate", *call, "--report", "out.html", "--figures", "figures", cwd=scratch)
    assert done.returncode == 0, done.stderr
    baseline, rbc = json.loads(done.stdout)
    text = (scratch / "out.html").read_text()
    rows = dict(re.findall(r'<tr data-metric="([^"]+)">(.*?)</tr>', text))
    for name in ("electricity_kwh", "hvac_electricity_kwh", "peak_kw", "occupied_outside_kh", "reward", "kpi.ener_tot"):
        cells = re.findall(r'<td class="n">(.*?)</td>', rows[name])
        assert cells[:2] == [number(baseline[name]), number(rbc[name])], name
    assert "zenostat evaluate &#x27;my office.yaml&#x27; --controller baseline" in text
    assert "<pre>" in text
    assert f"building: {SMALL['building']}\n" in text  # the scenario itself
    uses = csv_rows(scratch / "figures" / "end-uses.csv")
    for name, metrics in (("baseline", baseline), ("rbc", rbc)):  # monitoring measures every end use
        total = sum(float(use[f"{name} (kWh)"]) for use in uses)
        assert total == pytest.approx(metrics["electricity_kwh"] + metrics["natural_gas_kwh"], rel=1e-6)
    zones = csv_rows(scratch / "figures" / "degree-hours.csv")
    outside = sum(float(zone["rbc: above (K h)"]) + float(zone["rbc: below (K h)"]) for zone in zones)
    assert outside == pytest.approx(rbc["occupied_outside_kh"], abs=1e-9)
    assert (scratch / "figures" / "weather.png").stat().st_size > 10_000


@pytest.mark.parametrize("command", [["evaluate", "x", "--controller", "rbc"], ["run", "--node", "x"]])
@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--report", "report.txt"], "--report report.txt: expected an .html file"),
        (["--report", "nowhere/report.html"], "--report nowhere/report.html: there is no folder"),
        (["--report", "folder.html"], "--report folder.html: expected a file, but this is a folder"),
        (["--figures", "file"], "--figures file: expected a folder, but this is a file"),
        (["--figures", "nowhere/figures"], "--figures nowhere/figures: there is no folder"),
        (["--report", "/proc/a.html"], "--report /proc/a.html: no file can be written in /proc"),
        (["--figures", "/proc/figures"], "--figures /proc/figures: no file can be written in /proc"),
        (["--figures", "/proc"], "--figures /proc: no file can be written in /proc"),
    ],
)
def test_cli__wrong_path_is_one_sentence_before_anything_starts(
    command: list[str], options: list[str], message: str, tmp_path: Path
) -> None:
    pytest.importorskip("matplotlib")
    (tmp_path / "folder.html").mkdir()
    (tmp_path / "file").touch()
    assert message in error_of(*command, *options, cwd=tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder.html"]


def test_cli__report_of_recordings_names_its_own_option(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    assert "--out report.txt: expected an .html file" in error_of(
        "report", "a.mcap", "--out", "report.txt", cwd=tmp_path
    )


def test_cli__without_matplotlib_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    error = error_of("evaluate", "x", "--controller", "rbc", "--report", "out.html", cwd=tmp_path)
    assert "a report needs matplotlib.figure" in error
    assert "[plots]" in error
