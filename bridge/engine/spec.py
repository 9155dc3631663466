"""The specification of an engine: the program that it runs, its points, its folder and its cores."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from zenostat.topics.errors import SimulatorError


@dataclass(frozen=True, slots=True)
class EngineProgram:
    """A simulator that can run as an engine; see `zenostat.bridge.engine.protocol` for what it has to do.

    Attributes:
        command: starts it; the descriptors of its two sockets and the node's process id are appended.
        environment: variables that are added to those of the node.
        prints: whether its standard output and standard error go to the node's standard error.
        failure: returns the error for a text that the engine sent before it ended, and its folder.
        leads_session: whether it runs in a session of its own, which is killed when it ends.
        explain: returns the reason why an engine ended, from its folder and the end of its output.
    """

    command: tuple[str, ...]
    failure: Callable[[str, Path], SimulatorError]
    explain: Callable[[Path, str], str] = lambda _, output: output
    environment: Mapping[str, str] = field(default_factory=dict)
    prints: bool = False
    leads_session: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class EngineSpec:
    """Specification of an engine.

    Attributes:
        folder: its working files; removed when it ends, unless `keep_output`.
        values: number of sensors and meters.
        actuators: number of actuators.
        feedback: indices of the actuators whose effective value the engine reports.
        run: fields of the simulator's own, as JSON built-ins.
        keep_output: keep the folder and let the simulator finish its files.
        cpus: cores on which the engine may run; empty leaves it to the system.
        poll: whether the engine polls for orders before it sleeps.
        close_s: time that the simulator may take to release what it holds when it is ended; 0: it is killed at once.
        branch: end the process at its last sample, without the simulator's own end of run.
        replaced_file: for a fork that continues to read another file: the file, the other one, and the offset up to
            which they are equal.
        state: for a new process: the file with the state in which it begins, from `EngineClient.save`.
        forecast_error: for a fork that simulates a weather forecast: errors of the outdoor temperature, K.
    """

    program: EngineProgram
    folder: Path
    values: int
    actuators: int
    feedback: tuple[int, ...] = ()
    run: Mapping[str, Any] = field(default_factory=dict)
    keep_output: bool = False
    cpus: tuple[int, ...] = ()
    poll: bool = False
    close_s: float = 0.0
    branch: bool = False
    replaced_file: tuple[str, str, int] | None = None
    state: Path | None = None
    forecast_error: tuple[float, ...] = ()

    def fields(self) -> dict[str, Any]:
        """Return the fields that the engine reads first."""
        return {**self.run, **self.fork_fields(), "state": self.state and str(self.state)}

    def fork_fields(self) -> dict[str, Any]:
        """Return the fields that may differ in a fork."""
        return {
            "folder": str(self.folder),
            "keep": self.keep_output,
            "parent": os.getpid(),
            "cpus": self.cpus,
            "poll": self.poll,
            "branch": self.branch,
            "replaced_file": self.replaced_file,
            "forecast_error": self.forecast_error,
        }
