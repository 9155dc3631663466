"""Model description of a node's FMU, as FMI 2.0 defines it for co-simulation, and the constants of its binary."""

from __future__ import annotations

import json
import math
import uuid
from collections.abc import Iterable, Sequence
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from zenostat.gateways.points import Reading, readings
from zenostat.topics.keys import safe_name
from zenostat.topics.messages import Actuator, Manifest
from zenostat.topics.points import bounds
from zenostat.topics.units import conversion

_PARAMETERS = ("address", "seed")
_NAMESPACE = uuid.UUID("5b0bd4d5-6ef4-55c1-9b3a-2f1f7f6b6a0e")
_SI: dict[str, dict[str, float]] = {
    "K": {"K": 1},
    "deltaC": {"K": 1},
    "W": {"kg": 1, "m": 2, "s": -3},
    "var": {"kg": 1, "m": 2, "s": -3},
    "VA": {"kg": 1, "m": 2, "s": -3},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "A": {"A": 1},
    "W/m2": {"kg": 1, "s": -3},
    "J": {"kg": 1, "m": 2, "s": -2},
    "J/kg": {"m": 2, "s": -2},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "kg": {"kg": 1},
    "kg/s": {"kg": 1, "s": -1},
    "kg/m3": {"kg": 1, "m": -3},
    "m": {"m": 1},
    "m2": {"m": 2},
    "m3": {"m": 3},
    "L": {"m": 3, "factor": 1e-3},
    "m3/s": {"m": 3, "s": -1},
    "m/s": {"m": 1, "s": -1},
    "s": {"s": 1},
    "hr": {"s": 1, "factor": 3600},
    "day": {"s": 1, "factor": 86400},
    "rad": {"rad": 1},
    "deg": {"rad": 1, "factor": math.pi / 180},
    "rev/min": {"rad": 1, "s": -1, "factor": math.pi / 30},
    "1": {},
    "count": {},
    "kgWater/kgDryAir": {},
    "ppm": {"factor": 1e-6},
}
"""Base units, factors and offsets of units, as FMI defines them; those of other units of a quantity follow."""


def _base_unit(unit: str) -> dict[str, float] | None:
    """Return a unit's exponents of SI base units, factor and offset; None of an opaque name."""
    if unit in _SI:
        return _SI[unit]
    for base, exponents in _SI.items():
        if converted := conversion(unit, base):
            factor, offset = converted
            return {**exponents, "factor": factor, "offset": offset}
    return None


class Interface:
    """The interface of a node as an FMU: outputs, inputs, and the GUID that stands for them.

    Attributes:
        manifest: of the node.
        outputs: sensors and meters; amounts of a timestep, such as those of meters, are mean rates.
        output_names: names of the outputs' variables: those of the points, with a number where an input or a parameter
            has that name.
        actuators: the actuators. Each is two inputs: `NAME_u` is its value, and acts while `NAME_activate` is true.
        guid: GUID of the FMU; nodes whose points, timestep and steps are equal have the same one.
    """

    def __init__(self, manifest: Manifest) -> None:
        self.manifest = manifest
        self.outputs: list[Reading] = readings(manifest)
        self.actuators: tuple[Actuator, ...] = manifest.actuators
        self.output_names = _output_names(
            [output.name for output in self.outputs], [actuator.name for actuator in self.actuators]
        )
        content = {
            "outputs": [(output.name, output.unit) for output in self.outputs],
            "actuators": [(actuator.name, actuator.unit, *bounds(actuator)) for actuator in self.actuators],
            "timesteps": (manifest.steps, manifest.step_s),
        }
        self.guid = f"{{{uuid.uuid5(_NAMESPACE, json.dumps(content))}}}"

    @property
    def model_identifier(self) -> str:
        """Name of the binary: a C identifier of the node's name."""
        name = safe_name(self.manifest.node).replace("-", "_").replace(".", "_")
        return name if not name[0].isdigit() else f"_{name}"

    def header(self, address: str) -> str:
        """Return `interface.h`, the constants with which the binary is compiled.

        Args:
            address: start value of the parameter `address`.
        """
        limits = [bounds(actuator) for actuator in self.actuators] or [(0.0, 0.0)]
        constants = {
            "OUTPUTS": len(self.outputs),
            "ACTUATORS": len(self.actuators),
            "STEP_S": repr(float(self.manifest.step_s)),
            "STEPS": self.manifest.steps,
            "GUID": json.dumps(self.guid),
            "START_ADDRESS": json.dumps(address),
            "LOW_VALUES": _numbers(low for low, _ in limits),
            "HIGH_VALUES": _numbers(high for _, high in limits),
            "START_VALUES": _numbers([_start(actuator) for actuator in self.actuators] or [0.0]),
        }
        return "".join(f"#define {name} {value}\n" for name, value in constants.items())

    def model_description(self, address: str) -> bytes:
        """Return `modelDescription.xml`.

        Args:
            address: start value of the parameter `address`.
        """
        manifest = self.manifest
        root = Element(
            "fmiModelDescription",
            fmiVersion="2.0",
            modelName=manifest.node,
            guid=self.guid,
            description=f"{manifest.building}, a node on a bus of Zenostat",
            version=manifest.versions.zenostat,
            generationTool=f"Zenostat {manifest.versions.zenostat}",
            variableNamingConvention="flat",
            numberOfEventIndicators="0",
        )
        SubElement(
            root,
            "CoSimulation",
            modelIdentifier=self.model_identifier,
            canHandleVariableCommunicationStepSize="true",
            canGetAndSetFMUstate="true",
        )
        used = sorted({output.unit for output in self.outputs} | {actuator.unit for actuator in self.actuators})
        units = SubElement(root, "UnitDefinitions") if used else root
        for unit in used:
            entry = SubElement(units, "Unit", name=unit)
            if (base := _base_unit(unit)) is not None:
                SubElement(entry, "BaseUnit", {name: _text(value) for name, value in base.items()})
        duration_s = manifest.steps * manifest.step_s
        SubElement(
            root, "DefaultExperiment", startTime="0.0", stopTime=_text(duration_s), stepSize=_text(manifest.step_s)
        )
        variables = SubElement(root, "ModelVariables")
        for index, (name, output) in enumerate(zip(self.output_names, self.outputs, strict=True)):
            _variable(variables, name, index, "output", "Real", _description(output), unit=output.unit)
        for index, actuator in enumerate(self.actuators, len(self.outputs)):
            attributes = {"unit": actuator.unit, "start": _text(_start(actuator))}
            limits = zip(("min", "max"), bounds(actuator), strict=True)
            attributes |= {name: _text(value) for name, value in limits if not math.isinf(value)}
            _variable(variables, f"{actuator.name}_u", index, "input", "Real", "value of the actuator", **attributes)
        for index, actuator in enumerate(self.actuators):
            text = f"whether {actuator.name}_u acts; if false, the building's own control does"
            _variable(variables, f"{actuator.name}_activate", index, "input", "Boolean", text, start="false")
        text = "HOST:PORT of the gateway"
        _variable(variables, "address", 0, "parameter", "String", text, start=address)
        text = "seed of the weather's noise and of faults; -1: the next one of the node"
        _variable(variables, "seed", 0, "parameter", "Integer", text, start="-1", min="-1")
        structure = SubElement(root, "ModelStructure")
        for part in ("Outputs", "InitialUnknowns"):
            unknowns = SubElement(structure, part) if self.outputs else structure
            for index in range(1, len(self.outputs) + 1):
                SubElement(unknowns, "Unknown", index=str(index), dependencies="")
        indent(root)
        content: bytes = tostring(root, encoding="UTF-8", xml_declaration=True)
        return content


def _output_names(outputs: Sequence[str], actuators: Sequence[str]) -> list[str]:
    """Return a name for each output that no other variable has."""
    taken = {*_PARAMETERS, *(f"{name}_{part}" for name in actuators for part in ("u", "activate"))}
    names = list[str]()
    for name in outputs:
        text, number = name, 2
        while text in taken or (text != name and text in outputs):
            text, number = f"{name}_{number}", number + 1
        taken.add(text)
        names.append(text)
    return names


def _variable(
    parent: Element, name: str, reference: int, causality: str, kind: str, description: str, **attributes: str
) -> None:
    variability = {"Real": "continuous"}.get(kind, "discrete") if causality != "parameter" else "fixed"
    described = {"description": description} if description else {}
    variable = SubElement(
        parent,
        "ScalarVariable",
        {
            "name": name,
            "valueReference": str(reference),
            "causality": causality,
            "variability": variability,
            **described,
        },
    )
    SubElement(variable, kind, attributes)


def _description(output: Reading) -> str:
    point: Any = output.point
    source = ", ".join(
        filter(None, (getattr(point, "key", ""), getattr(point, "variable", ""), getattr(point, "meter", "")))
    )
    return "; ".join(filter(None, (source, output.note.replace("timestep", "communication step"))))


def _start(actuator: Actuator) -> float:
    """Return its value while nobody commands it where that is known, else 0, within its bounds."""
    low, high = bounds(actuator)
    return min(max(actuator.default or 0.0, low), high)


def _numbers(values: Iterable[float]) -> str:
    """Return an initializer of an array in C."""
    return f"{{{', '.join(_c_number(float(value)) for value in values)}}}"


def _c_number(value: float) -> str:
    return repr(value).replace("inf", "INFINITY")


def _text(value: float) -> str:
    return repr(float(value)) if isinstance(value, float) else str(value)
