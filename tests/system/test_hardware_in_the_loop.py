"""The page on hardware in the loop: its own lines are run, and show what its table says."""

import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from support.mqtt_broker import BROKER, MOSQUITTO, Broker, needs_broker
from support.nodes import free_port, until
from support.run_cli import ZENOSTAT

import zenostat
from zenostat.metrics.recording import load
from zenostat.metrics.trajectory import Trajectory

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "hardware-in-the-loop.md").read_text()
PROGRAMS = {"python": [sys.executable], "mosquitto": [MOSQUITTO]}
if BROKER != "mosquitto" or shutil.which("mosquitto_sub") is None:
    PROGRAMS["mosquitto_sub"] = [sys.executable, "tests/support/mosquitto_sub.py"]
SETPOINT, TEMPERATURE, PEOPLE = "core_zn_cooling_setpoint", "core_zn_air_temperature", "core_zn_occupants"
SPEED = "1800"


def page_lines() -> list[str]:
    """The lines of the page's blocks."""
    blocks = re.findall(r"^```\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    return [line for block in blocks[1:] for line in block.splitlines()]  # the first is the drawing


class Run:
    """Programs that are started by lines of the page, on addresses of this run.

    Args:
        folder: of their files and outputs.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self._left = folder, page_lines()
        self.endpoint = f"unixsock-stream/{folder}/bus"
        self.own = f"127.0.0.1:{free_port()}"
        self._ports = {port: str(free_port()) for port in ("1883", "47808")}
        self._modbus = str(free_port())
        self._close = ExitStack()

    def words(self, begin: str) -> list[str]:
        """Take a line of the page: the next one that begins so."""
        line = next(line for line in self._left if line.startswith(begin))
        self._left.remove(line)
        for port, own in self._ports.items():
            line = re.sub(rf"\b{port}\b", own, line)
        line = re.sub(r"\b(hil\.\w+|map\.csv)", lambda match: str(self.folder / match[0]), line)
        program, *rest = shlex.split(line)
        if program == "zenostat":
            return [*ZENOSTAT, *rest]
        return [*PROGRAMS.get(program, [program]), *rest]

    def start(self, begin: str, *more: str, is_ready: Callable[[str], object]) -> tuple[subprocess.Popen[bytes], Path]:
        """Start a program, and wait until its output shows that it is ready."""
        log = self.folder / f"{len(self._left)}.txt"
        with log.open("wb") as out:
            words = [*self.words(begin), *more]
            program = subprocess.Popen(words, stdout=out, stderr=subprocess.STDOUT, cwd=ROOT)

        def end() -> None:
            program.terminate()
            program.wait(60)

        self._close.callback(end)
        until(lambda: program.poll() is not None or is_ready(log.read_text()), f"{begin} is ready")
        assert program.poll() is None, log.read_text()
        return program, log

    def broker(self) -> None:
        """Start the page's broker, or the one of the tests in its place."""
        if BROKER == "mosquitto":
            self.start("mosquitto -p", "-v", is_ready=lambda text: "running" in text)
        else:
            self._close.enter_context(Broker(self.folder, port=int(self._ports["1883"])))

    def node(self, begin: str, *more: str) -> None:
        self.start(begin, *more, is_ready=lambda text: "Ctrl-C" in text)

    def gateway(self, kind: str) -> None:
        address = ["--address", f"127.0.0.1:{self._modbus}"] if kind == "modbus" else []
        self.node(f"zenostat gateway {kind}", "--connect", self.endpoint, *address)

    def plc(self) -> tuple[subprocess.Popen[bytes], Path]:
        words = ("--port", self._modbus, "--pause", "0.02")
        return self.start("python examples/modbus", *words, is_ready=lambda text: "raised" in text)

    def supervisor(self) -> tuple[subprocess.Popen[bytes], Path]:
        words = ("--device", f"127.0.0.1:{self._ports['47808']}", "--own", self.own, "--pause", "0.02")
        return self.start("python examples/bacnet", *words, is_ready=lambda text: "objects" in text)

    def command(self, begin: str, *more: str) -> str:
        """Run a command to its end; return its output."""
        words = [SPEED if word == "600" else word for word in self.words(begin)]
        done = subprocess.run([*words, *more], capture_output=True, text=True, timeout=300, cwd=ROOT)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def on_bus(self, begin: str) -> str:
        return self.command(begin, "--connect", self.endpoint)

    def end(self) -> None:
        self._close.close()


@contextmanager
def running(folder: Path) -> Iterator[Run]:
    run = Run(folder)
    try:
        yield run
    finally:
        run.end()


def clock(time: datetime | str) -> timedelta:
    """Time since midnight, of a time or of a BACnet time in a line of text."""
    if isinstance(time, str):
        return timedelta(hours=int(time.split(":")[0]), minutes=int(time.split(":")[1]))
    return time - datetime(time.year, 7, 3)


def between(episode: Trajectory, begin: timedelta, end: timedelta) -> np.ndarray:
    """Which timesteps lie between two times; the values of each sample are those at its end."""
    step = timedelta(seconds=episode.manifest.step_s)
    times = [clock(time) for time in episode.time.tolist()]
    return np.array([begin <= time - step and time <= end for time in times])


@pytest.mark.slow
@needs_broker
def test_hardware_in_the_loop__page_shows_what_it_states(scratch: Path) -> None:
    with running(scratch) as run:
        run.broker()
        run.node("zenostat node", "--listen", run.endpoint)
        for kind in ("modbus", "bacnet", "mqtt"):
            run.gateway(kind)
        run.on_bus("zenostat gateway modbus office --map")
        _, plc = run.plc()
        supervisor, pre_cooling = run.supervisor()
        _, dashboard = run.start(
            "mosquitto_sub", "-p", run._ports["1883"], is_ready=lambda text: f"sensor/{TEMPERATURE}" in text
        )
        run.on_bus("zenostat pace")
        until(lambda: "not in effect" in plc.read_text().partition("raised, in effect")[2], "the PLC is overridden")
        with zenostat.connect(run.endpoint, affinity="off") as bus:
            bus.pause("office")  # for as long as the commands take
            priorities = run.on_bus("zenostat priorities")
            assert "office" in run.on_bus("zenostat status")
            bus.resume("office")
        rows = re.findall(rf"^{SETPOINT}\s+(\d+)\s+(\d+)\b", priorities, re.MULTILINE)
        assert rows == [("8", "23"), ("10", "28")], priorities
        assert supervisor.wait(120) == 0, pre_cooling.read_text()
        until(lambda: "of the building" in plc.read_text(), "people have come")
        until(lambda: plc.read_text().splitlines()[-1].endswith("raised, in effect"), "night")
        run.on_bus("zenostat stop")
    assert "identical" in run.command("zenostat verify")
    log = run.command("zenostat log")
    assert all(source in log for source in ("modbus", f"bacnet.{run.own.replace(':', '_')}")), log
    run.command("zenostat report")
    _check(load(scratch / "hil.mcap").episodes[0], plc, pre_cooling, dashboard, run.own)


def _check(episode: Trajectory, plc: Path, pre_cooling: Path, dashboard: Path, own: str) -> None:
    """Check the table of the page, from what was recorded and printed."""
    hour = timedelta(hours=1)
    sources, effective = episode.value_source(SETPOINT), episode[SETPOINT]
    arrival = clock(episode.time[int(np.flatnonzero(episode[PEOPLE] > 0)[0])].item())
    assert arrival == clock("5:10")
    written, relinquished = (clock(line) for line in pre_cooling.read_text().splitlines()[1:])
    assert 3 * hour <= written < arrival
    assert 6 * hour <= relinquished < 7 * hour  # while the thermostat hangs

    night = between(episode, 1 * hour, 3 * hour)
    assert (set(sources[night]), set(effective[night])) == ({"modbus"}, {28.0})
    pre_cooled = between(episode, written + 0.5 * hour, 6 * hour)
    assert (set(sources[pre_cooled]), set(effective[pre_cooled])) == ({f"bacnet.{own.replace(':', '_')}"}, {23.0})
    assert set(effective[between(episode, relinquished, 7 * hour)]) == {23.0}
    day = between(episode, 8 * hour, 20 * hour)
    assert set(sources[day]) == {episode.sources[0]}
    assert 23.0 not in effective[day]
    assert 28.0 in effective[between(episode, 20 * hour, 24 * hour)]

    lines = [line.partition("setpoint ")[2] for line in plc.read_text().splitlines()]
    changes = [line for line, before in zip(lines, ["", *lines[:-1]], strict=True) if line != before]
    assert [line for line in changes if line != "raised, not in effect"][:3] == [
        "raised, in effect", "of the building", "raised, in effect",
    ]  # fmt: skip
    assert changes[changes.index("raised, in effect") + 1] == "raised, not in effect"

    column = episode.manifest.names.index(TEMPERATURE)
    disturbed = (episode.values[:, column] - episode.fault_free_values[:, column]).round(9)
    times = [clock(time) for time, offset in zip(episode.time.tolist(), disturbed, strict=True) if offset]
    assert (min(times), max(times), set(disturbed)) == (9 * hour, clock("11:50"), {0.0, 1.5})
    shown = {line.split()[1] for line in dashboard.read_text().splitlines() if f"sensor/{TEMPERATURE} " in line}
    assert shown <= {repr(value) for value in episode[TEMPERATURE].tolist()}
    assert len(shown) > 50
