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

from typing import Any, NamedTuple

from zenostat.bridge.client.connection import Connection
from zenostat.topics.errors import InvalidConfig, UnknownName, did_you_mean
from zenostat.topics.extras import requires_extra
from zenostat.topics.semantic import BACNET, BRICK, QUDT_UNIT, RDF, RDFS, REC, REF, VOCABULARY

with requires_extra("semantic", "the semantic model", "rdflib"):
    from rdflib import Graph, Literal, URIRef

__all__ = ["PATTERNS", "PREFIXES", "FoundPoint", "Pattern", "SemanticGraph", "find", "read"]

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


class Pattern(NamedTuple):
    """A question to a semantic model.

    Attributes:
        description: what it finds, for people.
        where: SPARQL graph pattern that binds `?point`, and `?place` to the zone or equipment that it belongs to.
        kind: `sensor`, `meter` or `actuator`.
    """

    description: str
    where: str
    kind: str


def _point(brick_class: str) -> str:
    return f"?place brick:hasPoint ?point . ?point a brick:{brick_class} ."


_COOLING, _HEATING = "Cooling_Zone_Air_Temperature_Setpoint", "Heating_Zone_Air_Temperature_Setpoint"
_ECONOMIZER = "?handler brick:hasPart ?economizer . ?economizer a brick:Economizer ."
_FED = "?handler brick:feeds ?terminal . ?terminal brick:feeds ?place ."

PATTERNS = {
    "cooling_setpoints": Pattern("cooling setpoints of zones, to command", _point(_COOLING), "actuator"),
    "heating_setpoints": Pattern("heating setpoints of zones, to command", _point(_HEATING), "actuator"),
    "economizer_cooling_setpoints": Pattern(
        "cooling setpoints of zones that an air handler with an economizer feeds",
        f"{_ECONOMIZER} {_FED} {_point(_COOLING)}",
        "actuator",
    ),
    "reheat_heating_setpoints": Pattern(
        "heating setpoints of zones whose terminal unit reheats",
        f"?terminal a brick:RVAV ; brick:feeds ?place . {_point(_HEATING)}",
        "actuator",
    ),
    "boiler_heating_setpoints": Pattern(
        "heating setpoints of zones whose terminal unit has a coil that a boiler feeds",
        "?boiler a brick:Boiler ; brick:feeds ?coil . ?terminal brick:hasPart ?coil ; brick:feeds ?place . "
        f"{_point(_HEATING)}",
        "actuator",
    ),
    "supply_air_setpoints": Pattern(
        "supply air temperature setpoints of air handlers", _point("Supply_Air_Temperature_Setpoint"), "actuator"
    ),
    "chilled_water_setpoints": Pattern(
        "chilled water temperature setpoints", _point("Leaving_Chilled_Water_Temperature_Setpoint"), "actuator"
    ),
    "hot_water_setpoints": Pattern(
        "hot water temperature setpoints", _point("Leaving_Hot_Water_Temperature_Setpoint"), "actuator"
    ),
    "zone_temperatures": Pattern("air temperatures of zones", _point("Zone_Air_Temperature_Sensor"), "sensor"),
    "zone_humidities": Pattern("relative humidities of zones", _point("Zone_Air_Humidity_Sensor"), "sensor"),
    "occupants": Pattern("numbers of people in zones", _point("Occupancy_Count_Sensor"), "sensor"),
    "effective_cooling_setpoints": Pattern(
        "cooling setpoints of thermostats in effect",
        _point("Effective_Cooling_Zone_Air_Temperature_Setpoint"),
        "sensor",
    ),
    "effective_heating_setpoints": Pattern(
        "heating setpoints of thermostats in effect",
        _point("Effective_Heating_Zone_Air_Temperature_Setpoint"),
        "sensor",
    ),
    "outdoor_temperature": Pattern("outdoor temperature", _point("Outside_Air_Temperature_Sensor"), "sensor"),
    "electricity_meter": Pattern(
        "electricity of the whole building",
        "?place a brick:Building_Electrical_Meter ; brick:hasPoint ?point .",
        "meter",
    ),
    "gas_meter": Pattern(
        "natural gas of the whole building",
        '?place a brick:Building_Meter ; zenostat:resource "naturalgas" ; brick:hasPoint ?point .',
        "meter",
    ),
}
"""Questions by name, for `find`; conditions on the equipment are part of `where`."""


class FoundPoint(NamedTuple):
    """A point of a node.

    Attributes:
        name: its name on the bus.
        kind: `sensor`, `meter` or `actuator`.
        place: name of the zone or the equipment that it belongs to, as in EnergyPlus.
    """

    name: str
    kind: str
    place: str


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

    def find(self, pattern: str) -> list[FoundPoint]:
        """Return the points that a pattern asks for, by place and name; empty if the building has none.

        Args:
            pattern: a name of `PATTERNS`.

        Raises:
            UnknownName: there is no such pattern.
        """
        asked = PATTERNS.get(pattern)
        if asked is None:
            raise UnknownName(f"no pattern {pattern!r}; {did_you_mean(pattern, PATTERNS)}")
        rows = self.query(f"SELECT DISTINCT ?point ?label WHERE {{ {asked.where} ?place rdfs:label ?label . }}")
        names = self._names(asked.kind)
        points = (FoundPoint(names[row["point"]], asked.kind, row["label"]) for row in rows if row["point"] in names)
        return sorted(points, key=lambda each: (each.place, each.name))

    def _names(self, kind: str) -> dict[str, str]:
        """Return the names on the bus of the points of a kind, by their URIs."""
        names = {}
        for reference in self.graph.subjects(URIRef(f"{VOCABULARY}kind"), Literal(kind)):
            for point in self.graph.subjects(URIRef(f"{REF}hasExternalReference"), reference):
                names[str(point)] = str(self.graph.value(reference, URIRef(f"{VOCABULARY}name")))
        return names


def find(model: SemanticGraph, pattern: str) -> list[FoundPoint]:
    """Return the points of a building that a pattern asks for; see `SemanticGraph.find`."""
    return model.find(pattern)


def read(bus: Connection, node: str) -> SemanticGraph:
    """Return the semantic model of a node's building.

    Raises:
        RequestRejected: its plant has none, or its version of Zenostat does not send it.
    """
    return SemanticGraph.parse(bus.semantic(node))
