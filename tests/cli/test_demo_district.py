"""The demonstration of a district: its files, and all of it with EnergyPlus."""

from pathlib import Path

import numpy as np
import pytest
from support.run_cli import run_program
from support.tank_plant import TANK

from zenostat.bridge.runtime.affinity import Affinity
from zenostat.cli.demo_programs import Demonstration, demonstrate, show_outputs
from zenostat.cosim.demo import FILES, copy_files
from zenostat.cosim.file import read_district
from zenostat.cosim.topology import check_file
from zenostat.metrics.district_kpis import district_kpis
from zenostat.plants.grid.file import read_grid
from zenostat.recording import load
from zenostat.topics import yaml12
from zenostat.views.live import viewer


def test_demo_district__files_are_a_district_and_its_feeder(tmp_path: Path) -> None:
    file = copy_files(tmp_path / "new")
    assert sorted(path.name for path in file.parent.iterdir()) == sorted(FILES)
    spec = read_district(file)
    check_file(spec)
    grid, _, files = read_grid(str(file.parent / spec.spec.plants["feeder"].grid), {})
    assert set(grid.loads) == set(spec.spec.plants) - {"feeder"}
    assert Path(files["profile profiles.csv"]).is_file()


def test_demo_district__has_no_options_of_a_building(tmp_path: Path) -> None:
    done = run_program("demo", "district", "--begin", "01-08", cwd=tmp_path)
    assert done.returncode == 2
    assert "the district's buildings and days are those of its file" in done.stderr


def test_demonstration__screenshot_of_an_earlier_run_is_not_listed(
    scratch: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rerun")
    monkeypatch.setattr(viewer, "has_vulkan", lambda: False)
    demo = Demonstration(
        settings={"plant": TANK, "name": "tank"},
        affinity=Affinity.OFF,
        status="starting a tank",
        controllers=(("baseline", "as it is"),),
        recording=scratch / "tank.rrd",
        screenshot=scratch / "tank.png",
        picture_options=(),
        report=scratch / "tank.html",
    )
    demo.screenshot.write_bytes(b"old")
    outcome = demonstrate(demo)
    assert [len(run.trajectory) for run in outcome.runs] == [1441]
    show_outputs(demo, outcome, {"live view": demo.recording})
    shown = capsys.readouterr().out
    assert f"no screenshot: {viewer.NO_VULKAN}"[:40] in shown
    assert "tank.rrd" in shown
    assert "tank.png" not in shown


@pytest.mark.slow
def test_demo_district__limit_is_exceeded_uncontrolled_and_kept_coordinated(scratch: Path) -> None:
    pytest.importorskip("power_grid_model")
    done = run_program("demo", "district", "--folder", "out", cwd=scratch, timeout_s=1200.0)  # five runs of buildings
    assert done.returncode == 0, done.stderr
    *_, uncontrolled, coordinated = load(scratch / "out" / "district.mcap").episodes
    before, after = (district_kpis(run) for run in (uncontrolled, coordinated))
    assert before["limit_exceeded_h"] > 1.0
    assert after["limit_exceeded_h"] == 0.0
    assert after["all_time_peak_average"] < before["all_time_peak_average"]
    for name in ("office_charger", "shop_charger"):  # both runs have the same vehicles, and all are charged
        energy = [run[f"feeder.{name}_power"].sum() for run in (uncontrolled, coordinated)]
        np.testing.assert_allclose(energy[0], energy[1], rtol=1e-6)
        assert coordinated[f"feeder.{name}_unmet"].max() == pytest.approx(0.0, abs=1.0)
    assert "identical: 384 steps" in done.stdout
    assert (scratch / "out" / "district.png").stat().st_size > 20_000
    assert yaml12.read_mapping(scratch / "out" / "district.yaml")["name"] == "district"
