"""SSP files that tests make: tanks in nested systems, with parameters in documents of their own."""

from __future__ import annotations

import zipfile
from pathlib import Path

SPACES = "".join(
    f' xmlns:{prefix}="http://ssp-standard.org/SSP1/SystemStructure{name}"'
    for prefix, name in (
        ("ssc", "Common"), ("ssd", "Description"), ("ssm", "ParameterMapping"), ("ssv", "ParameterValues")
    )
)  # fmt: skip

LOSS = "body.loss[1,2]"
"""The tank's parameter."""


def connector(name: str, kind: str, unit: str = "") -> str:
    """Return a connector."""
    inside = f'<ssc:Real unit="{unit}"/>' if unit else ""
    return f'<ssd:Connector name="{name}" kind="{kind}">{inside}</ssd:Connector>'


def component(name: str, inside: str = "", attributes: str = "", connectors: str = "") -> str:
    """Return a tank."""
    connectors = connectors or connector("heat", "input") + connector("T", "output") + connector("power", "output")
    return (
        f'<ssd:Component name="{name}" source="resources/tank.fmu" {attributes}>'
        f"<ssd:Connectors>{connectors}</ssd:Connectors>{inside}</ssd:Component>"
    )


def connection(start: str, end: str, inside: str = "", attributes: str = "") -> str:
    """Return a connection; an end is `element:connector`, or `:connector` of the system itself."""
    text = ""
    for side, (element, _, name) in (("start", start.partition(":")), ("end", end.partition(":"))):
        text += (f' {side}Element="{element}"' if element else "") + f' {side}Connector="{name}"'
    return f"<ssd:Connection{text} {attributes}>{inside}</ssd:Connection>"


def linear(factor: float, offset: float = 0.0) -> str:
    """Return a linear transformation."""
    return f'<ssc:LinearTransformation factor="{factor}" offset="{offset}"/>'


def system(name: str, elements: str, connections: str = "", connectors: str = "", inside: str = "") -> str:
    """Return a system."""
    connectors = f"<ssd:Connectors>{connectors}</ssd:Connectors>" if connectors else ""
    connections = f"<ssd:Connections>{connections}</ssd:Connections>" if connections else ""
    return (
        f'<ssd:System name="{name}">{connectors}{inside}<ssd:Elements>{elements}</ssd:Elements>'
        f"{connections}</ssd:System>"
    )


def units(space: str, **bases: str) -> str:
    """Return definitions of units by the attributes of their base units; `_per_` is a slash."""
    each = (
        f'<ssc:Unit name="{n.replace("_per_", "/")}"><ssc:BaseUnit {base}/></ssc:Unit>' for n, base in bases.items()
    )
    return f"<{space}:Units>{''.join(each)}</{space}:Units>"


def parameter_set(*values: str, units: str = "") -> str:
    """Return a set of parameters, each such as `<ssv:Parameter …>`, and the definitions of their units."""
    inside = f"<ssv:Parameters>{''.join(values)}</ssv:Parameters>{units}"
    return f'<ssv:ParameterSet{SPACES} version="1.0" name="s">{inside}</ssv:ParameterSet>'


def real(name: str, value: float, unit: str = "") -> str:
    """Return a number for a parameter."""
    attributes = f' unit="{unit}"' if unit else ""
    return f'<ssv:Parameter name="{name}"><ssv:Real value="{value}"{attributes}/></ssv:Parameter>'


def bindings(*each: str) -> str:
    """Return bindings of parameters."""
    return f"<ssd:ParameterBindings>{''.join(each)}</ssd:ParameterBindings>"


def mapping(*entries: str) -> str:
    """Return a mapping of parameters, each entry such as `<ssm:MappingEntry …>`."""
    inside = f'<ssm:ParameterMapping{SPACES} version="1.0">{"".join(entries)}</ssm:ParameterMapping>'
    return f"<ssd:ParameterMapping>{inside}</ssd:ParameterMapping>"


def inline(values: str, attributes: str = "", mapping: str = "") -> str:
    """Return a binding of a set that is in the description itself."""
    return (
        f"<ssd:ParameterBinding {attributes}><ssd:ParameterValues>{values}</ssd:ParameterValues>{mapping}"
        "</ssd:ParameterBinding>"
    )


def write_ssp(
    path: Path,
    tank: Path,
    root: str,
    stop_s: float = 1200,
    files: dict[str, str] | None = None,
    units: str = "",
    step_s: float | None = 60.0,
) -> Path:
    """Write an SSP file and return its path.

    Args:
        path: the file.
        tank: the FMU of its components.
        root: the system.
        stop_s: end of the default experiment, in s.
        files: further documents by their path.
        units: definitions of units.
        step_s: step size of the master algorithm; None for a file that names none.
    """
    size = "" if step_s is None else f'stepSize="{step_s}"'
    annotation = f'<ssc:Annotation type="org.tool"><o:FixedStepMaster xmlns:o="urn:tool" {size}/></ssc:Annotation>'
    text = (
        f'<?xml version="1.0"?>\n<ssd:SystemStructureDescription{SPACES} version="1.0" name="two tanks">\n{root}\n'
        f"{units}"
        f'<ssd:DefaultExperiment startTime="0" stopTime="{stop_s}"><ssd:Annotations>{annotation}</ssd:Annotations>'
        "</ssd:DefaultExperiment></ssd:SystemStructureDescription>"
    )
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("SystemStructure.ssd", text)
        archive.write(tank, "resources/tank.fmu")
        for name, content in (files or {}).items():
            archive.writestr(name, content)
    return path


TWO_TANKS = system(
    "Plant",
    component("first") + system(
        "sub",
        component("second tank", bindings(inline(parameter_set(real(LOSS, 4.0))))),
        connection(":t_in", "second tank:heat") + connection("second tank:power", ":p_out"),
        connector("t_in", "input") + connector("p_out", "output"),
    ),
    connection("first:T", "sub:t_in", linear(-20.0, 2000.0), 'suppressUnitConversion="true"')
    + connection("first:heat", "sub:p_out", linear(0.5)),
    inside=bindings('<ssd:ParameterBinding source="values.ssv" prefix="first."/>'),
)  # fmt: skip
"""A system with one in it: each tank heats by the other one's state, a connection is drawn backward."""

VALUES = {"values.ssv": parameter_set(real(LOSS, 3.0, "W/K"))}
"""The document with the parameters of `TWO_TANKS`."""
