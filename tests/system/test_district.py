"""Districts in real processes: exact, recorded, killed, and with plants that are lost."""

import importlib.util
import json
import re
import shutil
import signal
import threading
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from support.nodes import NodeProgram, programs_of, until
from support.run_cli import run_python
from zenoh.handlers import FifoChannel

import zenostat
from zenostat.bridge.recording.reader import RecordingReader
from zenostat.bridge.runtime.scratch import sweep
from zenostat.cosim.coupled import GuardedPlant
from zenostat.cosim.file import OnLost
from zenostat.cosim.node_plant import FoundPlant
from zenostat.cosim.verify_recording import verify_district
from zenostat.evaluation import connection_balances
from zenostat.recording import load
from zenostat.topics import codec, keys
from zenostat.topics.errors import EngineDied, InvalidConfig, InvalidRecording, RequestRejected, UnknownName
from zenostat.topics.messages import Event, EventKind, Flag, Mode, Reset, State

EXAMPLES = Path(__file__).parents[2] / "examples"
PLANTS = """
class House:
    step_s, duration_s, forkable = 900.0, 9000.0, True
    sensors = {"temperature": "degC", "demand": "W"}
    meters = {"heat": "J"}
    actuators = {"supply": ("kW", 0.0, 20.0, 0.0), "outdoor": ("degC", -30.0, 40.0, 0.0)}

    def reset(self, seed):
        self.temperature = 20.0 + seed % 7 / 7
        return self.values(0.0)

    def step(self, commands):
        heat = 1000.0 * commands["supply"]
        self.temperature += (heat - 200.0 * (self.temperature - commands["outdoor"])) * 900.0 / 1e7
        return self.values(heat)

    def values(self, heat):
        demand = min(max(2000.0 * (21.0 - self.temperature) + 3000.0, 0.0), 20000.0)
        return {"temperature": self.temperature, "demand": demand, "heat": 900.0 * heat}

class Boiler:
    step_s, duration_s, forkable = 900.0, 9000.0, True
    sensors = {"power": ("W", 0.0, 1e5)}
    actuators = {"demand": ("W", 0.0, 15000.0, 0.0)}

    def reset(self, seed):
        return {"power": 0.0}

    def step(self, commands):
        return {"power": 0.95 * commands["demand"]}

class Uncopied(Boiler):
    forkable = False
"""
PAIR = """name: pair
plants:
  boiler: {plant: "plants.py:Boiler"}
  house: {plant: "plants.py:House"}
connections:
  - {from: boiler.power, to: house.supply}
  - {from: house.demand, to: boiler.demand, delay: 1}
"""
SOLVED = PAIR.replace("delay: 1", "solve: true, tolerance: 0.001")
STEPS = 10
LONG = PLANTS.replace("9000.0", "9e6")
"""The plants with an episode that outlasts a wait for a node."""


def district(folder: Path, text: str = PAIR) -> Path:
    (folder / "plants.py").write_text(PLANTS)
    (folder / "district.yaml").write_text(text)
    return folder / "district.yaml"


@contextmanager
def running(folder: Path, file: Path, **settings: Any) -> Iterator[tuple[NodeProgram, zenostat.Bus, str]]:
    """A district as a program, a bus that is connected to it, and its node's name."""
    name = settings.setdefault("name", "pair")
    with (
        NodeProgram(folder / "node", module="zenostat.cosim", district=str(file), **settings) as program,
        zenostat.connect(program.endpoint, affinity="off") as bus,
    ):
        yield program, bus, name


def episode(link: zenostat.ControllerLink, seed: int = 3, outdoor: float = -4.0) -> list[bytes]:
    """The values of all samples of an episode in which a controller sets the outdoor temperature."""
    sample = link.reset(seed=seed)
    values = [sample.message.values]
    while not sample.truncated:
        sample.send({"house.outdoor": outdoor + sample.step})
        sample = link.receive()
        values.append(sample.message.values)
    return values


def module_of(path: Path) -> Any:
    spec = importlib.util.spec_from_file_location("district_plants", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_district__equals_its_plants_called_by_hand_to_the_bit(scratch: Path) -> None:
    """The example, simulated by its command; and its classes, called in the order of their connections."""
    path = scratch / "run.mcap"
    arguments = ["cosim", str(EXAMPLES / "district.yaml"), "--once", "--record", str(path)]
    arguments += ["--listen", f"unixsock-stream/{scratch}/bus"]
    done = run_python("-P", "-m", "zenostat.cli.main", *arguments)
    assert done.returncode == 0, done.stderr
    assert "heat_pump.heat-old_house.heat_supply" in done.stdout
    (recorded,) = load(path).episodes
    plants = module_of(EXAMPLES / "district_plants.py")
    pump, old, new = plants.HeatPump(), plants.House(220.0), plants.House(90.0)
    names = ("old_house.temperature", "new_house.temperature", "heat_pump.cop")
    columns = np.column_stack([recorded[name] for name in names])
    first = columns[0]
    values = [pump.reset(0), old.reset(round(first[0]) - 18), new.reset(round(first[1]) - 18)]
    fixed = {"setpoint": 21.0, "outdoor": -5.0}
    for row in columns[1:]:
        demand = values[1]["demand"] * 0.001 + values[2]["demand"] * 0.001
        of_pump = {"demand": min(demand, 12.0), "flow_temperature": values[1]["flow_temperature"], "outdoor": -5.0}
        heat = pump.step(of_pump)
        supplies = [min(part * 1000.0 * heat["heat"], 12000.0) for part in (0.667, 0.333)]
        values = [
            heat,
            *(house.step({"heat_supply": s, **fixed}) for house, s in zip((old, new), supplies, strict=True)),
        ]
        assert (values[1]["temperature"], values[2]["temperature"], heat["cop"]) == tuple(row)


@pytest.mark.slow
def test_district__feeder_carries_what_a_house_demands(scratch: Path) -> None:
    """The powers of a grid balance: what it imports is what its loads take and what it loses."""
    pytest.importorskip("power_grid_model")
    for name in ("feeder.yaml", "feeder.csv"):
        shutil.copy(EXAMPLES / name, scratch)
    text = """name: pair
timestep: 15min
duration: 2.5h
plants:
  feeder: {grid: feeder.yaml}
  house: {plant: "plants.py:House"}
connections:
  - {from: house.demand, to: feeder.office_demand}
"""
    with running(scratch, district(scratch, text)) as (_, bus, name), bus.controller(name) as link:
        values = episode(link)
        rows = dict(zip(link.manifest.names, np.array([np.frombuffer(row) for row in values]).T, strict=True))
    demand = rows["house.demand"][1:]
    assert np.ptp(demand) > 10.0
    assert (rows["feeder.office_power"][1:] == demand).all()
    taken = sum(
        rows[f"feeder.{load}_power"] for load in ("homes", "office", "battery", "home_charger", "office_charger")
    )
    balance = taken + rows["feeder.losses"] - rows["feeder.roof_power"]
    assert rows["feeder.import"] - rows["feeder.export"] == pytest.approx(balance, abs=1e-3)


@pytest.mark.slow
def test_district__sensor_that_is_lost_holds_its_last_value_and_is_verified(scratch: Path) -> None:
    """The fault `drop` on a plant's sensor: its reader goes on with the last value, and a verification repeats that."""
    (scratch / "drop.yaml").write_text(
        "seed: 1\nfaults:\n  - {name: lost, kind: drop, points: power, when: {probability: 0.5, lasts_steps: 1}}\n"
    )
    path = scratch / "drop.mcap"
    file = district(scratch, PAIR.replace('py:Boiler"', 'py:Boiler", faults: drop.yaml'))
    with running(scratch, file, record=str(path)) as (_, bus, name), bus.controller(name) as link:
        values = episode(link)
        rows = dict(zip(link.manifest.names, np.array([np.frombuffer(row) for row in values]).T, strict=True))
    power, supply = rows["boiler.power"], rows["exchange.boiler.power-house.supply"]
    missing = np.isnan(power[1:])
    assert 0 < missing.sum() < STEPS
    assert np.isfinite(supply[2:]).all()
    assert (supply[2:][missing[1:]] == supply[1:-1][missing[1:]]).all()
    recorded = load(path).episodes[-1]
    balance = next(each for each in connection_balances(recorded) if each.name == "boiler.power-house.supply")
    assert balance.missing_steps == missing.sum()
    assert abs(balance.closure) <= 1e-9
    result = verify_district(path, file)
    assert result.passed, str(result)


@pytest.mark.slow
def test_district__controller_reset_and_solved_loop(scratch: Path) -> None:
    """Equal seeds and commands have equal trajectories; each step of the loop is solved within its tolerance."""
    with running(scratch, district(scratch, SOLVED)) as (_, bus, name), bus.controller(name) as link:
        manifest = link.manifest
        assert [actuator.name for actuator in manifest.actuators] == ["house.outdoor"]
        values = episode(link)
        assert episode(link) == values
        assert episode(link, outdoor=5.0) != values
        table = np.array([np.frombuffer(row) for row in values])
        rows = dict(zip(manifest.names, table.T, strict=True))
        assert len(values) == STEPS + 1
        assert (rows["loop.boiler-house.solved"] == 1.0).all()
        assert (np.abs(rows["residual.house.demand-boiler.demand"]) <= 0.001).all()
        power, demand = rows["boiler.power"][1:], rows["house.demand"][1:]
        assert np.abs(power - 0.95 * demand).max() <= 0.001
        assert rows["exchange.boiler.power-house.supply"][1:] == pytest.approx(power / 1000.0, rel=1e-12)
        assert rows["loop.boiler-house.trials"][1:].max() <= 3.0  # the loop is linear
        link.reset()
        bus.drop(name, bus.snapshot(name).snapshot)


@pytest.mark.slow
def test_district__log_has_its_events(scratch: Path) -> None:
    arguments = [
        "--log",
        "json",
        "cosim",
        str(district(scratch)),
        "--once",
        "--listen",
        f"unixsock-stream/{scratch}/bus",
    ]
    done = run_python("-P", "-m", "zenostat.cli.main", *arguments)
    assert done.returncode == 0, done.stderr
    entries = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    (ended,) = [entry for entry in entries if entry.get("kind") == "ended"]
    assert (ended["node"], ended["level"], ended["step"]) == ("pair", "info", STEPS)


@pytest.mark.slow
def test_district__connected_input_names_its_source_to_all_who_command_it(scratch: Path) -> None:
    text = "'house.supply' cannot be commanded: it is connected to boiler.power"
    with running(scratch, district(scratch)) as (_, bus, name):
        assert bus.manifest(name).connected == {"house.supply": "boiler.power", "boiler.demand": "house.demand"}
        with pytest.raises(UnknownName, match=text):
            bus.write(name, "house.supply", 2.0)
        with pytest.raises(RequestRejected, match=text), bus.controller(name, actuators=["house.supply"]):
            pass


def has_ended(process: psutil.Process) -> bool:
    """Whether a process has ended, though its parent may not know it yet."""
    try:
        return process.status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


@pytest.mark.slow
def test_district__killed_leaves_no_process_and_verifies_up_to_its_end(scratch: Path) -> None:
    path, file = scratch / "killed.mcap", district(scratch)
    with running(scratch, file, record=str(path)) as (program, bus, name):
        with bus.controller(name) as link:
            sample = link.current()
            for _ in range(6):
                sample.send({"house.outdoor": -7.0})
                sample = link.receive()

            def written() -> int:
                with RecordingReader(path) as reader:
                    return sum(1 for _ in reader.messages({"Sample"}))

            until(lambda: path.stat().st_size > 1000 and written() == 7, "the last chunk is written")
        program.process.send_signal(signal.SIGKILL)
        program.process.wait()
        until(lambda: not programs_of(scratch), "all plants have ended")
        shutil.rmtree(program.folder)  # its socket, which a killed node cannot remove
    sweep()
    result = verify_district(path, file)
    assert result.passed, str(result)
    assert result.steps == 6
    (scratch / "plants.py").write_text(PLANTS + "\n")
    with pytest.raises(InvalidRecording, match=r"the plant of boiler .*plants\.py has changed"):
        verify_district(path, file)


@pytest.mark.slow
def test_district__lost_plant_comes_back_to_the_bit(scratch: Path) -> None:
    """The node of a plant is killed at step 4: the district waits, starts it again, and continues as if nothing was."""
    file = district(scratch, PAIR.replace("name: pair", "name: pair\non_lost: wait"))
    with running(scratch, file) as (program, bus, name), bus.controller(name) as link:
        expected = episode(link)
        sample = link.reset(seed=3)
        values = [sample.message.values]
        with bus.listen(name):
            while not sample.truncated:
                if sample.step == 4:
                    nodes = [
                        p for p in psutil.Process(program.pid).children() if "bridge.python_plant" in p.cmdline()[-1]
                    ]
                    nodes[0].kill()
                    until(partial(has_ended, nodes[0]), "the node has ended")
                sample.send({"house.outdoor": -4.0 + sample.step})
                sample = link.receive()
                values.append(sample.message.values)
        assert values == expected


@pytest.mark.slow
@pytest.mark.parametrize("text", [PAIR, SOLVED], ids=["delayed", "solved"])
def test_district__recording_of_a_lost_plant_is_verified_to_its_end(scratch: Path, text: str) -> None:
    """The node of a plant is killed at step 4, and its last values hold; the verification repeats that."""
    path = scratch / "lost.mcap"
    file = district(scratch, text.replace("name: pair", "name: pair\non_lost: continue"))
    with running(scratch, file, record=str(path)) as (program, bus, name), bus.controller(name) as link:
        sample = link.reset(seed=3)
        while not sample.truncated:
            if sample.step == 4:
                nodes = [p for p in psutil.Process(program.pid).children() if "bridge.python_plant" in p.cmdline()[-1]]
                nodes[0].kill()
                until(partial(has_ended, nodes[0]), "the node has ended")
            sample.send({"house.outdoor": -4.0 + sample.step})
            sample = link.receive()
        (lost,) = [plant for plant in ("boiler", "house") if sample[f"plant.{plant}.available"] == 0.0]
    result = verify_district(path, file)
    assert result.passed, str(result)
    assert result.steps >= STEPS
    assert f"plant {lost!r} was lost in 6 steps by the recording; its last values held" in result.notes


@pytest.mark.slow
def test_district__lost_plant_stops_the_episode_and_a_reset_begins_another(scratch: Path) -> None:
    with running(scratch, district(scratch)) as (program, bus, name), bus.controller(name) as link:
        expected = episode(link)
        sample = link.reset(seed=3)
        for child in psutil.Process(program.pid).children():
            child.kill()
        sample.send({"house.outdoor": -4.0})
        with pytest.raises(EngineDied, match=r"plant '(boiler|house)': node 'pair.(boiler|house)' is gone"):
            link.receive()
        assert bus.status(name).state is State.FAILED
        assert episode(link) == expected


def boiler_and_house_on_a_bus(scratch: Path) -> Path:
    """A district that waits for its house, a node on a bus of its own, if that is lost."""
    text = f"""name: pair
on_lost: wait
plants:
  boiler: {{plant: "plants.py:Boiler"}}
  house: {{node: home, connect: unixsock-stream/{scratch}/home/bus}}
connections:
  - {{from: boiler.power, to: house.supply}}
  - {{from: house.demand, to: boiler.demand, delay: 1}}
"""
    return district(scratch, text)


@pytest.mark.slow
def test_district__plant_on_a_bus_that_is_restarted(scratch: Path) -> None:
    """A plant that somebody else runs: it is controlled, left alone at the end, and awaited when it is restarted."""
    file = boiler_and_house_on_a_bus(scratch)
    home: dict[str, Any] = {"plant": f"{scratch}/plants.py:House", "name": "home"}
    with ExitStack() as stack:
        first = stack.enter_context(NodeProgram(scratch / "home", **home))
        with running(scratch, file) as (_, bus, name), bus.controller(name) as link:
            expected = episode(link)
            sample = link.reset(seed=3)
            values = [sample.message.values]
            while not sample.truncated:
                if sample.step == 4:
                    first.kill()
                sample.send({"house.outdoor": -4.0 + sample.step})
                if sample.step == 4:
                    second = stack.enter_context(NodeProgram(scratch / "home", **home))
                sample = link.receive()
                values.append(sample.message.values)
            assert values == expected
        with zenostat.connect(second.endpoint, affinity="off") as home_bus:
            assert home_bus.status("home").state is State.ENDED  # the district has left it as it was


@pytest.mark.slow
def test_district__search_for_a_lost_node_does_not_delay_steps(scratch: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A search that does not end, as where a machine does not answer; the plant is back after one that does."""
    (scratch / "plants.py").write_text(LONG)
    home: dict[str, Any] = {"plant": f"{scratch}/plants.py:House", "name": "home"}
    searching, answers = threading.Event(), threading.Event()
    open_bus = FoundPlant.open_bus

    def slow(plant: FoundPlant) -> zenostat.Bus:
        if threading.current_thread() is not threading.main_thread():
            searching.set()
            answers.wait()
        return open_bus(plant)

    with ExitStack() as stack:
        first = stack.enter_context(NodeProgram(scratch / "home", **home))
        plant = stack.enter_context(closing(FoundPlant("home", first.endpoint, None)))
        stack.callback(answers.set)
        monkeypatch.setattr(FoundPlant, "open_bus", slow)
        guarded = GuardedPlant("house", plant, OnLost.GO_ON, timeout_s=60.0, stop=threading.Event())
        guarded.reset(3)

        def step() -> bool:
            guarded.begin(np.array([[5.0, -4.0]]))
            guarded.finish()
            return guarded.is_available

        first.kill()
        assert not any(step() for _ in range(20))
        assert searching.wait(60.0)
        stack.enter_context(NodeProgram(scratch / "home", **home))
        answers.set()
        until(step, "the plant is back")


@pytest.mark.parametrize("pace", [{"mode": "free"}, {"mode": "paced", "speed": 1e5}])
def test_district__plant_on_a_bus_that_somebody_paces_is_lost(scratch: Path, pace: dict[str, Any]) -> None:
    """It would go on without the commands, and have samples of long ago; once more in lockstep, it is back."""
    (scratch / "plants.py").write_text(LONG)
    with ExitStack() as stack:
        program = stack.enter_context(NodeProgram(scratch / "home", plant=f"{scratch}/plants.py:House", name="home"))
        plant = stack.enter_context(closing(FoundPlant("home", program.endpoint, None)))
        bus = stack.enter_context(zenostat.connect(program.endpoint, affinity="off"))
        guarded = GuardedPlant("house", plant, OnLost.WAIT, timeout_s=60.0, stop=threading.Event())
        guarded.reset(3)

        def step() -> np.ndarray:
            guarded.begin(np.array([[5.0, -4.0]]))
            return guarded.finish().values[-1]

        expected = [step() for _ in range(6)]
        guarded.reset(3)
        received = [step() for _ in range(2)]
        bus.pace("home", source="ada", **pace)
        until(lambda: bus.latest("home").step[0] > 2, "it goes on by itself")
        received += [step() for _ in range(4)]
        assert np.array_equal(received, expected)
        (warning,) = guarded.drain_warnings()
        assert "was lost, and is back" in warning
        assert f"node 'home' was set to the mode {pace['mode']} by ada, and does not wait for the district" in warning
        assert bus.manifest("home").mode is Mode.LOCKSTEP


def test_district__plant_on_a_bus_that_goes_on_after_its_deadline_is_lost(scratch: Path) -> None:
    """It does not wait for the district's command, which is late then; once more from the beginning, it has all."""
    (scratch / "plants.py").write_text(LONG)
    settings: dict[str, Any] = {"plant": f"{scratch}/plants.py:House", "deadline_s": 0.3, "policy": "hold"}
    with ExitStack() as stack:
        home = stack.enter_context(NodeProgram(scratch / "home", **settings, name="home"))
        alone = stack.enter_context(NodeProgram(scratch / "alone", plant=settings["plant"], name="alone"))
        bus = stack.enter_context(zenostat.connect(home.endpoint, affinity="off"))

        def guarded(program: NodeProgram) -> GuardedPlant:
            plant = stack.enter_context(closing(FoundPlant(program.name, program.endpoint, None)))
            return GuardedPlant("house", plant, OnLost.WAIT, timeout_s=60.0, stop=threading.Event())

        def step(plant: GuardedPlant, outdoor: float) -> np.ndarray:
            plant.begin(np.array([[5.0, outdoor]]))
            return plant.finish().values[-1]

        house, reference = guarded(home), guarded(alone)
        house.reset(3), reference.reset(3)
        until(lambda: bus.latest("home").step[0] > 2, "it goes on by itself")
        for outdoor in (-4.0, 7.0, 1.0):
            assert np.array_equal(step(house, outdoor), step(reference, outdoor))
        warnings = house.drain_warnings()
        assert warnings
        for text in warnings:
            assert re.search(r"without the district's command, .* by its deadline; its policy is hold$", text), text


@pytest.mark.slow
def test_district__plant_on_a_bus_that_misses_another_controller_is_not_lost(scratch: Path) -> None:
    (scratch / "plants.py").write_text(LONG)
    settings: dict[str, Any] = {"plant": f"{scratch}/plants.py:House", "deadline_s": 4.0, "policy": "hold"}
    with (
        NodeProgram(scratch / "home", **settings, name="home") as home,
        closing(FoundPlant("home", home.endpoint, None)) as plant,
        zenostat.connect(home.endpoint, affinity="off") as bus,
    ):
        plant.reset(3)
        with bus.controller("home", name="silent", priority=12):
            plant.begin(np.array([[5.0, -4.0]]))
            plant.finish()
        assert bus.latest("home").flags[0] & Flag.FALLBACK


@pytest.mark.slow
def test_district__says_for_which_controller_of_a_plants_bus_it_waits(scratch: Path) -> None:
    """The plant's node waits for one that has ended, by its policy, and so does the district, which a reset frees."""
    file = boiler_and_house_on_a_bus(scratch)
    with (
        NodeProgram(scratch / "home", plant=f"{scratch}/plants.py:House", name="home") as home,
        zenostat.connect(home.endpoint, affinity="off") as home_bus,
        running(scratch, file) as (_, bus, name),
        bus.controller(name) as link,
        bus.session.declare_subscriber(keys.EVENT.at(name), FifoChannel(1000)) as events,
    ):
        expected = episode(link)
        sample = link.reset(seed=3)
        values = [sample.message.values]
        while sample.step < 4:
            sample.send({"house.outdoor": -4.0 + sample.step})
            sample = link.receive()
            values.append(sample.message.values)
        with home_bus.controller("home", name="fmi", priority=12) as other:
            pass
        reason = (
            f"plant 'house' does not go on: node 'home' waits for {other.name!r}, which is disconnected (policy wait)"
        )
        while not sample.truncated:
            sample.send({"house.outdoor": -4.0 + sample.step})
            if sample.step == 4:
                until(lambda: bus.status(name).waiting == reason, "the status has the reason")
                home_bus.reset("home", Reset(controller="panel"))
            sample = link.receive()
            values.append(sample.message.values)
        assert bus.status(name).waiting == ""
        texts = [codec.decode(Event, message.payload.to_bytes()).text for message in iter(events.try_recv, None)]
    assert [text for text in texts if "does not go on" in text] == [reason]
    assert values == expected


def test_district__commands_of_others_on_a_plants_bus_are_an_event(scratch: Path) -> None:
    """An event names who has begun to command in place of the district; not where the district commands nothing."""
    (scratch / "plants.py").write_text(LONG)
    with (
        NodeProgram(scratch / "home", plant=f"{scratch}/plants.py:House", name="home") as home,
        closing(FoundPlant("home", home.endpoint, None, "district-pair")) as plant,
        zenostat.connect(home.endpoint, affinity="off") as bus,
    ):
        plant.reset(3)
        texts = {}
        for step in range(1, 6):
            if step == 2:
                bus.write("home", "supply", 7.0, source="ada")
                bus.write("home", "outdoor", 1.0, source="ada")
            if step == 4:
                bus.write("home", "supply", None, source="ada")
            plant.begin(np.array([[5.0, np.nan if step < 5 else -4.0]]))
            assert plant.finish().effective[-1, 0] == (7.0 if step in (2, 3) else 5.0)
            texts[step] = plant.drain_warnings()
        expected = "ada commands {} of node 'home' at a higher priority: its value is {} and not the district's {}"
        assert texts == {
            1: [],
            2: [expected.format("'supply'", "7 in timestep 2", 5)],
            3: [],
            4: [],
            5: [expected.format("'outdoor'", "1 in timestep 5", -4)],
        }
        with pytest.raises(RequestRejected, match=r"is claimed by 'district-pair-\d+-\d+'"):
            bus.controller("home", name="district-other")


@pytest.mark.slow
def test_district__reset_of_one_that_waits_for_a_paused_plant_begins_an_episode(scratch: Path) -> None:
    """A plant that is paused on its own bus holds the district; the reset gives up the step and resets the plant."""
    text = PAIR.replace('{plant: "plants.py:House"}', f"{{node: home, connect: unixsock-stream/{scratch}/home/bus}}")
    file = district(scratch, text)
    with (
        NodeProgram(scratch / "home", plant=f"{scratch}/plants.py:House", name="home") as home,
        zenostat.connect(home.endpoint, affinity="off") as home_bus,
        running(scratch, file) as (_, bus, name),
        bus.controller(name) as link,
    ):
        expected = episode(link)
        sample = link.reset(seed=3)
        home_bus.pause("home", source="ada")
        sample.send({"house.outdoor": -4.0})
        until(lambda: bus.status(name).state is State.RUNNING, "the district waits for the plant")
        bus.reset(name, Reset(controller="ada", seed=3))
        with pytest.raises(EngineDied, match=r"^a reset had waited for 10 s for the end of its timestep$"):
            link.receive()
        until(lambda: bus.status(name).state is State.WAITING, "the new episode has begun")
        assert home_bus.latest("home").step == [0]
        home_bus.resume("home")
        assert episode(link) == expected


def test_district__plant_on_a_bus_whose_timestep_does_not_end_is_reset(scratch: Path) -> None:
    """Its node would answer a claim after its timestep only; a reset gives that up."""
    stuck = LONG.replace(
        "    def step(self, commands):\n        heat",
        """    def step(self, commands):
        while commands["supply"] > 10.0:
            pass
        heat""",
    )
    (scratch / "stuck.py").write_text(stuck)
    with (
        NodeProgram(scratch / "home", plant=f"{scratch}/stuck.py:House", name="home", unresponsive_s=2.0) as home,
        closing(FoundPlant("home", home.endpoint, None)) as plant,
        zenostat.connect(home.endpoint, affinity="off") as bus,
    ):
        expected = plant.reset(3)
        plant.begin(np.array([[15.0, 0.0]]))
        until(lambda: bus.status("home").state is State.RUNNING, "the timestep has begun")
        plant.interrupt()
        assert np.array_equal(plant.reset(3).values, expected.values)


@pytest.mark.slow
def test_district__plant_on_a_bus_that_another_one_replaces(scratch: Path) -> None:
    """A node with other points does not get the commands of the one before; one that fits does."""
    home = {"name": "home"}
    (scratch / "plants.py").write_text(LONG)
    swapped = LONG.replace("class House:", "class Swapped:").replace(
        """{"supply": ("kW", 0.0, 20.0, 0.0), "outdoor": ("degC", -30.0, 40.0, 0.0)}""",
        """{"outdoor": ("degC", -30.0, 40.0, 0.0), "supply": ("kW", 0.0, 20.0, 0.0)}""",
    )
    (scratch / "swapped.py").write_text(swapped)
    with ExitStack() as stack:
        first = stack.enter_context(NodeProgram(scratch / "home", plant=f"{scratch}/plants.py:House", **home))
        with closing(FoundPlant("home", first.endpoint, None)) as plant:
            guarded = GuardedPlant("house", plant, OnLost.GO_ON, timeout_s=60.0, stop=threading.Event())
            guarded.reset(3)
            commands = np.array([[5.0, -4.0]])

            def step() -> bool:
                guarded.begin(commands)
                guarded.finish()
                return guarded.is_available

            assert step()
            first.kill()
            assert not step()
            second = stack.enter_context(NodeProgram(scratch / "home", plant=f"{scratch}/swapped.py:Swapped", **home))
            warnings: list[str] = []

            def refused() -> bool:
                assert not step()
                warnings.extend(guarded.drain_warnings())
                return any("does not fit" in text for text in warnings)

            until(refused, "the other node is refused")
            assert not step()
            (refusal,) = [text for text in [*warnings, *guarded.drain_warnings()] if "does not fit" in text]
            expected = "plant 'house' cannot come back, and its last values hold: node 'home' was replaced by one that "
            assert refusal == f"{expected}does not fit: actuators: 'outdoor' in place of 'supply'"
            with zenostat.connect(second.endpoint, affinity="off") as bus:
                until(lambda: bus.controllers() == [], "the orchestrator has left it")
            second.close()
            stack.enter_context(NodeProgram(scratch / "home", plant=f"{scratch}/plants.py:House", **home))
            until(step, "the plant is back")


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize(
    ("text", "error", "expected"),
    [
        (
            PAIR.replace("house.supply", "house.outdoor"),
            InvalidConfig,
            r"district.yaml:6: boiler.power is in W and house.outdoor in degC, which are unlike",
        ),
        (
            SOLVED.replace("py:Boiler", "py:Uncopied"),
            InvalidConfig,
            r"district.yaml:7: loop 'boiler-house' cannot be solved by trials: plant 'boiler': .*cannot be copied: "
            r"(.|\n)*; `delay: 1` in place of `solve` needs no trials",
        ),
        (PAIR.replace("py:Boiler", "py:Boyler"), InvalidConfig, r"district.yaml:3: plant 'boiler': .*Boyler"),
    ],
)
def test_district__errors_of_plants_have_their_line_and_leave_nothing(
    scratch: Path, text: str, error: type[Exception], expected: str
) -> None:
    with pytest.raises(error, match=expected):
        NodeProgram(scratch / "node", module="zenostat.cosim", district=str(district(scratch, text)), check=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("reward", "expected"),
    [
        ("{kind: nonsense, foo: 1}", "district.yaml:2: .*nonsense"),
        ("{kind: district, consumption: house.powr}", "district.yaml:2: .*house.powr"),
    ],
)
def test_district__reward_is_checked_with_the_points(scratch: Path, reward: str, expected: str) -> None:
    file = district(scratch, PAIR.replace("name: pair\n", f"name: pair\nreward: {reward}\n"))
    done = run_python("-P", "-m", "zenostat.cli.main", "cosim", str(file), "--check")
    assert done.returncode != 0
    assert re.search(expected, done.stderr), done.stderr


@pytest.mark.slow
def test_district__check_prints_warnings(scratch: Path) -> None:
    file = district(scratch)
    summer = PLANTS.replace("class House:", 'class House:\n    begin = "2026-07-01T12:00"')
    (scratch / "plants.py").write_text(summer)
    done = run_python("-P", "-m", "zenostat.cli.main", "cosim", str(file), "--check")
    assert done.returncode == 0, done.stderr
    assert "district.yaml:4: plant 'house' begins at 2026-07-01 12:00, the district at 2001-01-01 00:00" in done.stdout


@pytest.mark.slow
def test_district__unsolved_step_is_an_event(scratch: Path) -> None:
    """Staged equipment: full power below 5 kW of its own power, none above."""
    staged = """
class Staged:
    step_s, duration_s, forkable = 900.0, 2700.0, True
    sensors = {"power": "kW"}
    actuators = {"limit": ("kW", 0.0, 10.0, 0.0)}

    def reset(self, seed):
        return {"power": 0.0}

    def step(self, commands):
        return {"power": 10.0 if commands["limit"] < 5.0 else 0.0}
"""
    text = """plants: {stage: {plant: "staged.py:Staged"}}
connections:
  - {from: stage.power, to: stage.limit, solve: true, tolerance: 0.1}
"""
    (scratch / "staged.py").write_text(staged)
    path = scratch / "staged.mcap"
    with running(scratch, district(scratch, text), name="staged", record=str(path), mode="free") as (_, bus, name):
        until(lambda: bus.status(name).state is State.ENDED, "the episode is over")
        sample = bus.read(name)
        assert sample["loop.stage.unsolved_steps"] == 3.0
        assert sample["loop.stage.solved"] == 0.0
        assert abs(sample["residual.stage.power-stage.limit"]) == pytest.approx(5.0, abs=0.1)
        bus.stop(name)
    with RecordingReader(path) as reader:
        events = [codec.decode(Event, item.payload) for item in reader.messages({"Event"})]
    texts = [event.text for event in events if event.kind is EventKind.WARNING]
    assert len([each for each in texts if each.startswith("loop 'stage' is not solved in step")]) == 3
