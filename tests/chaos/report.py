"""Report of a run: tables for the terminal and for the documentation."""

import platform
from pathlib import Path

import psutil
from rich.console import Console
from rich.table import Table

from chaos.disturbances import Disturbance
from chaos.invariants import Verdict

BEGIN, END = "<!-- made by make chaos -->", "<!-- end of what make chaos made -->"


def show(verdict: Verdict, console: Console) -> None:
    """Prints what was done, what held and what did not."""
    table = Table("what was tried", "times", title=f"seed {verdict.outcome.seed}")
    for disturbance in Disturbance:
        table.add_row(disturbance, f"{verdict.outcome.done[disturbance]:,}")
    console.print(table)
    console.print(figures(verdict), markup=False)
    table = Table("", "what must hold")
    for what, faults in verdict.faults.items():
        table.add_row("[red]broken" if faults else "[green]holds", what)
    console.print(table)
    for what, faults in verdict.faults.items():
        for fault in faults[:20]:
            console.print(f"{what}: {fault}", markup=False, soft_wrap=True, style="red")


def figures(verdict: Verdict) -> str:
    """The run's size and its memory, in two sentences."""
    outcome = verdict.outcome
    first, last = outcome.resources[0], outcome.resources[-1]
    return (
        f"{outcome.seconds:.0f} s, seed {outcome.seed}: {verdict.episodes:,} episodes, {verdict.samples:,} samples, "
        f"{verdict.messages:,} messages to the node, {verdict.refused:,} of them refused and counted; "
        f"{verdict.fallbacks:,} timesteps went on without a controller and say so. "
        f"Node and engine held {(first.node_bytes + first.engine_bytes) / 1e6:.0f} MB at the beginning "
        f"and {(last.node_bytes + last.engine_bytes) / 1e6:.0f} MB at the end."
    )


def markdown(verdict: Verdict) -> str:
    """Return the report for a page. Losses are those of the invariants: all or nothing."""
    lost = "nothing" if verdict.holds else "see below"
    rows = [f"| {disturbance} | {verdict.outcome.done[disturbance]:,} | {lost} |" for disturbance in Disturbance]
    where = f"{psutil.cpu_count()} cores ({platform.machine()}), Python {platform.python_version()}"
    broken = [f"- {what}: {fault}" for what, faults in verdict.faults.items() for fault in faults]
    parts = [f"{figures(verdict)} {where}.", "", "| what was tried | times | what was lost |", "|---|---|---|", *rows]
    return "\n".join([*parts, *(["", *broken] if broken else [])])


def put(verdict: Verdict, page: Path) -> None:
    """Puts the table into a page, between its two marks."""
    before, _, rest = page.read_text().partition(BEGIN)
    _, _, after = rest.partition(END)
    page.write_text(f"{before}{BEGIN}\n\n{markdown(verdict)}\n\n{END}{after}")
