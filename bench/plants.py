"""Part `plants`: cost of a step of a plant that does nothing, beside bare bytes over Zenoh and HELICS."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

from rich.console import Console
from rich.table import Table

from bench import helics_peer, pace
from bench.pace import Worker
from zenostat.topics.extras import install_command

STEPS = 3000
KINDS: dict[str, tuple[str, dict[str, Any]]] = {
    "thread and two queues": ("plant-queues", {}),
    "bare bytes over Zenoh": ("plant-echo", {"placement": "apart"}),
    "bare bytes over Zenoh, not placed": ("plant-echo", {"placement": "off"}),
    "controller link, plant in the node": ("plant-link", {"placement": "apart"}),
    "env.step, plant in the node": ("plant-in-node", {"placement": "apart"}),
    "env.step, plant in the node, not placed": ("plant-in-node", {"placement": "off"}),
    "env.step, Python class": ("plant-class", {"placement": "apart"}),
}
PEERS: dict[str, tuple[str, dict[str, Any]]] = {
    "HELICS, tcp": ("plant-helics", {"core": "tcp", "offset_s": 0.5}),
    "HELICS, tcp, a step late": ("plant-helics", {"core": "tcp", "offset_s": 0.0}),
    "HELICS, zmq": ("plant-helics", {"core": "zmq", "offset_s": 0.5}),
}
"""Late: both federates compute at once, and a measurement shows the previous command."""
REFERENCE = "bare bytes over Zenoh"


def measure(*, quick: bool) -> dict[str, Any]:
    """Return microseconds per step of each kind, and the ratio to bare bytes."""
    kinds = KINDS | (PEERS if helics_peer.installed() else {})
    with ExitStack() as stack:
        workers = {
            title: stack.enter_context(Worker(kind, "no scene", **options)) for title, (kind, options) in kinds.items()
        }
        measurements = {title: pace.steps_of(worker, STEPS) for title, worker in workers.items()}
        rounds = pace.rounds(measurements, 3 if quick else 9)
    return {
        "us": {title: pace.figures(rounds, title) for title in kinds},
        "ratio": {title: pace.figures(rounds, title, REFERENCE) for title in kinds},
        "skipped": [title for title in PEERS if title not in kinds],
        "others": pace.other_load(rounds),
        "rounds": [result.figures for result in rounds],
    }


def show(results: dict[str, Any], console: Console) -> None:
    """Print a table."""
    table = Table("", "µs per step", "ratio to bare bytes", "quartiles", title="a plant that does nothing")
    for title, us in results["us"].items():
        ratio = results["ratio"][title]
        table.add_row(
            title, f"{us['median']:.0f}", f"{ratio['median']:.2f}", f"{ratio['low']:.2f} to {ratio['high']:.2f}"
        )
    for title in results["skipped"]:
        table.add_row(title, "skipped", "", "")
    console.print(table)
    if results["skipped"]:
        console.print(f"HELICS is not installed: {install_command('bench')}", markup=False)
    console.print(f"other load {results['others']['median']:.0%}")
