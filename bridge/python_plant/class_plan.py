"""A Python class that has been checked and described, in a process of its own, before it becomes a plant."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from time import monotonic
from typing import Any

from zenostat.bridge.engine.spec import EngineProgram
from zenostat.bridge.node.plant import PlantDescription, Provenance, RunPeriod
from zenostat.bridge.python_plant.description import split_name
from zenostat.bridge.runtime.idle_watch import LOOK_S, IdleWatch
from zenostat.topics import VERSION, errors
from zenostat.topics.errors import EngineDied, EngineUnresponsive, PlantFailed
from zenostat.topics.messages import Action, Actuator, ElectricGrid, Meter, Sensor, Systems, Task, TimeField, Versions

HOST = (sys.executable, "-P", "-m", "zenostat.bridge.python_plant.host")

PYTHON = EngineProgram(
    command=HOST,
    failure=lambda text, _: PlantFailed(text),
    explain=lambda *_: "its output is in that of the node",
    # A process with threads, such as those of linear algebra libraries, cannot be forked.
    environment=dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
    prints=True,
    leads_session=True,
)


@dataclass(frozen=True, slots=True)
class ClassPlan:
    """A class that has been checked.

    Attributes:
        plant: file or module, and class.
        arguments: of the class, JSON built-ins.
        forkable, has_state: whether it can be copied by a fork, or by its state.
        has_close: whether it has something to release at its end.
        begins_alike: whether all episodes begin alike.
        copy_error: why it cannot be copied, if its class says so.
    """

    plant: str
    arguments: Mapping[str, Any]
    description: PlantDescription
    forkable: bool
    has_state: bool
    has_close: bool = False
    begins_alike: bool = False
    copy_error: str = ""


def plan_class(
    plant: str, arguments: Mapping[str, Any], unresponsive_s: float, *, own_class: bool = False
) -> ClassPlan:
    """Check a plant's class and describe it, in a process of its own.

    Args:
        plant: `FILE.py:CLASS` or `MODULE:CLASS`.
        arguments: of the class, JSON built-ins.
        unresponsive_s: time after which a process that does not use processor time is killed.
        own_class: reject a class that the file or the module only imports.

    Raises:
        InvalidConfig: there is no such class, it does not take the arguments, or it lacks something; lists all errors.
        PlantFailed: its code raised an error; the text has the traceback.
        EngineDied, EngineUnresponsive: the process ended, or does not answer.
    """
    request = json.dumps({"plant": plant, "arguments": dict(arguments), "own_class": own_class, "parent": os.getpid()})
    environment = {**os.environ, **PYTHON.environment}
    process = subprocess.Popen(
        [*HOST, "describe"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
        start_new_session=True,  # Ctrl-C in the terminal is for the node
    )
    with process:
        try:
            output = _communicate(process, request + "\n", plant, unresponsive_s)
        finally:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)  # with what the class has started
            process.wait()  # after a KeyboardInterrupt, `with` does not wait
    try:
        fields = json.loads(output)
    except ValueError:
        raise EngineDied(f"plant {plant!r} could not be created: its process {_end(process.returncode)}") from None
    if "error" in fields:
        raise errors.from_wire(fields)
    description = replace(_describe(fields), provenance=_provenance(plant, arguments, fields["file"], fields["files"]))
    flags = {name: fields[name] for name in ("forkable", "has_state", "has_close", "begins_alike", "copy_error")}
    return ClassPlan(plant, dict(arguments), description, **flags)


def _provenance(plant: str, arguments: Mapping[str, Any], source: str, inputs: Mapping[str, str]) -> Provenance:
    """Name the class, the file that defines it, `source`, and its `inputs`; modules that it imports are not named."""
    place, name = split_name(plant)
    is_file = place.endswith(".py")
    file = Path(place if is_file else source).absolute()
    files = {"class": file} if is_file or source.endswith(".py") else {}
    path = f"{file}:{name}" if is_file else plant
    files |= {role: Path(name) for role, name in inputs.items()}
    return Provenance("python", {"plant": path, "plant_arguments": dict(arguments)}, files)


def _end(code: int) -> str:
    return f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"


def _communicate(process: subprocess.Popen[str], request: str, plant: str, unresponsive_s: float) -> str:
    watch, last_s = IdleWatch(process.pid), monotonic()
    text: str | None = request
    while True:
        try:
            return process.communicate(text, timeout=LOOK_S)[0]
        except subprocess.TimeoutExpired:
            text, waited_s, last_s = None, monotonic() - last_s, monotonic()
        if watch.look(min(waited_s, 2.0 * LOOK_S)) >= unresponsive_s:
            raise EngineUnresponsive(
                f"plant {plant!r} could not be created: its process used no processor time for {unresponsive_s:g} s"
            )


def _describe(fields: Mapping[str, Any]) -> PlantDescription:
    def points(kind: str, last: str = "") -> list[dict[str, Any]]:
        names = ("name", "unit", "low", "high", *([last] if last else []))
        return [{name: point[name] for name in names} for point in fields[kind]]

    actuators = tuple(Actuator(**point) for point in points("actuators", "default"))
    by_name = {actuator.name: actuator for actuator in actuators}
    actions = tuple(
        Action(name=a.name, unit=a.unit, low=a.low, high=a.high, actuators=(a.name,))
        for a in (by_name[name] for name in fields["actions"])
    )
    return PlantDescription(
        name=fields["name"],
        run_period=RunPeriod(datetime.fromisoformat(fields["begin"]), fields["step_s"], fields["steps"]),
        sensors=tuple(Sensor(**point) for point in points("sensors", "aggregation")),
        meters=tuple(Meter(**point) for point in points("meters")),
        actuators=actuators,
        versions=Versions(zenostat=VERSION),
        warnings=tuple(fields["warnings"]),
        task=Task(
            scenario=fields["name"],
            time=tuple(TimeField(field) for field in fields["time"]),
            actions=actions,
            reward=fields["reward"],
        ),
        systems=Systems(grids=(ElectricGrid.model_validate(fields["diagram"]),)) if fields["diagram"] else None,
        without_geometry=f"the plant {fields['name']!r} is a Python class, which has no geometry",
        without_semantic=f"the plant {fields['name']!r} is a Python class, which has no semantic model",
    )
