"""A real node as an FMU, run by FMPy, an importer that is not ours."""

import os
import shutil
import socket
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from support.gateways import RunningGateway
from support.nodes import NodeProgram, until
from support.run_cli import run_in_process

import zenostat
from zenostat import Bus
from zenostat.topics.errors import ForkFailed
from zenostat.topics.messages import Aggregation, Meter, Sensor

fmpy = pytest.importorskip("fmpy")
validation = pytest.importorskip("fmpy.validation")
if not any(map(shutil.which, ("cc", "gcc", "clang"))):
    pytest.skip("there is no C compiler", allow_module_level=True)

STEP_S, STEPS = 900.0, 96
COOLING = "core_zn_cooling_setpoint"


@pytest.fixture(scope="module")
def gateway(shared_node: NodeProgram) -> Iterator[RunningGateway]:
    with RunningGateway("fmi", "office", "--connect", shared_node.endpoint, "--address", "127.0.0.1:0") as running:
        yield running
        code, out, err = running.end()
    assert code == 0, err
    assert "runs of FMUs" in out


@pytest.fixture(scope="module")
def archive(shared_node: NodeProgram, gateway: RunningGateway, module_folder: Path) -> Path:
    """The FMU of the node, unpacked."""
    file = module_folder / "office.fmu"
    address = f"127.0.0.1:{gateway.port}"
    options = ("--connect", shared_node.endpoint, "--address", address, "--fmu", str(file))
    done = run_in_process("gateway", "fmi", "office", *options)
    assert done.returncode == 0, done.stderr
    assert "21 outputs, 10 actuators; binaries for " in done.stdout
    assert validation.validate_fmu(str(file)) == []
    folder = module_folder / "office"
    fmpy.extract(str(file), unzipdir=str(folder))
    return folder


class Importer:
    """An instance of the FMU; `log` has what it reports."""

    def __init__(self, folder: Path) -> None:
        self.description = fmpy.read_model_description(str(folder))
        self.references = {variable.name: variable.valueReference for variable in self.description.modelVariables}
        self.outputs = [v.valueReference for v in self.description.modelVariables if v.causality == "output"]
        self.log: list[str] = []
        callbacks = fmpy.fmi2.fmi2CallbackFunctions()
        log = lambda _1, _2, _3, _4, text: self.log.append(text.decode())  # noqa: E731
        callbacks.logger = fmpy.fmi2.fmi2CallbackLoggerTYPE(log)
        callbacks.allocateMemory = fmpy.fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
        callbacks.freeMemory = fmpy.fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.free)
        self.fmu = fmpy.fmi2.FMU2Slave(
            guid=self.description.guid,
            unzipDirectory=str(folder),
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName="office",
        )
        self.fmu.instantiate(callbacks=callbacks)

    def initialize(self, *, start_time: float = 0.0, stop_time: float | None = None, **parameters: Any) -> np.ndarray:
        for name, value in parameters.items():
            put = self.fmu.setString if isinstance(value, str) else self.fmu.setInteger
            put([self.references[name]], [value])
        self.fmu.setupExperiment(startTime=start_time, stopTime=stop_time)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        return self.read()

    def read(self) -> np.ndarray:
        return np.array(self.fmu.getReal(self.outputs))

    def write(self, name: str, value: float | None) -> None:
        if value is not None:
            self.fmu.setReal([self.references[f"{name}_u"]], [value])
        self.fmu.setBoolean([self.references[f"{name}_activate"]], [value is not None])

    def step(self, step: int, count: int = 1, size_s: float = STEP_S) -> np.ndarray:
        self.fmu.doStep(step * STEP_S, count * size_s)
        return self.read()


@pytest.fixture
def importer(archive: Path) -> Iterator[Importer]:
    instance = Importer(archive)
    yield instance
    instance.fmu.freeInstance()


def directly(bus: Bus, seed: int, commands: Callable[[int], Mapping[str, float | None]]) -> np.ndarray:
    """Return the readings of an episode without the gateway; amounts are mean rates."""
    with bus.controller("office") as controller:
        sample = controller.reset(seed=seed)
        divisors = np.where(np.arange(21) < len(sample.manifest.sensors), 1.0, STEP_S)
        rows = [sample.values / divisors]
        while not sample.truncated:
            sample.send(commands(sample.step))
            sample = controller.receive()
            rows.append(sample.values / divisors)
    return np.array(rows)


def test_fmi_gateway__values_are_those_of_a_controller_on_the_bus(shared_node: NodeProgram, importer: Importer) -> None:
    def setpoint(step: int) -> float | None:
        return 24.0 + step % 3 if 30 <= step < 60 else None

    with zenostat.connect(shared_node.endpoint, affinity="off") as bus:
        expected = directly(bus, 7, lambda step: {COOLING: setpoint(step)})
        rows = [importer.initialize(seed=7)]
        for step in range(STEPS):
            importer.write(COOLING, setpoint(step))
            rows.append(importer.step(step))
    np.testing.assert_array_equal(rows, expected)
    assert importer.fmu.getBooleanStatus(fmpy.fmi2.fmi2Terminated)
    assert importer.log == []


def test_fmi_gateway__a_step_of_several_timesteps_has_means_of_rates_and_the_latest_of_states(
    shared_node: NodeProgram, importer: Importer
) -> None:
    with zenostat.connect(shared_node.endpoint, affinity="off") as bus:
        rows, points = directly(bus, 7, lambda _: {COOLING: 25.0}), bus.manifest("office").points
    importer.initialize(seed=7)
    importer.write(COOLING, 25.0)
    importer.step(0, 40)
    values = importer.step(40, 4)
    means = [i for i, point in enumerate(points) if isinstance(point, Meter) or point.aggregation is Aggregation.MEAN]
    states = sorted(set(range(21)) - set(means))
    assert {type(points[i]) for i in means} == {Sensor, Meter}
    assert means == [
        i for i, v in enumerate(importer.description.modelVariables[:21]) if "mean of" in str(v.description)
    ]
    np.testing.assert_array_equal(values[states], rows[44][states])
    np.testing.assert_allclose(values[means], rows[41:45, means].mean(axis=0), rtol=1e-14)


def test_fmi_gateway__states_return_to_the_bit(importer: Importer) -> None:
    importer.initialize(seed=3)
    importer.write(COOLING, 24.0)
    importer.step(0, 50)
    at_50, state = importer.read(), importer.fmu.getFMUState()
    straight = [importer.step(step) for step in range(50, 56)]
    importer.write(COOLING, None)
    importer.fmu.setFMUState(state)
    np.testing.assert_array_equal(importer.read(), at_50)
    np.testing.assert_array_equal([importer.step(step) for step in range(50, 56)], straight)
    importer.fmu.setFMUState(state)
    importer.write(COOLING, 27.0)
    assert (importer.step(50, 6) != straight[-1]).any()
    importer.fmu.freeFMUState(state)
    assert importer.log == []


def test_fmi_gateway__a_reset_begins_again(importer: Importer) -> None:
    first = importer.initialize(seed=3, start_time=4e6)  # of a tool that counts from elsewhere
    importer.fmu.doStep(4e6, STEP_S)
    state = importer.fmu.getFMUState()
    importer.fmu.reset()
    np.testing.assert_array_equal(importer.initialize(seed=3), first)
    with pytest.raises(fmpy.fmi1.FMICallException):
        importer.fmu.setFMUState(state)
    assert importer.log == ["fmi2SetFMUstate: the FMU was reset after this state"]


@pytest.mark.parametrize(
    ("deed", "text"),
    [
        (lambda i: i.step(0, size_s=1000.0), "a step of 1000 s; expected a multiple of the timestep of 900 s"),
        (lambda i: i.step(0, count=0), "a step of 0 s; expected a multiple of the timestep of 900 s"),
        (lambda i: i.step(0, size_s=float("nan")), "expected a multiple of the timestep"),
        (lambda i: i.step(3), "a step from 2700 s; the FMU is at 0 s"),
        (lambda i: i.step(0, count=STEPS + 1), "a step to 87300 s; the episode ends at 86400 s"),
        (lambda i: i.write(COOLING, 99.0), "99 is not within 22.5 and 30"),
        (lambda i: i.write(COOLING, float("nan")), "nan is not within 22.5 and 30"),
        (lambda i: i.fmu.setReal([2], [1.0]), "the value reference 2 is not that of an input"),
        (lambda i: i.fmu.getReal([900]), "no variable has the value reference 900"),
        (lambda i: i.fmu.setInteger([0], [1]), "`seed` can be set before the initialization only"),
        (lambda i: i.initialize(), "the FMU is initialized already"),
    ],
)
def test_fmi_gateway__bad_requests_have_reasons(importer: Importer, deed: Callable[[Importer], Any], text: str) -> None:
    importer.initialize(seed=3)
    with pytest.raises(fmpy.fmi1.FMICallException):
        deed(importer)
    assert text in importer.log[0]
    importer.fmu.reset()
    importer.initialize(seed=3)  # an error is not the end of the instance
    importer.step(0)


def test_fmi_gateway__step_beyond_the_stop_time_is_an_error_until_a_reset(importer: Importer) -> None:
    importer.initialize(seed=3, stop_time=2 * STEP_S)
    importer.step(0)
    importer.step(1)
    with pytest.raises(fmpy.fmi1.FMICallException):
        importer.step(2)
    assert importer.log == ["fmi2DoStep: a step to 2700 s; the stop time of the experiment is 1800 s"]
    importer.fmu.reset()
    importer.initialize(seed=3)
    importer.step(0, count=3)


def test_fmi_gateway__a_forked_instance_is_refused_and_the_first_one_goes_on(importer: Importer) -> None:
    importer.initialize(seed=3)
    importer.step(0)
    child = os.fork()
    if not child:
        try:
            importer.step(1)
        except fmpy.fmi1.FMICallException:
            os._exit(7 if "copied by a fork" in importer.log[0] else 8)
        finally:
            os._exit(9)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
    importer.step(1)


TOOL = """
import sys, time, fmpy
from fmpy.fmi2 import FMU2Slave
folder, steps = sys.argv[1], int(sys.argv[2])
described = fmpy.read_model_description(folder)
identifier = described.coSimulation.modelIdentifier
fmu = FMU2Slave(guid=described.guid, unzipDirectory=folder, modelIdentifier=identifier, instanceName="tool")
fmu.instantiate()
fmu.setupExperiment()
fmu.enterInitializationMode()
fmu.exitInitializationMode()
print("there", flush=True)
for step in range(steps):
    fmu.doStep(step * 900.0, 900.0)
    time.sleep(0.05)
time.sleep(600)
"""


@contextmanager
def tool_program(archive: Path, steps: int) -> Iterator[subprocess.Popen[str]]:
    """A process that has initialized the FMU and does some steps."""
    words = [sys.executable, "-c", TOOL, str(archive), str(steps)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as program:
        try:
            assert program.stdout is not None
            assert program.stdout.readline() == "there\n"
            yield program
        finally:
            program.kill()


def test_fmi_gateway__controller_disconnects_when_its_tool_is_killed(shared_node: NodeProgram, archive: Path) -> None:
    with zenostat.connect(shared_node.endpoint, affinity="off") as bus:
        with tool_program(archive, steps=0):
            assert any(name.startswith("fmi-") for _, name in bus.controllers())
        until(lambda: not any(name.startswith("fmi-") for _, name in bus.controllers()), "it has disconnected")


def test_fmi_gateway__tool_that_is_killed_while_the_node_is_paused_disconnects(
    shared_node: NodeProgram, archive: Path
) -> None:
    with zenostat.connect(shared_node.endpoint, affinity="off") as bus, tool_program(archive, steps=90) as tool:
        bus.pause("office")
        try:
            tool.kill()
            until(lambda: not any(name.startswith("fmi-") for _, name in bus.controllers()), "it has disconnected")
        finally:
            bus.resume("office")


@pytest.mark.parametrize(
    ("address", "text"),
    [
        ("127.0.0.1:1", "nobody listens at 127.0.0.1:1"),
        ("nowhere", "expected HOST:PORT"),
        ("no.such.host.invalid:4880", "the host or the port is not known"),
        ("x" * 400, "can have up to 299 characters"),
    ],
)
def test_fmi_gateway__bad_addresses_have_reasons(importer: Importer, address: str, text: str) -> None:
    with pytest.raises(fmpy.fmi1.FMICallException):
        importer.initialize(address=address)
    assert text in importer.log[0]


def test_fmi_gateway__its_fmu_as_a_node_is_the_same_building(shared_node: NodeProgram, archive: Path) -> None:
    with pytest.warns(UserWarning, match="the FMU has connections of its own, so it has no snapshots"):
        env = gym.make("zenostat/Plant-v1", fmu=archive.with_suffix(".fmu"), reward=None, affinity="off")
    with env, zenostat.connect(shared_node.endpoint, affinity="off") as bus:
        building: Any = env.unwrapped
        names = [actuator.name for actuator in building.manifest.actuators]
        assert names == [actuator.name for actuator in bus.manifest("office").actuators]
        action = env.action_space.low
        for _ in range(2):
            env.reset()
            rows = [building.sample.values]
            for _ in range(4):
                env.step(action)
                rows.append(building.sample.values)
        with pytest.raises(ForkFailed, match=r"^the FMU .*\.fmu has connections of its own, so it cannot be copied$"):
            building.snapshot()
        env.close()
        commands = dict(zip(names, action.tolist(), strict=True))
        np.testing.assert_array_equal(rows, directly(bus, 7, lambda _: commands)[:5])


def test_fmi_gateway__another_controller_is_named(shared_node: NodeProgram, importer: Importer) -> None:
    with (
        zenostat.connect(shared_node.endpoint, affinity="off") as bus,
        bus.controller("office", name="first"),
        pytest.raises(fmpy.fmi1.FMICallException),
    ):
        importer.initialize()
    assert "first" in importer.log[0]
    importer.fmu.reset()
    importer.initialize()


def test_fmi_gateway__controller_disconnects_with_its_fmu(shared_node: NodeProgram, importer: Importer) -> None:
    with zenostat.connect(shared_node.endpoint, affinity="off") as bus:
        importer.initialize()
        assert any(name.startswith("fmi-") for _, name in bus.controllers())
        importer.fmu.terminate()
        until(lambda: not any(name.startswith("fmi-") for _, name in bus.controllers()), "it has disconnected")


def test_fmi_gateway__another_fmu_and_strangers_are_refused(gateway: RunningGateway) -> None:
    def answer(message: bytes) -> bytes:
        with socket.create_connection(("127.0.0.1", gateway.port), timeout=20) as connection:
            connection.sendall(message)
            parts = []
            while part := connection.recv(4096):
                parts.append(part)
        return b"".join(parts)

    other = struct.pack("<IIi", 1, 42, -1) + b"{00000000-0000-0000-0000-000000000000}"
    assert b"the points or timesteps of node 'office' are others than those of this FMU" in answer(other)
    assert b"this is the port of FMUs of a node" in answer(b"GET / HTTP/1.1\r\nHost: here\r\n\r\n")
    assert b"a request STEP at the wrong time" in answer(struct.pack("<II", 2, 0))
    assert b"others than those of this FMU" in answer(struct.pack("<II", 1, 0))
    huge = struct.pack("<II", 1, 2**32 - 1)
    assert b"this is the port of FMUs of a node" in answer(huge)


@pytest.mark.slow
@pytest.mark.parametrize(("allow", "permitted"), [("*", True), ("core_*", False)])
def test_fmi_gateway__address_must_be_allowed_everything(
    shared_node: NodeProgram, archive: Path, tmp_path: Path, allow: str, permitted: bool
) -> None:
    clients = tmp_path / "clients.yaml"
    clients.write_text(f'clients:\n  workshop:\n    fmi: 127.0.0.0/8\n    allow: ["{allow}"]\n')
    options = ("--address", "127.0.0.1:0", "--clients", str(clients))
    with (
        RunningGateway("fmi", "office", "--connect", shared_node.endpoint, *options) as running,
        zenostat.connect(shared_node.endpoint, affinity="off") as bus,
    ):
        tool = Importer(archive)
        if permitted:
            tool.initialize(address=f"127.0.0.1:{running.port}")
            assert any(name.startswith("fmi.workshop-") for _, name in bus.controllers())
        else:
            with pytest.raises(fmpy.fmi1.FMICallException):
                tool.initialize(address=f"127.0.0.1:{running.port}")
            assert "workshop may not make this request, for which it must be allowed '*'" in tool.log[0]
        tool.fmu.freeInstance()
