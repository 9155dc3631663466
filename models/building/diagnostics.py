"""Diagnose a model before EnergyPlus reads it: errors and warnings, each with its object, field and line.

Checked are the syntax of the file, each object against EnergyPlus's input schema, references to objects that do not
exist, and nodes that nothing else is connected to. EnergyPlus itself ends with a segmentation fault on some of these.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Protocol

from zenostat.models import energyplus, schema
from zenostat.models.building.ems_programs import program_findings
from zenostat.models.building.external_files import versions_of_files
from zenostat.models.building.meters import meter_findings
from zenostat.models.building.nodes import (
    nodes_without_setpoint,
    outdoor_nodes_without_air,
    shared_branches,
    unconnected_nodes,
)
from zenostat.models.building.plausibility import plausibility_findings
from zenostat.models.building.schedule_limits import limit_findings
from zenostat.models.building.schedule_rules import schedule_findings
from zenostat.models.building.source_lines import read_source
from zenostat.models.building.template_references import is_template, traced_references
from zenostat.models.input_format.source_model import ModelObjects, SourceModel
from zenostat.topics.cache import cached_bytes, digest
from zenostat.topics.errors import InvalidConfig, list_errors

REQUIRED = ("Building", "GlobalGeometryRules")
"""Types of which EnergyPlus requires an object."""

_PARAMETRIC = (
    "is for EnergyPlus's ParametricPreprocessor, and EnergyPlus ends at it; run that program, and use a file that it "
    "writes"
)


class Severity(StrEnum):
    """Whether EnergyPlus simulates a model nevertheless."""

    ERROR = "error"
    WARNING = "warning"


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """Finding on an object of a model.

    Attributes:
        severity: whether EnergyPlus simulates the model nevertheless.
        kind, name: type and name of the object; the name is empty if the diagnostic is about the type.
        field: path of the field, such as `zones[3].zone_name`; empty if it is about the object.
        text: the whole sentence, with type, name and field.
        line: in the user's file, from 1; None if the object is not in it.
    """

    severity: Severity
    kind: str
    name: str
    field: str
    text: str
    line: int | None = None

    def __str__(self) -> str:
        return self.text if self.line is None else f"line {self.line}: {self.text}"


class _Model(Protocol):
    """The parts of a `Building` that the cached diagnostics need."""

    @property
    def objects(self) -> ModelObjects: ...
    @property
    def unexpanded(self) -> ModelObjects: ...
    @property
    def content(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def file(self) -> str: ...


def diagnose(
    objects: ModelObjects, source: SourceModel | None = None, unexpanded: ModelObjects | None = None
) -> list[Diagnostic]:
    """Return the diagnostics of a model, errors first, each in the order of the file.

    Args:
        objects: the model as epJSON, in the format of the installed engine.
        source: the file that it was read from, for the lines and the errors of its syntax.
        unexpanded: the model before its HVACTemplate objects were expanded.
    """
    diagnostics = diagnose_format(objects, source)
    # Objects of an unknown type, or behind a missing semicolon, would be missed by all that refer to them.
    invalid = {(each.kind, each.name) for each in diagnostics}
    if (source is None or not source.issues) and all(_is_known(kind, items) for kind, items in objects.items()):
        fields = {(each.kind, each.name, each.field) for each in diagnostics}
        rules = _rule_diagnostics(objects, invalid, unexpanded or {})
        diagnostics += [_located(each, source) for each in rules if (each.kind, each.name, each.field) not in fields]
    diagnostics = _with_hints(diagnostics, source)
    return sorted(diagnostics, key=lambda each: (each.severity is Severity.WARNING, each.line or 0))


def diagnose_format(objects: ModelObjects, source: SourceModel | None = None) -> list[Diagnostic]:
    """Return the errors of a file's syntax, and of the objects against the schema; arguments as in `diagnose`."""
    issues = source.issues if source is not None else ()
    diagnostics = [Diagnostic(Severity.ERROR, kind, name, "", text, line) for line, kind, name, text in issues]
    diagnostics += [
        Diagnostic(Severity.ERROR, kind, "", "", f"the model has no {kind} object; EnergyPlus requires one")
        for kind in REQUIRED
        if not objects.get(kind)
    ]
    diagnostics += [
        _located(Diagnostic(Severity.ERROR, kind, name, "", f"{kind} {name!r} {_PARAMETRIC}"), source)
        for kind, items in objects.items()
        if kind.casefold().startswith("parametric:")
        for name in items
    ]
    damaged = {(each.kind, each.name) for each in diagnostics}
    # What follows from a missing comma or semicolon is no error of its own.
    errors = [e for e in schema.find_errors(objects, complete=True) if (e.kind, e.name) not in damaged]
    diagnostics += [_located(Diagnostic(Severity.ERROR, e.kind, e.name, e.field, e.text), source) for e in errors]
    return sorted(diagnostics, key=lambda each: each.line or 0)


def diagnose_unexpanded(objects: ModelObjects, source: SourceModel) -> list[Diagnostic]:
    """Return the errors of a model whose HVACTemplate objects could not be expanded; arguments as in `diagnose`.

    Each reference of a template to a missing object counts, since nothing shows which of them ExpandObjects needs.
    """
    if errors := diagnose_format(objects, source):
        return _with_hints(errors, source)
    references = [each for each, _ in traced_references(objects, objects) if is_template(each.kind)]
    errors = [Diagnostic(Severity.ERROR, e.kind, e.name, e.field, e.describe()) for e in references]
    return sorted((_located(each, source) for each in errors), key=lambda each: each.line or 0)


def _with_hints(diagnostics: list[Diagnostic], source: SourceModel | None) -> list[Diagnostic]:
    """Return one diagnostic for each object whose fields seem to be shifted, instead of those that follow from it."""
    result, hinted = list[Diagnostic](), set[tuple[str, str]]()
    for each in sorted(diagnostics, key=lambda each: each.severity is Severity.WARNING):
        hint = source.hint(each.kind, each.name) if source is not None else None
        if hint is None:
            result.append(each)
        elif (each.kind, each.name) not in hinted:
            hinted.add((each.kind, each.name))
            label = f"{each.kind} {each.name!r}"
            reason = each.text.removeprefix(label).removeprefix(": ").strip()
            text = f"{label}: {hint.field} {hint.text} (all fields after it are shifted: {reason})"
            result.append(replace(each, field=hint.field, line=hint.line, text=text))
    return result


def _is_known(kind: str, items: object) -> bool:
    return isinstance(items, Mapping) and schema.canonical_type(kind) == kind


def _rule_diagnostics(
    objects: ModelObjects, invalid: Collection[tuple[str, str]], unexpanded: ModelObjects
) -> Iterator[Diagnostic]:
    """Yield the diagnostics of the rules; schedules and values that do not match the schema are left out."""
    valid = {
        kind: {name: fields for name, fields in items.items() if isinstance(fields, Mapping)}
        for kind, items in objects.items()
    }
    for each, is_fatal in traced_references(valid, unexpanded):
        severity = Severity.ERROR if is_fatal else Severity.WARNING
        yield Diagnostic(severity, each.kind, each.name, each.field, each.describe())
    sound = {
        kind: {name: fields for name, fields in items.items() if (kind, name) not in invalid}
        for kind, items in valid.items()
    }
    matching = schema.matching_part(valid) if invalid else valid
    for finding in chain(
        schedule_findings(sound),
        limit_findings(sound),
        program_findings(matching),
        meter_findings(matching),
        plausibility_findings(matching),
        nodes_without_setpoint(matching),
        outdoor_nodes_without_air(matching),
        shared_branches(matching),
    ):
        if not finding.field and (finding.kind, finding.name) in invalid:
            continue  # it may follow from what is left out
        severity = Severity.ERROR if finding.is_fatal else Severity.WARNING
        yield Diagnostic(severity, finding.kind, finding.name, finding.field, finding.text)
    for node in unconnected_nodes(matching):
        yield Diagnostic(Severity.WARNING, node.kind, node.name, node.field, node.describe())


def _located(diagnostic: Diagnostic, source: SourceModel | None) -> Diagnostic:
    if source is None:
        return diagnostic
    return replace(diagnostic, line=source.line(diagnostic.kind, diagnostic.name, diagnostic.field))


def verdict() -> str:
    """Return the heading of a file with errors, for `describe`."""
    return f"is not a valid model for EnergyPlus {energyplus.version()}"


def describe(diagnostics: Iterable[Diagnostic], file: str, verdict: str) -> str:
    """Return an error text with a diagnostic in each line: `FILE verdict:` and the first of them."""
    return list_errors(f"{file} {verdict}:", [str(each) for each in diagnostics])


@cache
def _rules() -> str:
    """Return a hash of this package's sources: other rules have other diagnostics."""
    return digest(*(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py"))))


def cached_diagnostics(building: _Model) -> list[Diagnostic]:
    """Return the diagnostics of a model; cached, since a model is checked each time that it is used."""

    def make(target: Path) -> None:
        diagnostics = diagnose(building.objects, unexpanded=building.unexpanded)
        if building.file and (diagnostics or not building.file.lower().endswith(".idf")):
            diagnostics = diagnose(building.objects, read_source(Path(building.file)), building.unexpanded)
        target.write_text(json.dumps([asdict(each) for each in diagnostics]))

    files = versions_of_files(building.objects)
    name = f"diagnostics/{digest(building.content, energyplus.version(), _rules(), *files)}.json"
    return [
        Diagnostic(**{**each, "severity": Severity(each["severity"])}) for each in json.loads(cached_bytes(name, make))
    ]


def suspects(building: _Model) -> Iterator[str]:
    """Yield a line with the diagnostics of a model at which EnergyPlus has ended; they may be the reason."""
    if diagnostics := cached_diagnostics(building):
        yield describe(diagnostics, building.file or building.name, "also has")


def check_meters(building: _Model, meters: Sequence[str]) -> None:
    """Check that transformers follow meters of a model, at which EnergyPlus would crash otherwise.

    Args:
        building: the model.
        meters: all that it has, by EnergyPlus's list.

    Raises:
        InvalidConfig: lists the others, with object, field and line.
    """
    if errors := [each for each in meter_findings(building.objects, meters) if each.is_fatal]:
        source = read_source(Path(building.file)) if building.file else None
        diagnostics = [Diagnostic(Severity.ERROR, each.kind, each.name, each.field, each.text) for each in errors]
        file = building.file or building.name
        raise InvalidConfig(describe([_located(each, source) for each in diagnostics], file, verdict()))
