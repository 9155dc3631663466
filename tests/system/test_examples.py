"""The examples run by themselves."""

import re
import runpy
import signal
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from support import data_packs as packs
from support.nodes import SMALL, NodeProgram

from zenostat.agent_sdk.testing import check_plant

EXAMPLES = Path(__file__).parents[2] / "examples"


def _run(name: str, *arguments: str) -> str:
    command = [sys.executable, str(EXAMPLES / name), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_examples__gymnasium_environment(scratch):
    output = _run("gymnasium_environment.py", "--days", "1")
    assert "96 timesteps to 2017-07-02T00:00:00" in output
    assert "{'heating': 20.0, 'cooling': 25.0}" in output


@pytest.mark.slow
def test_examples__recording(scratch):
    output = _run("recording.py", "--out", str(scratch / "run.mcap"))
    assert "identical: 144 steps" in output
    assert "episode 1, seed 1, USA_CO_Denver: 145 samples" in output
    assert re.search(r"setpoint [\d.]+ degC, set by env-", output)
    assert re.search(r"env-\S+: command answers step \[0\] of episode \[1\], 144 times, accepted", output)
    with (scratch / "run.csv").open() as table:
        assert len(table.readlines()) == 1 + 1 + 145  # with the sample of the episode that the reset replaced


@pytest.mark.slow
def test_examples__own_plant_controller():
    """A cooler tank has a lower lift, so a higher COP; both keep the room warm, so both need the same heat."""
    output = _run("own_plant_controller.py")
    rows = re.findall(r"^(.+): ([\d.]+) kWh, ([\d.]+) K h too cold at (\S+)$", output, flags=re.MULTILINE)
    assert [(name, cold, end) for name, _, cold, end in rows] == [
        ("tank at 50 degC", "0.00", "2026-01-14T00:00:00"),
        ("curve", "0.00", "2026-01-14T00:00:00"),
    ]
    hot, curve = (float(kwh) for _, kwh, _, _ in rows)
    assert 0.0 < curve < hot


@pytest.mark.slow
def test_examples__boptest_client():
    """With setpoints 1 to 3 K lower by day, the building uses more energy than under the baseline control."""
    pytest.importorskip("fastapi", reason="fastapi is not installed")
    from support.boptest import serving

    with serving() as client:
        output = _run("boptest_client.py", client.url)
    assert f"at time {200 * 86400}\n" in output
    controlled, baseline = re.search(r"ener_tot: ([\d.]+), baseline control ([\d.]+)", output).groups()
    assert 0.0 < float(baseline) != float(controlled) > 0.0


def test_examples__array_plant(scratch):
    """Two slots with a heater at 0 and 800 W: each tank is where the exponential solution says."""
    endpoint = f"unixsock-stream/{scratch}/bus"
    command = [sys.executable, str(EXAMPLES / "array_plant.py"), "--slots", "2", "--listen", endpoint]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as node:
        try:
            assert node.stdout.readline() == f"tanks on {endpoint}\n"
            with closing(gym.make_vec("zenostat/Plant-v1", 2, connect=endpoint, node="tanks", reward=None)) as envs:
                start, _ = envs.reset(seed=1)
                power = np.array([[0.0], [800.0]], np.float32)
                for _ in range(60):
                    values, *_ = envs.step(power)
        finally:
            node.send_signal(signal.SIGINT)
    steady = 20.0 + power[:, 0] / 2.0
    assert np.allclose(values[:, 0], steady + (start[:, 0] - steady) * np.exp(-3600.0 * 2.0 / 8.4e5), atol=1e-4)
    assert values[:, 1].tolist() == [0.0, 48000.0]
    assert node.returncode == 0


def test_examples__own_plant_keeps_the_rules_of_plants():
    assert not check_plant(f"{EXAMPLES}/own_plant.py:HeatPumpRoom", max_steps=2880).skipped


def test_examples__own_plants_heat_balance():
    """In steady state the radiators give what the walls lose, and the compressor's heat equals both."""
    plant = runpy.run_path(str(EXAMPLES / "own_plant.py"))
    room = plant["HeatPumpRoom"]()
    room.reset(seed=0)
    room.amplitude = 0.0
    for _ in range(20_000):
        values = room.step({"compressor": 900.0, "circulation": 0.8})
    radiators = 0.8 * plant["RADIATOR_W_K"] * (values["tank_temperature"] - values["room_temperature"])
    walls = plant["WALL_W_K"] * (values["room_temperature"] - values["outdoor_temperature"])
    assert radiators == pytest.approx(walls, rel=1e-6)
    assert values["cop"] * 900.0 == pytest.approx(walls, rel=1e-6)
    assert values["electricity"] == 900.0 * 60.0


@pytest.mark.slow
def test_examples__controller_on_the_bus(scratch):
    with NodeProgram(scratch / "node", **SMALL) as node:
        output = _run("controller_on_the_bus.py", "--connect", node.endpoint)
    assert "96 timesteps" in output
    assert "value source of the core cooling setpoint: saver-" in output


@pytest.mark.slow
def test_examples__mpc_by_branching(scratch):
    """After the first moves it follows the rules, so that it is never worse than they are."""
    packs.sinergym()
    output = _run(
        "mpc_by_branching.py", "--days", "1", "--hours", "2", "--moves", "2", "--plot", str(scratch / "a.png")
    )
    rows = re.findall(r"^(\S.*?) {2,}(-[\d.]+) ", output, flags=re.MULTILINE)
    rewards = {name: float(reward) for name, reward in rows}
    assert rewards["MPC by branching"] >= rewards["rbc, setback=0"] > rewards["rbc"]
    assert "2 moves" in output
    assert f"{2 * 16 * 2 * 4} branch timesteps" in output  # moves, plans, hours, timesteps an hour
    assert (scratch / "a.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_examples__two_floors(scratch):
    with NodeProgram(scratch / "node", **SMALL, policy="hold", grace_s=2, deadline_s=60) as node:
        output = _run("two_floors.py", "--connect", node.endpoint)
    assert "core_zn_cooling_setpoint by north: 92 timesteps" in output
    assert "core_zn_cooling_setpoint by supervisor: 4 timesteps" in output
    assert output.count(": 96 timesteps") == 4
