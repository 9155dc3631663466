"""`zenostat verify`: simulate a recording again, and compare."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated

import typer

from zenostat.cli.console import err, out, progress
from zenostat.cli.tables import show, show_json
from zenostat.topics.errors import InvalidConfig

if TYPE_CHECKING:
    from zenostat.bridge.recording.audit_chain import AuditResult
    from zenostat.bridge.recording.verification import Verification

File = Annotated[Path, typer.Argument(help="Recording (`.mcap`) of `zenostat node --record` or `zenostat record`.")]


def verify(
    file: File,
    plant: Annotated[
        str | None,
        typer.Option(
            metavar="FILE.py:CLASS",
            help="For the recording of a Python class: the class, in a file or module with the recorded digest. "
            "Code that a recording names is never run.",
        ),
    ] = None,
    fmu: Annotated[str | None, typer.Option(metavar="FILE.fmu", help="For the recording of an FMU: its file.")] = None,
    grid: Annotated[
        str | None, typer.Option(metavar="FILE.yaml", help="For the recording of an electric grid: its file.")
    ] = None,
    district: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.yaml",
            help="For the recording of a district: its file. Files that a recording names are never read.",
        ),
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            help="Greatest accepted difference, in each point's unit; also compares with a changed model, weather or "
            "EnergyPlus. Default: equal to the bit.",
        ),
    ] = None,
    audit_only: Annotated[
        bool, typer.Option("--audit-only", help="Check only the audit log, without a simulation.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Simulate a recording again with the actuator values of its plant, and compare all values and times.

    Also checks the hash chain of the audit log: which entries were removed, changed or moved. The exit code is 1 if
    anything differs.

    Example: `zenostat verify run.mcap`

    Example: `zenostat verify run.mcap --tolerance 0.01`

    Example: `zenostat verify run.mcap --audit-only`

    Example: `zenostat verify tank.mcap --plant tank.py:Tank`

    Example: `zenostat verify tank.mcap --fmu tank.fmu`

    Example: `zenostat verify district.mcap --district examples/district.yaml`
    """
    from zenostat.topics.extras import requires_extra

    with requires_extra("recording", "a recording", "mcap and zstandard"):
        from zenostat.cosim.verify_recording import verify_district
        from zenostat.eplus_node.verify_recording import verify as verify_recording
    if audit_only:
        _check_audit(file, as_json=as_json)
        return
    if tolerance is not None and not tolerance < float("inf"):
        raise InvalidConfig(f"--tolerance {tolerance}: expected a finite number of at least 0")
    if district is not None and (plant or fmu or grid):
        raise InvalidConfig("--district names the plant of the recording; leave out --plant, --fmu and --grid")
    with ExitStack() as stack:
        bar = _bar(stack, file)
        if district is None:
            result = verify_recording(file, plant=plant, fmu=fmu, grid=grid, tolerance=tolerance, progress=bar)
        else:
            result = verify_district(file, district, tolerance=tolerance, progress=bar)
    if as_json:
        show_json(_json(result))
    else:
        _show(result)
    if not result.passed:
        raise typer.Exit(1)


def _check_audit(file: Path, *, as_json: bool) -> None:
    from zenostat.bridge.recording.audit_chain import check_audit
    from zenostat.bridge.recording.reader import RecordingReader

    with RecordingReader(file) as reader:
        result = check_audit(reader)
        end = reader.end
    if as_json:
        passed = not (result.problems or end.is_damaged)
        show_json({"passed": passed, "audit": _audit_json(result), "end": end.text})
    else:
        out.print(f"{result}{f'; {end.text}' if end.text else ''}")
    if result.problems or end.is_damaged:
        raise typer.Exit(1)


def _audit_json(result: AuditResult) -> dict[str, object]:
    return {"entries": result.entries, "head": result.head, "problems": result.problems}


def _bar(stack: ExitStack, file: Path) -> Callable[[int, int], None]:
    bars = stack.enter_context(progress())
    task = bars.add_task(f"verifying {file.name}", total=None, rate="")
    shown_s = 0.0

    def update(steps: int, total: int) -> None:
        nonlocal shown_s
        if monotonic() - shown_s < 0.1 and steps < total:
            return
        shown_s = monotonic()
        speed = bars.tasks[task].speed
        bars.update(task, completed=steps, total=total, rate=f"{speed:,.0f} steps/s" if speed else "")

    return update


def _show(result: Verification) -> None:
    for note in (*result.notes, *(f"not verified: {text}" for text in result.skipped)):
        err.print(note)
    if result.tolerance is not None:
        rows = [(name, f"{value:.6g}") for name, value in result.greatest.items() if value > 0.0]
        if rows:
            show("greatest differences", ("point", "difference"), rows, right=("difference",))
    out.print(str(result.audit))
    out.print(str(result))


def _json(result: Verification) -> dict[str, object]:
    difference = result.difference
    return {
        "passed": result.passed,
        "steps": result.steps,
        "points": result.points,
        "actuators": result.actuators,
        "difference": None
        if difference is None
        else {name: getattr(difference, name) for name in difference.__slots__},
        "greatest": result.greatest,
        "skipped": result.skipped,
        "notes": result.notes,
        "end": result.end,
        "audit": _audit_json(result.audit),
    }
