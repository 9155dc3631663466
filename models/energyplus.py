"""Run EnergyPlus once, in a separate process, to convert a model, list its points, compute schedules or simulate.

A model can make EnergyPlus terminate its process, so nothing here runs in the caller's. The child process is this
module as a program: `python -m zenostat.models.energyplus convert|survey|schedules|simulate …`.
"""

from __future__ import annotations

import ctypes
import json
import os
import signal
import sqlite3
import subprocess
import sys
from array import array
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from string import ascii_lowercase, ascii_uppercase
from typing import Any

from zenostat.models.engine_library import engine_library, key_pattern, new_api
from zenostat.models.err_file import explain
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.errors import ModelError

ISOLATED = (sys.executable, "-P", "-m")
"""Command prefix for a package's programs: `-P` excludes the caller's folder from imports."""

_UPPER = str.maketrans(ascii_lowercase, ascii_uppercase)
"""EnergyPlus converts names to upper case, but in them only the letters of ASCII."""

_ACTIONS = {"convert": "convert", "survey": "start", "schedules": "compute the schedules of", "simulate": "simulate"}
"""What EnergyPlus does for each verb, for errors."""


def call(
    verb: str, *arguments: str | Path, file: str | Path | None = None, locate: Callable[[str], str | None] | None = None
) -> None:
    """Run this module as a program, which writes its result to the file that the last argument names.

    Args:
        verb: `convert`, `survey`, `schedules` or `simulate`.
        arguments: of the program.
        file: the file that an error refers to; the first argument if None.
        locate: finds the place in the user's file that a message is about; see `zenostat.models.err_file.explain`.

    Raises:
        ModelError: the child failed; the text has the severe messages of `eplusout.err`.
    """
    folder = Path(arguments[-1]).parent
    finished = subprocess.run(
        [*ISOLATED, "zenostat.models.energyplus", verb, *map(str, arguments)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if not Path(arguments[-1]).exists():
        code, source = finished.returncode, Path(file or arguments[0])
        output = (finished.stdout or "").strip().splitlines()[-5:]
        fallback = "\n  ".join([f"It exited with code {code} and this output:", *output])
        reports = sorted(folder.rglob("eplusout.err"), key=lambda path: path.stat().st_mtime_ns)
        reason = explain(reports[-1].parent if reports else folder, fallback, locate=locate)
        crash = f": it crashed ({signal.Signals(-code).name})" if code < 0 else ""
        raise ModelError(f"EnergyPlus could not {_ACTIONS[verb]} {source}{crash}. {reason}")


def version() -> str:
    """Return the version of the engine that runs: `25.2.0`."""
    return engine_library().version


def library() -> Path:
    """Return the path of the engine's library."""
    return engine_library().path


def _convert(source: str, target: str) -> None:
    folder = os.path.dirname(target)
    dictionary = os.path.join(folder, "none.idd")
    with open(dictionary, "w"):
        pass  # the wheel has no Energy+.idd; any file will do, since EnergyPlus reads its own schema
    api = new_api()
    state = api.state_manager.new_state()
    api.runtime.set_console_output_status(state, False)
    api.runtime.run_energyplus(state, ["--convert-only", "-i", dictionary, "-d", folder, source])
    converted = os.path.join(folder, os.path.splitext(os.path.basename(source))[0] + ".epJSON")
    if os.path.exists(converted):
        os.replace(converted, target)


def _survey(model: str, weather: str, target: str) -> None:
    """List a model's points in two passes: the first finds its variables, the second requests each with every key.

    The API's list omits integer variables (a status, a type, a count) although it can read them; EnergyPlus's own
    dictionary of reported variables, in its SQLite file, has them.
    """
    folder = os.path.dirname(target)
    with open(model) as file:
        prepared: dict[str, Any] = json.load(file)
    prepared["Output:VariableDictionary"] = {"dictionary": {"key_field": "regular"}}
    _run_until_ready(prepared, weather, os.path.join(folder, "names"))
    kinds = _variable_kinds(os.path.join(folder, "names", "eplusout.rdd"))
    prepared["Output:Variable"] = {
        f"v{i}": {"key_value": "*", "variable_name": name, "reporting_frequency": "RunPeriod"}
        for i, name in enumerate(kinds)
    }
    prepared["Output:SQLite"] = {"dictionary": {"option_type": "Simple"}}
    points = _run_until_ready(prepared, weather, os.path.join(folder, "keys"))
    points += _unlisted_variables(points, os.path.join(folder, "keys", "eplusout.sql"))
    with atomic_file(Path(target)) as temporary:
        temporary.write_text(json.dumps({"kinds": kinds, "points": points}))


def _variable_kinds(dictionary: str) -> dict[str, list[str]]:
    """Read `eplusout.rdd`: variable name to [zone or hvac, average or sum]."""
    kinds: dict[str, list[str]] = {}
    with open(dictionary) as file:
        for line in file:
            parts = line.rstrip("\n").split(",", 2)
            if len(parts) == 3 and parts[0] in ("Zone", "HVAC"):
                name = parts[2].rsplit("[", 1)[0].strip()
                kinds[name] = [parts[0].lower(), parts[1].lower()]
    return kinds


def _unlisted_variables(points: list[list[str]], report: str) -> list[list[str]]:
    """Return the variables that EnergyPlus can report and `points` lacks, in the format of `points`."""
    listed = {(name.casefold(), key.casefold()) for kind, name, key, *_ in points if kind == "OutputVariable"}
    with closing(sqlite3.connect(report)) as file:
        rows = file.execute("SELECT Name, KeyValue, Units FROM ReportDataDictionary WHERE IsMeter = 0 ORDER BY 1, 2")
        return [
            ["OutputVariable", name, key.translate(_UPPER), "", unit or ""]  # as in the API's list
            for name, key, unit in rows
            if (name.casefold(), key.casefold()) not in listed
        ]


def _run_until_ready(model: dict[str, Any], weather: str, folder: str) -> list[list[str]]:
    """Start a run, stop it once the API's lists of points are complete, and return these."""
    os.makedirs(folder)
    path = os.path.join(folder, "in.epJSON")
    with open(path, "w") as file:
        json.dump(model, file)
    api = new_api()
    state = api.state_manager.new_state()
    api.runtime.set_console_output_status(state, False)
    points: list[list[str]] = []

    def ready(running: Any) -> None:
        if not points and api.exchange.api_data_fully_ready(running):
            points.extend([p.what, p.name, p.key, p.type, p.unit] for p in api.exchange.get_api_data(running))
            api.runtime.stop_simulation(running)

    api.runtime.callback_begin_new_environment(state, ready)
    api.runtime.run_energyplus(state, ["-w", weather, "-d", folder, path])
    if not points:
        sys.exit("EnergyPlus stopped before its first environment")
    return points


def _schedules(model: str, names: str, weather: str, target: str) -> None:
    """Write the values of schedules in each timestep, row by row, as float64."""
    api = new_api()
    exchange, state = api.exchange, api.state_manager.new_state()
    api.runtime.set_console_output_status(state, False)
    keys = json.loads(names)
    for key in keys:
        exchange.request_variable(state, "Schedule Value", key_pattern(key))
    values, handles = array("d"), list[int]()

    def read(running: Any) -> None:
        if exchange.warmup_flag(running):
            return
        if not handles:
            handles.extend(exchange.get_variable_handle(running, "Schedule Value", key) for key in keys)
        values.extend(exchange.get_variable_value(running, handle) for handle in handles)

    api.runtime.callback_end_zone_timestep_after_zone_reporting(state, read)
    code = api.runtime.run_energyplus(state, ["-w", weather, "-d", os.path.dirname(target), model])
    if code == 0 and min(handles) >= 0:
        with atomic_file(Path(target)) as temporary:
            temporary.write_bytes(values.tobytes())


def _simulate(model: str, weather: str, target: str) -> None:
    """Simulate a model to its end; EnergyPlus's reports are in the folder of the target, an empty file."""
    set_parent_death_signal = 1  # a long run must not outlive the process that waits for it
    ctypes.CDLL(None).prctl(set_parent_death_signal, signal.SIGKILL)
    api = new_api()
    state = api.state_manager.new_state()
    api.runtime.set_console_output_status(state, False)
    if api.runtime.run_energyplus(state, ["-w", weather, "-d", os.path.dirname(target), model]) == 0:
        Path(target).touch()


if __name__ == "__main__":
    verbs: dict[str, Callable[..., None]] = {
        "convert": _convert, "survey": _survey, "schedules": _schedules, "simulate": _simulate,
    }  # fmt: skip
    verbs[sys.argv[1]](*sys.argv[2:])
