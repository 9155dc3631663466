"""Programs as services: what systemd is told, logs as JSON, health checks, and the unit and compose files."""

from __future__ import annotations

import configparser
import inspect
import json
import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import typer.main
import yaml
from support.nodes import PATIENCE_S, free_port, until
from support.run_cli import ZENOSTAT, run_program

from zenostat.bridge.runtime.service_manager import reported
from zenostat.cli.commands import app

ROOT = Path(__file__).parents[2]
CONTAINERFILE = ROOT / "Containerfile"
SERVICES = ROOT / "examples" / "services"
UNITS = sorted(SERVICES.glob("*.service"))
PLANT = str(ROOT / "examples" / "own_plant.py") + ":HeatPumpRoom"
WATCHDOG_S = 0.4


class Systemd:
    """The side of systemd of a unit with `Type=notify` and a watchdog: its socket, and what was received.

    Attributes:
        environment: of the unit's process.
        states: received, in their order.
    """

    def __init__(self, folder: Path) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(folder / "notify"))
        self.environment = {"NOTIFY_SOCKET": str(folder / "notify"), "WATCHDOG_USEC": str(int(WATCHDOG_S * 1e6))}
        self.states: list[str] = []
        self._thread = threading.Thread(target=self._receive, daemon=True)
        self._thread.start()

    def _receive(self) -> None:
        while state := self._socket.recv(4096):
            self.states.append(state.decode())

    def close(self) -> None:
        """End the thread that receives."""
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
            sender.sendto(b"", self._socket.getsockname())
        self._thread.join()
        self._socket.close()


@pytest.fixture
def systemd(monkeypatch: pytest.MonkeyPatch) -> Iterator[Systemd]:
    with tempfile.TemporaryDirectory(prefix="systemd-") as folder:  # a socket's path may not be long
        unit = Systemd(Path(folder))
        for name, value in unit.environment.items():
            monkeypatch.setenv(name, value)
        yield unit
        unit.close()


@contextmanager
def running(*words: str, folder: Path) -> Iterator[subprocess.Popen[str]]:
    program = subprocess.Popen(
        [*ZENOSTAT, *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=folder
    )
    try:
        yield program
    finally:
        if program.poll() is None:
            program.send_signal(signal.SIGTERM)
            program.communicate(timeout=PATIENCE_S)


@contextmanager
def own_node(folder: Path, endpoint: str) -> Iterator[subprocess.Popen[str]]:
    words = ("--log", "json", "node", "--plant", PLANT, "--name", "room", "--listen", endpoint, "--affinity", "off")
    with running(*words, folder=folder) as program:
        yield program


def is_alive(states: list[str]) -> bool:
    return states.count("WATCHDOG=1") >= 3


def test_reported__ready_then_alive_while_the_loop_runs_then_stopping(systemd: Systemd) -> None:
    posted: list[Any] = []
    with reported(posted.append):
        until(lambda: systemd.states == ["READY=1"], "it is ready")
        posted.pop()()
        until(lambda: posted, "the next report is due")
        time.sleep(WATCHDOG_S)
        assert systemd.states == ["READY=1", "WATCHDOG=1"]  # a loop that hangs runs nothing that is posted
        posted.pop()()
        until(lambda: len(systemd.states) == 3, "the loop runs again")
    until(lambda: systemd.states[2:] == ["WATCHDOG=1", "STOPPING=1"], "it stops")


def test_reported__without_systemd_sends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    monkeypatch.delenv("WATCHDOG_USEC", raising=False)
    posted: list[Any] = []
    with reported(posted.append):
        assert posted == []


def test_reported__watchdog_of_another_process_is_not_served(systemd: Systemd, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WATCHDOG_PID", "1")
    posted: list[Any] = []
    with reported(posted.append):
        assert posted == []
    until(lambda: systemd.states == ["READY=1", "STOPPING=1"], "it starts and stops")


@pytest.mark.slow
def test_node__as_a_service_reports_its_state_and_logs_json(systemd: Systemd, scratch: Path) -> None:
    endpoint = f"unixsock-stream/{scratch}/bus"
    with own_node(scratch, endpoint) as node:
        until(lambda: is_alive(systemd.states), "the node is alive")
        assert systemd.states[0] == "READY=1"
        healthy = run_program("status", "room", "--connect", endpoint)
        assert healthy.returncode == 0, healthy.stderr
        assert run_program("status", "hall", "--connect", endpoint).returncode == 1
        ran = run_program("run", "--node", "room", "--controller", "baseline", "--connect", endpoint)
        assert ran.returncode == 0, ran.stderr
        node.send_signal(signal.SIGTERM)
        printed, _ = node.communicate(timeout=PATIENCE_S)
    until(lambda: systemd.states[-1] == "STOPPING=1", "the node stops")
    entries = [json.loads(line) for line in printed.splitlines()]
    assert all({"time", "level", "message"} <= entry.keys() for entry in entries)
    connected = next(entry for entry in entries if entry.get("kind") == "connected")
    assert connected["node"] == "room"
    assert connected["source"].startswith("baseline-")
    assert entries[-1]["message"] == "room: ended"


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["boptest", "modbus", "router", "zeromq"])
def test_gateways_and_routers__as_services_report_their_state(kind: str, systemd: Systemd, scratch: Path) -> None:
    endpoint = f"unixsock-stream/{scratch}/bus"
    ports = [f"127.0.0.1:{free_port()}" for _ in range(2)]
    words = {
        "boptest": ("gateway", "boptest", "--address", ports[0]),
        "modbus": ("gateway", "modbus", "room", "--address", ports[0], "--connect", endpoint, "--wait"),
        "router": ("router", "--listen", f"tcp/{ports[0]}"),
        "zeromq": (
            *("gateway", "zeromq", "--publish", f"tcp://{ports[0]}", "--command", f"tcp://{ports[1]}"),
            *("--connect", endpoint, "--wait"),
        ),
    }[kind]
    with running(*words, folder=scratch) as program:
        if kind in ("modbus", "zeromq"):
            subprocess.run(["sleep", "1"], check=True)
            assert systemd.states == []  # it waits for the node, and is not ready
            environment = {"NOTIFY_SOCKET": "", "WATCHDOG_USEC": ""}
            node = subprocess.Popen(
                [*ZENOSTAT, "node", "--plant", PLANT, "--name", "room", "--listen", endpoint, "--affinity", "off"],
                stdout=subprocess.DEVNULL,
                cwd=scratch,
                env={**os.environ, **environment},
            )
        try:
            until(lambda: is_alive(systemd.states), "the program is alive")
        finally:
            program.send_signal(signal.SIGTERM)
            program.communicate(timeout=PATIENCE_S)
            if kind in ("modbus", "zeromq"):
                node.terminate()
                node.wait(timeout=PATIENCE_S)
    until(lambda: systemd.states[-1] == "STOPPING=1", "the program stops")
    assert systemd.states[0] == "READY=1"


def words_are_accepted(words: list[str]) -> None:
    """Fails unless the command exists, and has each of the options."""
    assert words[0] == "zenostat"
    assert words[1:3] == ["--log", "json"]
    command = words[3 : 5 if words[3] == "gateway" else 4]
    help_ = run_program(*command, "--help")
    assert help_.returncode == 0, help_.stderr
    for word in words:
        if word.startswith("--") and word != "--log":
            assert re.search(rf"{re.escape(word)}\b", help_.stdout), (word, command)


def named_extras(words: list[str]) -> set[str]:
    """The extras that the module of a command asks for; `words` are those behind `zenostat --log json`."""
    command: Any = typer.main.get_command(app)
    for name in words[: 2 if words[0] == "gateway" else 1]:
        command = command.commands[name]
    source = Path(inspect.unwrap(command.callback).__code__.co_filename).read_text(encoding="utf-8")
    return set(re.findall(r'\b(?:requires_extra|install_command)\("([\w-]+)"', source))


@pytest.mark.variants
@pytest.mark.parametrize("path", UNITS, ids=lambda path: path.stem)
def test_unit_files__start_commands_that_exist_and_restrict_them(path: Path) -> None:
    unit = configparser.RawConfigParser(strict=False)
    unit.optionxform = str  # type: ignore[assignment, method-assign]
    unit.read(path)
    service = unit["Service"]
    assert service["Type"] == "notify"
    assert service["WatchdogSec"] == "120"
    assert service["ProtectSystem"] == "strict"
    assert service["DynamicUser"] == "yes"
    program, *words = shlex.split(service["ExecStart"])
    words_are_accepted([Path(program).name, *words])


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
@pytest.mark.parametrize("path", UNITS, ids=lambda path: path.stem)
def test_unit_files__are_valid_for_systemd(path: Path, tmp_path: Path) -> None:
    name = path.name.replace("@", "@office")
    copy = tmp_path / name
    copy.write_text(path.read_text().replace("/opt/zenostat/bin/zenostat", ZENOSTAT[0]))
    done = subprocess.run(["systemd-analyze", "verify", "--man=no", str(copy)], capture_output=True, text=True)
    assert [line for line in done.stderr.splitlines() if name in line] == []


@pytest.mark.slow
def test_compose_file__services_are_restricted_and_have_commands_that_exist() -> None:
    file = yaml.safe_load((SERVICES / "compose.yaml").read_text())
    services = file["services"]
    assert set(services) == {"node", "room", "broker", "mqtt"}
    for service in services.values():
        assert service["read_only"] is True
        assert not service["user"].startswith("0")
        assert service["cap_drop"] == ["ALL"]
        assert service["network_mode"] == "host"
        if "command" in service:
            words_are_accepted(shlex.split(service["command"]))
            assert (SERVICES / service["build"]["context"] / service["build"]["dockerfile"]).samefile(CONTAINERFILE)
    assert not any("0.0.0.0" in service.get("command", "") for service in services.values())


def test_installed_extras__are_those_that_the_services_ask_for() -> None:
    services = yaml.safe_load((SERVICES / "compose.yaml").read_text())["services"].values()
    image = re.findall(r"^ARG EXTRAS=(.*)$", CONTAINERFILE.read_text(), re.M)
    page = re.findall(r"pip install '\.\[(.*)\]'", (ROOT / "docs" / "services.md").read_text())
    for (extras,), commands in (
        (image, [service["command"] for service in services if "command" in service]),
        (page, re.findall(r"^ExecStart=(.*)$", "".join(path.read_text() for path in UNITS), re.M)),
    ):
        needed = set().union(*(named_extras(shlex.split(command)[3:]) for command in commands))
        assert needed == {"mqtt", "recording", "room"}
        assert needed <= set(extras.split(","))
