"""The tool that explains a building: its systems, and who serves which zone, from its Brick model."""

from __future__ import annotations

from collections import Counter
from typing import Annotated, Any, ClassVar

from pydantic import Field
from typing_extensions import override

from zenostat.agent_sdk.semantic import SemanticGraph
from zenostat.topics.errors import RequestRejected, UnknownName, did_you_mean
from zenostat.topics.semantic import BRICK
from zenostat.views.mcp.content import Content
from zenostat.views.mcp.desk import Desk
from zenostat.views.mcp.tool import Node, Tool
from zenostat.views.room.description import NodeDescription

_MAX_ENTRIES = 120

_ENTITIES = """
    SELECT ?entity ?class ?label ?type WHERE {
        ?entity a ?class ; rdfs:label ?label ; zenostat:objectType ?type .
        FILTER(STRSTARTS(STR(?class), STR(brick:)))
    }"""
_FEEDS = "SELECT ?from ?to WHERE { ?from brick:feeds ?to }"
_PARTS = "SELECT ?whole ?part WHERE { ?whole brick:hasPart ?part . ?part zenostat:objectType ?type }"
_POINTS = """
    SELECT ?place ?name ?kind ?class WHERE {
        ?place brick:hasPoint ?point . ?point a ?class ; ref:hasExternalReference ?bus .
        ?bus a zenostat:BusReference ; zenostat:name ?name ; zenostat:kind ?kind .
        FILTER(STRSTARTS(STR(?class), STR(brick:)))
    }"""


class ExplainBuilding(Tool):
    """Explain the building of a node from its Brick model.

    What it is, its zones with what serves them, its air handlers and loops, and how many points it has. With
    `about`, the name of a zone or of equipment: its class, its parts, what feeds it, what it feeds, and its points.
    """

    name: ClassVar[str] = "explain_building"

    node: Node
    about: Annotated[
        str | None, Field(max_length=200, description="Name of a zone or of equipment, as EnergyPlus has it.")
    ] = None

    @override
    def run(self, desk: Desk) -> Content:
        description = desk.description(self.node)
        try:
            structure = _Structure(desk.semantic_model(description.manifest))
        except RequestRejected as error:
            if self.about is not None:
                raise
            return Content({**_facts(description), "semantic_model": None, "reason": str(error)})
        if self.about is not None:
            return Content({"node": self.node, **structure.about(self.about)})
        return Content({**_facts(description), **structure.overview()})


def _facts(description: NodeDescription) -> dict[str, Any]:
    manifest, content = description.manifest, description.content
    return {
        "node": manifest.node,
        "building": manifest.building,
        "weather": manifest.weather,
        "location": manifest.location,
        "begin": manifest.begin,
        "end": manifest.end,
        "timestep_s": manifest.step_s,
        "floor_area_m2": manifest.floor_area_m2,
        "comfort_band": content["band"],
        "points": dict(Counter(point["kind"] for point in content["points"])),
        "power": None if content["facility"] is None else content["facility"]["label"],
        "zones": [zone["key"] for zone in content["zones"]][:_MAX_ENTRIES],
    }


class _Structure:
    """Entities of a semantic model, by URI."""

    def __init__(self, model: SemanticGraph) -> None:
        self._classes: dict[str, str] = {}
        self._labels: dict[str, str] = {}
        self._types: dict[str, str] = {}
        for row in sorted(model.query(_ENTITIES), key=lambda row: (str(row["label"]), str(row["class"]))):
            entity = str(row["entity"])
            self._classes[entity] = str(row["class"]).removeprefix(BRICK)
            self._labels[entity], self._types[entity] = str(row["label"]), str(row["type"])
        self._feeds = self._pairs(model, _FEEDS, "from", "to")
        self._fed_by = self._pairs(model, _FEEDS, "to", "from")
        self._parts = self._pairs(model, _PARTS, "whole", "part")
        self._wholes = self._pairs(model, _PARTS, "part", "whole")
        self._points: dict[str, list[dict[str, str]]] = {}
        for row in model.query(_POINTS):
            point = {"name": str(row["name"]), "kind": str(row["kind"])}
            point["class"] = str(row["class"]).removeprefix(BRICK)
            self._points.setdefault(str(row["place"]), []).append(point)

    def _pairs(self, model: SemanticGraph, query: str, key: str, value: str) -> dict[str, list[str]]:
        pairs: dict[str, list[str]] = {}
        for row in model.query(query):
            if str(row[key]) in self._labels and str(row[value]) in self._labels:
                pairs.setdefault(str(row[key]), []).append(str(row[value]))
        return {entity: sorted(set(others), key=self._order) for entity, others in pairs.items()}

    def _order(self, entity: str) -> tuple[str, str]:
        return self._labels[entity], entity

    def _name(self, entity: str) -> str:
        return f"{self._labels[entity]} ({self._classes[entity]})"

    def overview(self) -> dict[str, Any]:
        """Return the classes with their numbers, the zones with what serves them, and the air handlers and loops."""
        counts = Counter(self._classes.values())
        zones = [entity for entity in self._of("Zone") if self._fed_by.get(entity)]
        systems = [entity for entity in self._labels if self._classes[entity] == "AHU" or self._is_loop(entity)]
        return {
            "equipment": dict(sorted(counts.items())),
            "served_zones": [
                {"zone": self._labels[zone], "served_by": self._served_by(zone)} for zone in zones[:_MAX_ENTRIES]
            ],
            "systems": [
                {
                    "name": self._labels[entity],
                    "class": self._classes[entity],
                    "parts": [self._name(part) for part in self._parts.get(entity, ())][:_MAX_ENTRIES],
                    "feeds": [self._name(other) for other in self._feeds.get(entity, ())][:_MAX_ENTRIES],
                }
                for entity in systems[:_MAX_ENTRIES]
            ],
        }

    def about(self, name: str) -> dict[str, Any]:
        """Return what is known of a zone or of equipment.

        Raises:
            UnknownName: there is none of that name; the text lists similar names.
        """
        chosen = [entity for entity, label in self._labels.items() if label.casefold() == name.casefold()]
        if not chosen:
            raise UnknownName(f"no zone or equipment {name!r}; {did_you_mean(name, self._labels.values())}")
        return {
            "entities": [
                {
                    "name": self._labels[entity],
                    "class": self._classes[entity],
                    "energyplus_type": self._types[entity],
                    "fed_by": [self._name(other) for other in self._fed_by.get(entity, ())],
                    "feeds": [self._name(other) for other in self._feeds.get(entity, ())][:_MAX_ENTRIES],
                    "parts": [self._name(other) for other in self._parts.get(entity, ())][:_MAX_ENTRIES],
                    "part_of": [self._name(other) for other in self._wholes.get(entity, ())],
                    "points": sorted(self._points.get(entity, ()), key=lambda point: point["name"])[:_MAX_ENTRIES],
                }
                for entity in chosen
            ]
        }

    def _of(self, object_type: str) -> list[str]:
        return [entity for entity, kind in self._types.items() if kind == object_type]

    def _is_loop(self, entity: str) -> bool:
        return self._classes[entity].endswith("_Loop") and self._classes[entity] != "Air_Loop"

    def _served_by(self, zone: str) -> list[str]:
        """Return what feeds a zone, with what feeds that: `VAV_1 (VAV) from AHU_1 (AHU)`."""
        texts = []
        for terminal in self._fed_by.get(zone, ()):
            sources = [self._name(other) for other in self._fed_by.get(terminal, ()) if other != zone]
            texts.append(self._name(terminal) + (f" from {', '.join(sources)}" if sources else ""))
        return texts
