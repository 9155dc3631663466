"""Start the process of an engine, and describe how it ended."""

from __future__ import annotations

import os
import signal
import subprocess

from zenostat.bridge.engine.process_handle import Process
from zenostat.bridge.engine.sockets import SocketPair, socket_pairs
from zenostat.bridge.engine.spec import EngineSpec

LOG = "engine.log"
"""Name of the file in the engine's folder that receives its standard error."""


def launch(spec: EngineSpec) -> tuple[SocketPair, Process]:
    """Start an engine process, which waits for its run description."""
    ours, theirs = socket_pairs()
    with theirs, (spec.folder / LOG).open("wb") as log:
        process = subprocess.Popen(
            [*spec.program.command, *map(str, theirs.descriptors), str(os.getpid())],
            pass_fds=theirs.descriptors,
            env={**os.environ, **spec.program.environment},
            stdin=subprocess.DEVNULL,
            stdout=2 if spec.program.prints else subprocess.DEVNULL,
            stderr=2 if spec.program.prints else log,
            start_new_session=spec.program.leads_session,
        )
    return ours, process


def describe_exit(spec: EngineSpec, code: int, step: int) -> str:
    """Return how an engine's process ended after a sample, with the end of its output."""
    how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"
    log = spec.folder / LOG
    lines = log.read_text(errors="replace").strip().splitlines()[-3:] if log.exists() else []
    output = "\n  ".join(["its last output:", *lines]) if lines else "it printed no error"
    return f"the engine process {how} after sample {step}; {spec.program.explain(spec.folder, output)}"
