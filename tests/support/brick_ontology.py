"""The Brick ontology of the brickschema wheel: its file, its classes, and validation against its shapes."""

from __future__ import annotations

import re
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import rdflib
import shifty
from rdflib import RDF, SH


def ontology_file() -> Path:
    """Brick 1.4 as Turtle; brickschema itself takes seconds to import."""
    spec = find_spec("brickschema")
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).parent / "ontologies" / "1.4" / "Brick.ttl"


@cache
def superclasses() -> dict[str, set[str]]:
    """Superclasses of each Brick class, among the Brick classes; read by lines, as parsing it takes ten seconds."""
    classes = {}
    for block in re.split(r"\n\n", ontology_file().read_text()):
        name = re.match(r"brick:(\w+) a owl:Class", block)
        if name:
            above = re.search(r"rdfs:subClassOf ((?:\w+:\w+,?\s+)+)[;.]", block)
            classes[name[1]] = set(re.findall(r"brick:(\w+)", above[1])) if above else set()
    return classes


@cache
def _shapes() -> shifty.PreparedValidator:
    return shifty.PreparedValidator(ontology_file())


def violations(turtle: str) -> list[str]:
    """Return what in a graph violates the shapes of Brick after its rules; deprecated classes do not."""
    conforms, report, _ = _shapes().validate(turtle, minimum_severity="violation")
    texts = [
        f"{report.value(result, SH.focusNode)} {report.value(result, SH.resultPath)}: "
        f"{report.value(result, SH.resultMessage)}"
        for result in report.subjects(RDF.type, SH.ValidationResult)
        if report.value(result, SH.resultSeverity) != SH.Warning
    ]
    assert conforms == (not texts)
    return texts


def graph_of(turtle: str) -> rdflib.Graph:
    """Parse a graph."""
    return rdflib.Graph().parse(data=turtle, format="turtle")
