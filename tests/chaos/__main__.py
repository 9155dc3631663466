"""`python -m chaos`: a run, its summary, and exit code 1 if anything that must hold does not."""

import argparse
import os
import random
import shutil
import sys
import tempfile
from pathlib import Path

from rich.console import Console

from chaos.invariants import judge
from chaos.report import BEGIN, END, put, show
from chaos.run import run


def main() -> int:
    """Runs, judges, tells; the journals of a run that breaks something are kept."""
    parser = argparse.ArgumentParser(prog="chaos", description=__doc__)
    parser.add_argument("--seconds", type=float, default=120.0, help="how long they are troubled; 10 at least")
    parser.add_argument("--seed", type=int, help="of the script; drawn and printed if it is not given")
    parser.add_argument("--table", type=Path, help="a page to put the table into, between its marks")
    asked = parser.parse_args()
    if asked.seconds < 10:
        parser.error("--seconds: 10 at least")
    if asked.table is not None and not all(mark in asked.table.read_text() for mark in (BEGIN, END)):
        parser.error(f"--table: {asked.table} needs the lines {BEGIN!r} and {END!r}")
    seed = random.SystemRandom().randrange(1_000_000) if asked.seed is None else asked.seed
    console = Console()
    console.print(f"chaos for {asked.seconds:g} s with seed {seed}", highlight=False)
    where = tempfile.gettempdir()
    # The path of a unix socket has 108 bytes at most.
    folder = Path(tempfile.mkdtemp(prefix="chaos-", dir=where if len(where) < 60 else "/tmp")).resolve()
    os.environ["TMPDIR"], tempfile.tempdir = str(folder), None  # of all programs: what they leave is found
    verdict = None
    try:
        verdict = judge(run(folder, seconds=asked.seconds, seed=seed))
        show(verdict, console)
        if asked.table is not None:
            put(verdict, asked.table)
    finally:
        if verdict is not None and verdict.holds:
            shutil.rmtree(folder)
        else:
            console.print(f"broken with seed {seed}; what was sent and heard is in {folder}", style="red")
    return 0 if verdict.holds else 1


if __name__ == "__main__":
    sys.exit(main())
