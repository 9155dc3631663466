"""The semantic model of a node's building: a Brick graph with references to the node's points.

    import zenostat
    from zenostat import semantic

    with zenostat.connect() as bus:
        model = semantic.read(bus, "office")
        for row in model.query("SELECT ?zone WHERE { ?zone a brick:HVAC_Zone }"):
            print(row["zone"])

Needs rdflib: the extra `semantic`.
"""

from __future__ import annotations

from typing import Any

from zenostat.bridge.client.connection import Connection
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.extras import requires_extra
from zenostat.topics.semantic import BACNET, BRICK, QUDT_UNIT, RDF, RDFS, REC, REF, VOCABULARY

with requires_extra("semantic", "the semantic model", "rdflib"):
    from rdflib import Graph

__all__ = ["PREFIXES", "SemanticGraph", "read"]

PREFIXES = {
    "brick": BRICK,
    "ref": REF,
    "bacnet": BACNET,
    "rec": REC,
    "unit": QUDT_UNIT,
    "rdf": RDF,
    "rdfs": RDFS,
    "zenostat": VOCABULARY,
}
"""Namespaces that queries can use without a declaration."""


class SemanticGraph:
    """Semantic model of one building.

    Attributes:
        graph: its statements, as an rdflib graph.
    """

    def __init__(self, graph: Graph) -> None:
        self.graph = graph

    @classmethod
    def parse(cls, text: str) -> SemanticGraph:
        """Read a model in Turtle, as `Bus.semantic` returns it.

        Raises:
            InvalidConfig: it is not Turtle.
        """
        graph = Graph()
        try:
            graph.parse(data=text, format="turtle")
        except Exception as error:  # rdflib's parser has no class of its own for all of its errors
            raise InvalidConfig(f"the semantic model is not valid Turtle: {error}") from None
        return cls(graph)

    def turtle(self) -> str:
        """Return the model as Turtle, grouped and sorted by class."""
        return str(self.graph.serialize(format="turtle"))

    def query(self, sparql: str, **bindings: Any) -> list[dict[str, Any]]:
        """Return the solutions of a SPARQL SELECT query, each by the names of its variables; unbound ones are left out.

        URIs are texts; literals are Python values.

        Args:
            sparql: the query; `PREFIXES` are declared.
            bindings: initial values of variables, by name.

        Raises:
            InvalidConfig: it is not a valid SELECT query.
        """
        try:
            result = self.graph.query(sparql, initNs=PREFIXES, initBindings=bindings)
            if result.type != "SELECT":
                raise InvalidConfig(f"expected a SELECT query, got {result.type}")
            rows: Any = result.bindings
            return [{str(name): value.toPython() for name, value in row.items()} for row in rows]
        except InvalidConfig:
            raise
        except Exception as error:  # rdflib raises what its parser and its functions raise
            raise InvalidConfig(f"the query cannot be answered: {error}") from None


def read(bus: Connection, node: str) -> SemanticGraph:
    """Return the semantic model of a node's building.

    Raises:
        RequestRejected: its plant has none, or its version of Zenostat does not send it.
    """
    return SemanticGraph.parse(bus.semantic(node))
