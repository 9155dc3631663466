"""An FMU's file: unpacked once, its model description, and what of it cannot be simulated."""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from math import isfinite, prod
from pathlib import Path
from typing import Any

from zenostat.plants.fmi.variables import FLOATING, NUMERIC, number, settable_bounds
from zenostat.topics.cache import cached_dir
from zenostat.topics.errors import InvalidConfig, did_you_mean
from zenostat.topics.extras import import_extra
from zenostat.topics.plurals import counted
from zenostat.topics.user_file import check_user_file

CO_SIMULATION, MODEL_EXCHANGE = "CoSimulation", "ModelExchange"
MAX_BYTES = 4 << 30
"""Largest size of an FMU that is unpacked."""
_MAX_NAMED = 5
"""Variables that a text names."""


@dataclass(frozen=True, slots=True)
class Model:
    """An FMU that can be simulated.

    Attributes:
        file: the FMU.
        folder: its unpacked content.
        description: FMPy's model description.
        interface: `CoSimulation` or `ModelExchange`.
        notes: properties of the FMU that are not used, a sentence each.
    """

    file: Path
    folder: Path
    description: Any
    interface: str
    notes: tuple[str, ...]


def fmpy() -> Any:
    """Import FMPy.

    Raises:
        InvalidConfig: it is not installed; the text has the command that installs it.
    """
    return import_extra("fmpy", "fmi", "an FMU")


def read_model(file: Path, interface: str | None) -> Model:
    """Read an FMU and unpack it; nothing of it runs.

    Args:
        file: the FMU.
        interface: `CoSimulation` or `ModelExchange`; None prefers co-simulation.

    Raises:
        InvalidConfig: it is no FMU, or none that can be simulated; the text names the reason.
    """
    library = fmpy()
    check_user_file(file, expected="an FMU")
    with _as_config_error(file):
        with zipfile.ZipFile(file) as archive:
            names = set(archive.namelist())
            size = sum(entry.file_size for entry in archive.infolist())
        if size > MAX_BYTES:
            raise InvalidConfig(f"{file} would take {size:,} bytes unpacked; at most {MAX_BYTES:,} are allowed")
        if "modelDescription.xml" not in names:
            raise InvalidConfig(f"{file} is no FMU: it has no modelDescription.xml")
        description = library.read_model_description(str(file), validate=False)
    _check_platform(file, library)
    chosen = _interface(file, description, interface)
    _check_variables(file, description)
    with _as_config_error(file):
        key = hashlib.sha256(file.read_bytes()).hexdigest()[:24]
        folder = cached_dir(f"fmu/{key}", lambda path: library.extract(str(file), str(path)))
    notes = (*_invalid(file, library), *_unused(description, chosen, names))
    return Model(file, folder, description, chosen, notes)


@contextmanager
def _as_config_error(file: Path) -> Iterator[None]:
    """Raise whatever FMPy raises for a file that it cannot read as one error that names the file."""
    try:
        yield
    except InvalidConfig:
        raise
    except zipfile.BadZipFile:
        raise InvalidConfig(f"{file} is no FMU: it is not a ZIP file") from None
    except Exception as error:
        raise InvalidConfig(f"{file} cannot be read as an FMU: {error}") from None


def _check_platform(file: Path, library: Any) -> None:
    platforms = library.supported_platforms(str(file))
    if library.platform not in platforms:
        binaries = [name for name in platforms if name != "c-code"]
        has = f"has binaries for {', '.join(binaries)}" if binaries else "has no binaries"
        raise InvalidConfig(f"{file} {has}; one for {library.platform} is needed: export it for this platform")


def _interface(file: Path, description: Any, wanted: str | None) -> str:
    version = description.fmiVersion
    if version != "2.0" and not version.startswith("3.0"):
        raise InvalidConfig(f"{file} is an FMU of FMI {version}; export it for FMI 2.0 or 3.0")
    present = {CO_SIMULATION: description.coSimulation, MODEL_EXCHANGE: description.modelExchange}
    if wanted is not None and wanted not in present:
        raise InvalidConfig(f"interface {wanted!r}: CoSimulation or ModelExchange expected")
    chosen = wanted or (CO_SIMULATION if description.coSimulation is not None else MODEL_EXCHANGE)
    if present[chosen] is None:
        kinds = [name for name, part in present.items() if part is not None]
        kinds += ["ScheduledExecution"] if description.scheduledExecution is not None else []
        raise InvalidConfig(f"{file} has the interface {' and '.join(kinds)}, not {wanted or CO_SIMULATION}")
    if chosen == MODEL_EXCHANGE and version != "2.0":
        raise InvalidConfig(f"{file}: model exchange of FMI {version} is not supported; export it for co-simulation")
    return chosen


def _check_variables(file: Path, description: Any) -> None:
    clocks = [v.name for v in description.modelVariables if v.type == "Clock" and v.causality == "input"]
    if clocks:
        raise InvalidConfig(f"{file} has input clocks ({_some(clocks)}), which are not supported")
    texts = [v.name for v in description.modelVariables if v.causality == "input" and v.type not in NUMERIC]
    without_start = [v.name for v in description.modelVariables if v.name in texts and v.start is None]
    if without_start:
        raise InvalidConfig(f"{file} has inputs that are not numbers and have no start value: {_some(without_start)}")


def _invalid(file: Path, library: Any) -> Iterator[str]:
    try:
        library.read_model_description(str(file), validate=True)
    except Exception as error:
        lines = [line.strip("- ") for line in str(error).splitlines() if line.startswith("- ")] or [str(error)]
        more = f" (and {len(lines) - 1} more errors)" if len(lines) > 1 else ""
        yield f"the FMU's model description is not valid: {lines[0]}{more}"


def _unused(description: Any, interface: str, names: set[str]) -> Iterator[str]:
    part = description.coSimulation if interface == CO_SIMULATION else description.modelExchange
    variables = description.modelVariables
    if clocks := [v.name for v in variables if v.type == "Clock"]:
        yield f"the FMU's clocks are not used: {_some(clocks)}"
    if getattr(part, "providesIntermediateUpdate", False):
        yield "the FMU's intermediate update is not used: inputs are constant during a timestep"
    if getattr(part, "hasEventMode", False):
        yield "the FMU's event mode is not used: it handles its events within the timestep"
    if any(name.startswith("terminalsAndIcons/") and name.endswith(".xml") for name in names):
        yield "the FMU's terminals are not used: each of their variables is a point of its own"
    if part.needsExecutionTool:
        yield "the FMU needs the tool that exported it, which must be installed"
    texts = [v.name for v in variables if v.causality in {"input", "output"} and v.type not in {*NUMERIC, "Clock"}]
    if texts:
        yield f"the FMU's texts and binary values are no points: {_some(texts)}"


def _some(names: list[str]) -> str:
    more = f" and {len(names) - _MAX_NAMED} more" if len(names) > _MAX_NAMED else ""
    return ", ".join(names[:_MAX_NAMED]) + more


def check_starts(description: Any, starts: Mapping[str, Any]) -> dict[str, Any]:
    """Check start values that a user sets, by the name of the variable, and return them in FMPy's form.

    Raises:
        InvalidConfig: there is no such variable, it cannot be set, or the value is not valid; lists all errors.
    """
    by_name = {variable.name: variable for variable in description.modelVariables}
    errors, values = [], {}
    for name, value in starts.items():
        if name not in by_name:
            settable = [v.name for v in by_name.values() if v.causality in {"parameter", "input"}]
            errors.append(f"set: the FMU has no variable {name!r}; {did_you_mean(name, settable)}")
        elif error := _start_error(by_name[name], value):
            errors.append(f"set: {name} = {value!r}: {error}")
        else:
            values[name] = _fmpy_value(by_name[name], value)
    if errors:
        raise InvalidConfig("\n".join(errors))
    return values


def _fmpy_value(variable: Any, value: Any) -> Any:
    if variable.type not in NUMERIC:
        return value
    kind = bool if variable.type == "Boolean" else float if variable.type in FLOATING else int
    return [kind(number(part)) for part in value] if isinstance(value, list) else kind(number(value))


def _start_error(variable: Any, value: Any) -> str:
    if variable.causality == "structuralParameter":
        return "structural parameters, which change the sizes of arrays, are not supported"
    is_input = variable.causality == "input"
    if not is_input and (variable.variability == "constant" or variable.initial not in {"exact", "approx"}):
        article = "an" if variable.causality[0] in "aeiou" else "a"
        return (
            f"it is {article} {variable.causality} that the FMU calculates; only parameters, inputs and start values "
            "can be set"
        )
    if variable.type == "String":
        return "" if isinstance(value, str) else "a text expected"
    if variable.type not in NUMERIC:
        return f"a variable of type {variable.type} cannot be set"
    return _number_error(variable, value)


def _number_error(variable: Any, value: Any) -> str:
    parts = value if isinstance(value, list) else [value]
    count = prod(map(int, variable.shape or ()))
    if len(parts) != count:
        return f"{counted(count, 'value')} expected"
    low, high = settable_bounds(variable)
    for part in parts:
        try:
            numeric = number(part)
        except (TypeError, ValueError):
            return "a number expected"
        if not isfinite(numeric):
            return "a finite number expected"
        if not (low is None or low <= numeric) or not (high is None or numeric <= high):
            limits = [f"at least {low:g}"] if low is not None else []
            limits += [f"at most {high:g}"] if high is not None else []
            return f"out of bounds; {' and '.join(limits)} expected"
        if variable.type not in {*FLOATING, "Boolean"} and numeric != int(numeric):
            return "a whole number expected"
    return ""
