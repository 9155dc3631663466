"""The radiant building of the data pack, driven by the same choices here and by EnergyPlus's own Python API alone.

Five of its 83 observations are an integer variable that the API serves and does not list.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from support.data_packs import sinergym
from support.energyplus_alone import run_energyplus
from support.nodes import node_on_bus

from zenostat.models.building.model import for_episode, read_building, write
from zenostat.models.catalog import find_building, find_weather
from zenostat.models.weather import design_days
from zenostat.models.weather.header import read_header
from zenostat.topics.messages import Manifest

DAYS = ("01-15", "01-16")

BARE = """
task = json.load(open(arguments[0]))
for variable, key in task["variables"]:
    exchange.request_variable(state, variable, key)
rows, warm, handles = [], [], {}
def act(state):
    for handle, value in zip(handles["actuators"], task["commands"][len(rows)]):
        exchange.set_actuator_value(state, handle, value)
def begin(state):
    if exchange.kind_of_sim(state) != 3:  # sizing comes before the run period
        return
    handles["actuators"] = [exchange.get_actuator_handle(state, *names) for names in task["actuators"]]
    handles["variables"] = [exchange.get_variable_handle(state, *names) for names in task["variables"]]
    handles["meters"] = [exchange.get_meter_handle(state, name) for name in task["meters"]]
    assert min(handles["actuators"] + handles["variables"]) >= 0
    warm.append(True)
    act(state)
def step(state):
    if warm:
        rows.append([exchange.get_variable_value(state, handle) for handle in handles["variables"]]
                    + [exchange.get_meter_value(state, handle) for handle in handles["meters"]])
        if len(rows) < len(task["commands"]):
            act(state)
runtime.callback_after_new_environment_warmup_complete(state, begin)
runtime.callback_end_zone_timestep_after_zone_reporting(state, step)
"""


@pytest.mark.slow
def test_radiant__trajectory_equals_a_bare_script_in_all_columns(folder: Path) -> None:
    sinergym()
    with (
        node_on_bus(folder, scenario="radiant-stockholm-discrete-v1", begin=DAYS[0], end=DAYS[1]) as (_, bus),
        bus.controller("office") as link,
    ):
        manifest = link.manifest
        draw = np.random.default_rng(5)
        switches = draw.integers(0, 2, (manifest.steps // 6, 5)).repeat(6, axis=0)
        commands = np.column_stack([switches, draw.integers(25, 46, len(switches))]).astype(float)
        names, got = [actuator.name for actuator in manifest.actuators], []
        for sample in link:
            got.append(sample.values)
            if not sample.truncated:
                sample.send(dict(zip(names, commands[sample.step].tolist(), strict=True)))
    expected = _bare(manifest, commands, folder / "bare")
    assert len(got) - 1 == len(expected) == len(commands) == manifest.steps
    for column, name in enumerate(manifest.names):
        assert np.array_equal(np.array(got)[1:, column], expected[:, column]), name
    modes = [i for i, s in enumerate(manifest.sensors) if s.variable == "Zone Radiant HVAC Operation Mode"]
    assert len(modes) == 5
    assert all(set(expected[:, column]) == {0.0, 1.0} for column in modes)


def _bare(manifest: Manifest, commands: np.ndarray, folder: Path) -> np.ndarray:
    """Variables, then meters, at the end of each timestep."""
    model = read_building(find_building(manifest.building))
    weather = find_weather(manifest.weather).path
    period = model.period(*DAYS, round(3600 / manifest.step_s))
    objects = design_days.apply(for_episode(model, period), design_days.site(weather, read_header(weather)))
    folder.mkdir()
    task = folder / "task.json"
    orders = {
        "variables": [(s.variable, s.key) for s in manifest.sensors],
        "meters": [m.meter for m in manifest.meters],
        "actuators": [(a.component_type, a.control_type, a.key) for a in manifest.actuators],
        "commands": commands.tolist(),
    }
    task.write_text(json.dumps(orders))
    save = 'json.dump(rows, open(folder + "/rows.json", "w"))'
    done = run_energyplus(write(objects, folder), weather, folder, str(task), before=BARE, after=save)
    assert done.returncode == 0, done.stderr
    return np.array(json.loads((folder / "rows.json").read_text()))
