"""Nodes and controllers as programs, and what they must leave behind: nothing."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import psutil

import zenostat
from zenostat import ControllerLink
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.topics.errors import from_wire
from zenostat.topics.messages import Mode, Reset, State

PATIENCE_S = 60.0
"""How long `until` waits before it says what did not happen; no test depends on its length."""

WEATHER = "USA_CO_Denver"
SMALL: dict[str, Any] = {
    "building": "ref-small-office",
    "weather": WEATHER,
    "begin": "07-03",
    "end": "07-03",
    "steps_per_hour": 4,
}
"""A summer weekday (96 timesteps) of a building of five zones that has no EMS programs of its own."""

HOST = "zenostat.bridge.python_plant.host"
"""In the command line of a process of a plant that is a Python class."""

ZONES = ("core_zn", "perimeter_zn_1", "perimeter_zn_2", "perimeter_zn_3", "perimeter_zn_4")
COOLING = {f"{zone}_cooling_setpoint": ("Zone Temperature Control", "Cooling Setpoint", zone.upper()) for zone in ZONES}


def until(holds: Callable[[], Any], what: str) -> Any:
    """The first true answer of `holds`, asked again and again; fails with `what` after `PATIENCE_S`."""
    pause = threading.Event()
    deadline = time.monotonic() + PATIENCE_S
    while not (answer := holds()):
        if time.monotonic() > deadline:
            raise AssertionError(f"it did not happen: {what}")
        pause.wait(0.005)
    return answer


def free_port() -> int:
    """A tcp port of the loopback that nobody listened on a moment ago."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class NodeProgram:
    """A node as a program: `python -P -m zenostat.eplus_node`, settings on stdin; with `plant` that of a class.

    Args:
        folder: for its socket (if `listen` names nothing else) and its scratch files.
        before: the words before its own on its command line, say of a network namespace.
        module: that runs the node; by default chosen from the settings.
        settings: of `zenostat.eplus_node.config.NodeConfig`, or of `zenostat.bridge.python_plant.node.PlantSettings`.

    Raises:
        ZenostatError: what the node said when it could not start; it has ended by then.
    """

    def __init__(self, folder: Path, *, before: tuple[str, ...] = (), module: str = "", **settings: Any) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        arguments: dict[str, Any] = {"listen": [f"unixsock-stream/{folder}/bus"], "folder": str(folder / "run")}
        arguments |= {"affinity": "off", "name": "office", **settings}
        self.name: str = arguments["name"]
        self.keys: str | None = arguments.get("keys")
        self.endpoint: str = (arguments["listen"] or arguments["connect"])[0]
        self.process = subprocess.Popen(
            [
                *before,
                sys.executable,
                "-P",
                "-m",
                module or ("zenostat.bridge.python_plant" if "plant" in settings else "zenostat.eplus_node"),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            process_group=0,
        )
        try:
            self._start(arguments)
        except BaseException:
            self.close()
            raise

    def _start(self, settings: dict[str, Any]) -> None:
        self.process.stdin.write(json.dumps(settings).encode() + b"\n")
        self.process.stdin.flush()
        line = self.process.stdout.readline()
        assert line, f"the node ended with {self.process.wait()} and said nothing"
        answer = json.loads(line)
        if "error" in answer:
            raise from_wire(answer)
        assert answer["ready"] == self.name

    def __enter__(self) -> NodeProgram:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def pid(self) -> int:
        return self.process.pid

    @property
    def engine(self) -> psutil.Process:
        """Its engine's process."""
        return engine_of(self.pid)

    def interrupt(self) -> int:
        """Sends what Ctrl-C sends, and returns the exit code."""
        self.process.send_signal(signal.SIGINT)
        return self.process.wait()

    def kill(self) -> None:
        """Kills it, waits until its engines have seen that and ended, and clears what a killed node cannot clear."""
        self.process.send_signal(signal.SIGSTOP)  # so that it starts no more
        engines = psutil.Process(self.pid).children()
        self.process.kill()
        self.process.wait()
        psutil.wait_procs(engines)
        shutil.rmtree(self.folder)

    def close(self) -> None:
        """Ends it; twice is fine."""
        for pipe in (self.process.stdin, self.process.stdout):
            with suppress(BrokenPipeError):
                pipe.close()
        try:
            self.process.wait(timeout=PATIENCE_S)
        finally:
            self.process.kill()


@contextmanager
def node_on_bus(folder: Path, **settings: Any) -> Iterator[tuple[NodeProgram, zenostat.Bus]]:
    """A node as a program, and a bus that is connected to it; see `NodeProgram`."""
    with NodeProgram(folder, **settings) as node, zenostat.connect(node.endpoint, affinity=Affinity.OFF) as bus:
        yield node, bus


def begin_new_episode(bus: zenostat.Bus, node: str = "office") -> list[int]:
    """Give a shared node the state of a new one, but for its counts and its episode's number, which is returned."""
    until(lambda: not any(c.state.is_connected for c in bus.status(node).controllers), "all controllers have left")
    bus.pause(node)
    bus.pace(node, 1.0)
    bus.pace(node, mode=Mode.LOCKSTEP)
    bus.faults(node, None)
    episode = bus.reset(node, Reset(controller="")).episode
    bus.resume(node)
    until(lambda: (s := bus.status(node)).state is State.WAITING and s.episode == episode, "a new episode begins")
    bus.weather(node, ["dry_bulb"])  # by the node's own thread, which has published all that came before
    return episode


def new_episode(bus: zenostat.Bus, node: str = "office") -> int:
    """Begin an episode of a shared node, with no controller connected and nothing written; return its number."""
    until(lambda: not any(c.state.is_connected for c in bus.status(node).controllers), "all controllers have left")
    (episode,) = bus.reset(node, Reset()).episode
    until(lambda: bus.status(node).state is State.WAITING, "the episode has begun")
    return episode


def next_step(bus: zenostat.Bus, node: str) -> int:
    """Let a paused node simulate a timestep, and return its number; the node may have yet to simulate it."""
    step = bus.status(node).step[0] + 1
    bus.step(node)
    return step


def values_of_day(link: ControllerLink) -> list[bytes]:
    """The values of all samples of an episode with setpoints that change with the step."""
    sample = link.reset(seed=0)
    seen = [sample.message.values]
    while not sample.truncated:
        zones = len(link.manifest.actuators) // 2
        link.send(np.array([20.0, 24.0 + sample.step % 5] * zones))
        sample = link.receive()
        seen.append(sample.message.values)
    return seen


def engines_of(node_pid: int) -> list[psutil.Process]:
    """The engines of a node, the one that simulates its episode last; before it, one may wait to be forked."""
    engines = [
        child for child in psutil.Process(node_pid).children() if "zenostat.eplus_node.engine" in command_of(child)
    ]
    return sorted(engines, key=lambda engine: (engine.create_time(), engine.pid))


def hosts_of(node_pid: int) -> list[psutil.Process]:
    """The processes of a node's plant that is a Python class, oldest first."""
    hosts = [child for child in psutil.Process(node_pid).children() if HOST in command_of(child)]
    return sorted(hosts, key=lambda host: (host.create_time(), host.pid))


def command_of(process: psutil.Process) -> list[str]:
    """Its command line; empty if it has ended."""
    try:
        return process.cmdline()
    except psutil.Error:
        return []


def size_of(pid: int) -> tuple[int, int, float]:
    """A process's descriptors, threads, and memory in MB."""
    process = psutil.Process(pid)
    return process.num_fds(), process.num_threads(), process.memory_info().rss / 1e6


def runs(process: psutil.Process) -> bool:
    """Whether it has not ended; one that nobody has waited for has."""
    try:
        return bool(process.status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False


def engine_of(node_pid: int) -> psutil.Process:
    """The engine that simulates a node's episode."""
    engines = engines_of(node_pid)
    assert 1 <= len(engines) <= 2, f"an engine, and one that waits at most; found {engines}"
    return engines[-1]


class Program:
    """A Python program of a user's: its text, its lines, its end."""

    def __init__(self, text: str, *arguments: str, options: tuple[str, ...] = ("-P",), **popen: Any) -> None:
        self.process = subprocess.Popen(
            [sys.executable, *options, "-u", "-c", text, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            **popen,
        )

    def __enter__(self) -> Program:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def pid(self) -> int:
        return self.process.pid

    def line(self) -> str:
        """Its next line; fails with what it said to standard error if it has ended."""
        line = self.process.stdout.readline()
        if not line:
            self.process.wait()
            raise AssertionError(f"the program ended with {self.process.returncode}: {self.process.stderr.read()}")
        return line.rstrip("\n")

    def json(self) -> Any:
        """Its next line, from JSON."""
        return json.loads(self.line())

    def tell(self, line: str = "") -> None:
        """A line to its standard input."""
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def end(self) -> tuple[int, str, str]:
        """Waits for its end: exit code, the rest of its output, what it said to standard error."""
        out, err = self.process.communicate()
        return self.process.returncode, out, err

    def close(self) -> None:
        """Ends it, also if it is stopped; twice is fine."""
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout, self.process.stderr):
            with suppress(BrokenPipeError):
                pipe.close()


def interrupted(
    command: Sequence[str], when: Callable[[], Any], what: str, *, cwd: Path, number: signal.Signals = signal.SIGINT
) -> None:
    """A signal to a program once `when` holds: it ends with 128 and that, without a traceback, and leaves nothing."""
    with nothing_left(cwd):
        run = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=cwd)
        try:
            until(when, what)
            run.send_signal(number)
            _, stderr = run.communicate(timeout=60)
        finally:
            run.kill()
            run.wait()
        assert run.returncode == 128 + number
        assert "Traceback" not in stderr, stderr


def programs_of(folder: Path) -> list[psutil.Process]:
    """All processes, of whatever parent, that were started with `folder` as their place of temporary files."""
    return [
        p
        for p in psutil.process_iter()
        if p.pid != os.getpid() and (_temporary_folder(p) or "").startswith(str(folder))
    ]


def _temporary_folder(process: psutil.Process) -> str | None:
    try:
        if process.status() == psutil.STATUS_ZOMBIE:
            return None
        return process.environ().get("TMPDIR")
    except psutil.Error:
        return None


def remains(folder: Path) -> list[str]:
    """Return the folders and sockets that runs left in a place of temporary files."""
    return sorted(str(p) for p in within(folder) if p.name.startswith("zenostat-") or p.is_socket())


def within(folder: Path) -> list[Path]:
    """All files and folders below one, but for those that vanish meanwhile."""
    return [Path(where, name) for where, folders, files in os.walk(folder) for name in (*folders, *files)]


@contextmanager
def nothing_left(folder: Path) -> Iterator[None]:
    """Whatever happens within, in the end no process, socket or folder of ours is left."""
    before = {child.pid for child in psutil.Process().children()}
    yield
    until(
        lambda: not [child for child in psutil.Process().children() if child.pid not in before],
        "all processes that the test started have ended",
    )
    until(lambda: not programs_of(folder), "all nodes and engines have ended")
    assert not (left := remains(folder)), left
