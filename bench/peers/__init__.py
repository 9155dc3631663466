"""Part `peers`: co-simulation tools beside districts, with the same loop coupled by HELICS, by mosaik and here.

Each kind couples the functions of `model` as its tool's documentation recommends. A round runs each kind once, in
processes of its own; the times are those of a step without the start, and the ratios are within a round. Residuals,
evaluations and trajectories do not depend on the machine.
"""

from __future__ import annotations

import ast
import importlib.util
import json
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

from rich.console import Console
from rich.table import Table

from bench import programs
from bench.peers import model
from zenostat.topics.extras import install_command

TOOLS = {"HELICS": "helics", "mosaik": "mosaik", "district": "zenostat"}
"""Packages by tool."""
_SKIPPED, _TIMEOUT_S = 8, 600.0


@dataclass(frozen=True)
class Kind:
    """A tool with a way to couple the loop.

    Attributes:
        tool: one of `TOOLS`.
        scheme: `delay`, or `iterate` (of a district: `solve`).
        gain: of the law, K/kW.
        damping: part of a change of the setpoint that an iteration takes; 0 if the tool has a solver.
        options: of the tool.
    """

    tool: str
    scheme: str
    gain: float = 1.5
    damping: float = 0.0
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def is_installed(self) -> bool:
        """Whether the tool's package can be imported."""
        return importlib.util.find_spec(TOOLS[self.tool]) is not None


def _kinds() -> dict[str, dict[str, Kind]]:
    """Return the kinds by table and title."""
    places: dict[str, tuple[str, dict[str, Any]]] = {
        "HELICS, tcp": ("HELICS", {"core": "tcp"}),
        "HELICS, zmq": ("HELICS", {"core": "zmq"}),
        "mosaik, one process": ("mosaik", {"place": "together"}),
        "mosaik, two processes": ("mosaik", {"place": "apart"}),
        "district, law as a plant": ("district", {"law": "plant"}),
        "district, law as a connection": ("district", {"law": "connection"}),
    }

    def loop(gain: float, damping: float) -> dict[str, Kind]:
        return {
            title: Kind(tool, "solve", gain, options=options)
            if tool == "district"
            else Kind(tool, "iterate", gain, damping, options)
            for title, (tool, options) in places.items()
        }

    peers = ("HELICS, tcp", "mosaik, one process")
    return {
        EXCHANGE: {title: Kind(tool, "delay", options=options) for title, (tool, options) in places.items()},
        "loop, 0.5 K/kW, substitution": loop(0.5, 1.0),
        "loop, 1.5 K/kW, substitution": {title: kind for title, kind in loop(1.5, 1.0).items() if title in peers},
        "loop, 1.5 K/kW, damping 0.5": loop(1.5, 0.5),
    }


EXCHANGE = "exchange, a step late"
REFERENCE = "district, law as a connection"


def run(kind: Kind, steps: int) -> model.Day:
    """Simulate the loop, and return what the office did.

    Raises:
        RuntimeError: a program of the kind failed; the text ends as its errors do.
    """
    with TemporaryDirectory() as folder, ExitStack() as stack:
        output = Path(folder, "day.json")
        options = {**kind.options, "scheme": kind.scheme, "gain": kind.gain, "damping": kind.damping}
        options |= {"steps": steps, "output": str(output)}
        federates: tuple[tuple[str, ...], ...] = ((),)
        if kind.tool == "HELICS":
            options["port"], federates = programs.free_port(), (("office",), ("law",))
        started = []
        for number, federate in enumerate(federates):
            command = programs.command(f"peers.{kind.tool.lower()}_loop", *federate, json.dumps(options))
            log = stack.enter_context(Path(folder, f"log-{number}").open("w+"))
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=programs.environment(), cwd=folder
            )
            stack.callback(process.wait)
            stack.callback(process.kill)
            started.append((process, log))
        for process, log in started:
            try:
                process.wait(_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                raise RuntimeError(f"{kind} did not end within {_TIMEOUT_S:g} s") from None
            if process.returncode:
                log.seek(0)
                raise RuntimeError(f"{kind} failed:\n{log.read()[-3000:]}")
        return model.Day(**json.loads(output.read_text()))


def step_ms(day: model.Day) -> float:
    """Return the mean time of a step, without the first ones."""
    return 1e3 * (day.times[-1] - day.times[_SKIPPED - 1]) / (len(day.times) - _SKIPPED)


def residuals(day: model.Day, gain: float) -> list[float]:
    """Return the distance of each step's setpoint from the law at its power, K."""
    return [abs(s - model.law(p, gain)) for s, p in zip(day.setpoints, day.powers, strict=True)]


def code_lines(tool: str) -> int:
    """Return the number of lines of a tool's module without blank lines, comments and docstrings."""
    path = Path(__file__).with_name(f"{tool.lower()}_loop.py")
    text = path.read_text()
    documentation = {line for first, last in _docstrings(ast.parse(text)) for line in range(first, last + 1)}
    lines = enumerate(text.splitlines(), 1)
    return sum(number not in documentation and bool(line.strip()) and line.lstrip()[0] != "#" for number, line in lines)


def _docstrings(tree: ast.Module) -> Iterator[tuple[int, int]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            yield node.body[0].lineno, node.body[0].end_lineno or 0


def measure(*, quick: bool) -> dict[str, Any]:
    """Run all kinds whose tools are installed, several times in turn."""
    tables = _kinds()
    skipped = sorted({kind.tool for kinds in tables.values() for kind in kinds.values() if not kind.is_installed})
    results: dict[str, Any] = {"skipped": skipped, "lines": {tool: code_lines(tool) for tool in TOOLS}, "tables": {}}
    for name, kinds in tables.items():
        present = {title: kind for title, kind in kinds.items() if kind.is_installed}
        rounds = [
            {title: run(kind, model.STEPS_PER_DAY) for title, kind in present.items()} for _ in range(1 if quick else 3)
        ]
        results["tables"][name] = {title: _row(title, kind, rounds) for title, kind in present.items()}
    return results


def _row(title: str, kind: Kind, rounds: list[dict[str, model.Day]]) -> dict[str, Any]:
    day = rounds[0][title]
    each = residuals(day, kind.gain)
    row: dict[str, Any] = {
        "mean_k": sum(each) / len(each),
        "max_k": max(each),
        "evaluations": day.evaluations / len(each),
        "ms": median(step_ms(days[title]) for days in rounds),
        "rounds_ms": [step_ms(days[title]) for days in rounds],
    }
    if REFERENCE in rounds[0]:
        row["ratio"] = median(step_ms(days[title]) / step_ms(days[REFERENCE]) for days in rounds)
    return row


def show(results: dict[str, Any], console: Console) -> None:
    """Print the tables."""
    for name, rows in results["tables"].items():
        table = Table("", "residual K, mean", "max", "evaluations/step", "ms/step", "steps/s", "ratio", title=name)
        for title, row in rows.items():
            figures = [f"{row['mean_k']:.3f}", f"{row['max_k']:.3f}", f"{row['evaluations']:.2f}", f"{row['ms']:.2f}"]
            table.add_row(title, *figures, f"{1e3 / row['ms']:.0f}", f"{row['ratio']:.2f}" if "ratio" in row else "")
        console.print(table)
    lines = ", ".join(f"{tool} {count}" for tool, count in results["lines"].items())
    console.print(f"lines of code: {lines}")
    if results["skipped"]:
        console.print(f"not installed: {', '.join(results['skipped'])}: {install_command('bench')}", markup=False)
