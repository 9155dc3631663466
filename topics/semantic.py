"""Namespaces of a node's semantic model, for those that write it and those that read it."""

from __future__ import annotations

from urllib.parse import quote

BRICK = "https://brickschema.org/schema/Brick#"
REF = "https://brickschema.org/schema/Brick/ref#"
BACNET = "http://data.ashrae.org/bacnet/2020#"
REC = "https://w3id.org/rec#"
QUDT = "http://qudt.org/schema/qudt/"
QUDT_UNIT = "http://qudt.org/vocab/unit/"
RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
RDFS = "http://www.w3.org/2000/01/rdf-schema#"
SKOS = "http://www.w3.org/2004/02/skos/core#"
VOCABULARY = "urn:zenostat:vocabulary#"
"""Zenostat's own terms: `BusReference` with `node`, `name`, `kind` and `key`, `ModbusReference`, `objectType`."""


def building_namespace(building: str) -> str:
    """Return the namespace of a building's entities; each has the URI `NAMESPACE` + type + `.` + name."""
    return f"urn:zenostat:building:{quote(building, safe='')}#"
