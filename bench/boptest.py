"""Part `boptest`: what HTTP adds to a step of the BOPTEST gateway, with a session of `requests` as client."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import numpy as np
import psutil
import requests
from rich.console import Console
from rich.table import Table

from bench.machine import OtherLoad
from bench.programs import started
from zenostat.bridge.runtime.processor_time import processor_s
from zenostat.cli.boptest_cases import BundledTestCases
from zenostat.gateways.boptest.prices import read_rates
from zenostat.gateways.boptest.session import BuildingTest
from zenostat.topics.arrays import Floats
from zenostat.topics.messages import CommandOp

CASE = "office-small"
STEPS = 96
_OWN = "the building's own step"
_INPUTS = {"core_zn_cooling_setpoint_u": 297.15, "core_zn_cooling_setpoint_activate": 1}
_GATEWAY = ("gateway", "boptest", "--address", "127.0.0.1:0")
_BEGIN = {"start_time": 17280000, "warmup_period": 0}


def measure(*, quick: bool) -> dict[str, Any]:
    """Return milliseconds of a step and of other requests, by kind: median over rounds of a day each.

    `client_ms` and `gateway_ms` are processor time of the client and of the gateway, without the building.
    """
    with ExitStack() as stack:
        pid, ready = stack.enter_context(started(*_GATEWAY))
        url = ready.split()[1].rstrip(";")
        own = BuildingTest(BundledTestCases().find(CASE), read_rates(), dict)
        stack.callback(own.close)
        session = stack.enter_context(requests.Session())
        testid = session.post(f"{url}/testcases/{CASE}/select").json()["testid"]

        def call(method: str, operation: str, body: dict[str, Any] | None = None) -> None:
            session.request(method, f"{url}/{operation}/{testid}", json=body).raise_for_status()

        call("PUT", "step", {"step": 900})
        values, operations = _command(own)
        forecast = {"point_names": ["TDryBul"], "horizon": 86400, "interval": 3600}
        kinds: dict[str, Callable[[], object]] = {
            _OWN: lambda: own.simulation.step(values, operations),
            "POST /advance": lambda: call("POST", "advance", _INPUTS),
            "GET /kpi": lambda: call("GET", "kpi"),
            "PUT /forecast": lambda: call("PUT", "forecast", forecast),
            "GET /name": lambda: call("GET", "name"),
        }
        load, processes = OtherLoad(), (psutil.Process(), psutil.Process(pid))
        rounds: dict[str, list[tuple[float, ...]]] = {kind: [] for kind in kinds}
        for _ in range(3 if quick else 9):
            for kind, work in kinds.items():
                own.initialize(_BEGIN)
                call("PUT", "initialize", _BEGIN)
                call("GET", "kpi")
                rounds[kind].append(_burst(work, processes))
        share = load.share()
    figures = {kind: [statistics.median(column) for column in zip(*rows, strict=True)] for kind, rows in rounds.items()}
    added = [step[0] - alone[0] for step, alone in zip(rounds["POST /advance"], rounds[_OWN], strict=True)]
    return {"ms": figures, "added_ms": statistics.median(added), "others": share}


def _command(test: BuildingTest) -> tuple[Floats, bytes]:
    """Return what `/advance` commands: one actuator, all others relinquished."""
    index = test.table.commanded["core_zn_cooling_setpoint_u"]
    values, operations = np.zeros(len(test.table.inputs)), bytearray([CommandOp.RELINQUISH] * len(test.table.inputs))
    values[index] = test.table.bus_input(index, _INPUTS["core_zn_cooling_setpoint_u"])
    operations[index] = CommandOp.SET
    return values, bytes(operations)


def _burst(work: Callable[[], object], processes: tuple[psutil.Process, ...]) -> tuple[float, ...]:
    """Return the median of the durations, and the mean processor time of each process, in milliseconds."""
    before = [processor_s(process) for process in processes]
    durations = []
    for _ in range(STEPS):
        start = time.perf_counter()
        work()
        durations.append((time.perf_counter() - start) * 1e3)
    spent = [processor_s(process) - start for process, start in zip(processes, before, strict=True)]
    return statistics.median(durations), *(seconds * 1e3 / STEPS for seconds in spent)


def show(results: dict[str, Any], console: Console) -> None:
    """Print a table."""
    title = f"BOPTEST gateway, {CASE}, ms; other load {results['others']:.0%}"
    table = Table("", "wall", "processor, client", "processor, gateway", title=title)
    for kind, figures in results["ms"].items():
        table.add_row(kind, *(f"{milliseconds:.2f}" for milliseconds in figures))
    table.add_row("HTTP beside the building's own step", f"{results['added_ms']:.2f}")
    console.print(table)
