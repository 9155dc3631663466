"""Semantic models of buildings: what they contain, references to points, Brick's shapes, and names from strangers."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import rdflib
from hypothesis import given, settings
from hypothesis import strategies as st
from rdflib import RDF, RDFS, SH, Literal, Namespace, URIRef
from support.brick_ontology import graph_of, ontology_file, superclasses, violations
from support.builders import manifest as build_manifest
from support.examples import examples

from zenostat.gateways.bacnet.points import point_specs
from zenostat.gateways.modbus.register_map import RegisterMap
from zenostat.models.building.model import Building, read_building
from zenostat.models.catalog import bundled_buildings, find_building, weathers
from zenostat.models.points.discovery import discover
from zenostat.models.points.monitoring import with_monitoring
from zenostat.models.points.selection import select_points
from zenostat.models.semantic.brick_classes import (
    EQUIPMENT,
    METERS,
    NODE_VARIABLES,
    SENSOR_OF_UNIT,
    SETPOINT_OF_UNIT,
    SUPERCLASSES,
    VARIABLES,
)
from zenostat.models.semantic.graph import semantic_turtle
from zenostat.models.semantic.triples import Iri, Triples, encoded_name
from zenostat.topics import keys
from zenostat.topics.messages import Actuator, Meter, Sensor
from zenostat.topics.printable import replace_controls
from zenostat.topics.semantic import BACNET, BRICK, REC, REF, VOCABULARY, building_namespace

brick, ref, bacnet, rec, own = (Namespace(text) for text in (BRICK, REF, BACNET, REC, VOCABULARY))
QUICK = ("ref-small-office", "hotel-large")


@dataclass(frozen=True)
class Points:
    """Points of a node."""

    sensors: tuple[Sensor, ...] = ()
    meters: tuple[Meter, ...] = ()
    actuators: tuple[Actuator, ...] = ()


def thermostat(zone: str, control: str) -> Actuator:
    """A setpoint of a zone's thermostat."""
    kind = "Zone Temperature Control"
    return Actuator(
        name=keys.safe_name(f"{zone}_{control}"), component_type=kind, control_type=control, key=zone, unit="degC"
    )


def points_of(building: Building) -> Points:
    """A temperature, two setpoints and three meters, as if EnergyPlus had been started."""
    zones = list(building.objects["Zone"])
    return Points(
        (
            Sensor(name="outdoor", variable="Site Outdoor Air Drybulb Temperature", key="Environment", unit="degC"),
            *(Sensor(name=keys.safe_name(z), variable="Zone Air Temperature", key=z, unit="degC") for z in zones),
        ),
        tuple(
            Meter(name=keys.safe_name(m.replace(":", "_")), meter=m, unit="J")
            for m in ("Electricity:Facility", "Cooling:Electricity", "NaturalGas:Facility")
        ),
        tuple(thermostat(zone, f"{c} Setpoint") for zone in zones for c in ("Heating", "Cooling")),
    )


@cache
def model_of(name: str) -> tuple[Building, rdflib.Graph]:
    """A bundled building, and its graph without points of EnergyPlus's own."""
    building = read_building(find_building(name))
    return building, graph_of(semantic_turtle(building, "office", points_of(building)))


def count(objects: Mapping[str, Mapping[str, Any]], start: str) -> int:
    """The number of objects whose type begins with a text."""
    return sum(len(items) for kind, items in objects.items() if kind.startswith(start))


def instances(graph: rdflib.Graph, name: str) -> set[Any]:
    """Entities of a class or of one below it."""
    query = "SELECT ?e WHERE { ?e a/rdfs:subClassOf* ?class }"
    return {row[0] for row in graph.query(query, initNs={"rdfs": RDFS}, initBindings={"class": brick[name]})}


def check_counts(name: str) -> None:
    """Compare the numbers of entities with those of the model's objects."""
    building, graph = model_of(name)
    objects = building.objects
    assert len(instances(graph, "Zone")) == len(objects["Zone"])
    assert len(instances(graph, "HVAC_Zone")) == len(objects["ZoneHVAC:EquipmentConnections"])
    assert len(instances(graph, "AHU")) == len(instances(graph, "Air_Loop")) == len(objects["AirLoopHVAC"])
    plant_loops = len(objects.get("PlantLoop", {})) + len(objects.get("CondenserLoop", {}))
    assert len(instances(graph, "Loop")) == len(objects["AirLoopHVAC"]) + plant_loops
    terminals = [e for e in instances(graph, "Terminal_Unit") if "#AirTerminal-" in str(e)]
    assert len(terminals) == count(objects, "AirTerminal:") == len(objects["ZoneHVAC:AirDistributionUnit"])
    for terminal in terminals:  # each is fed by one air handler, and feeds one zone
        assert len([s for s in graph.subjects(brick.feeds, terminal) if (s, RDF.type, brick.AHU) in graph]) == 1
        assert len(list(graph.objects(terminal, brick.feeds))) == 1
    economizers = [
        fields
        for fields in objects.get("Controller:OutdoorAir", {}).values()
        if fields.get("economizer_control_type", "NoEconomizer") != "NoEconomizer"
    ]
    assert len(instances(graph, "Economizer")) == len(economizers)
    for kinds, brick_class in (
        (["Chiller"], "Chiller"),
        (["Boiler:"], "Boiler"),
        (["Pump:", "HeaderedPumps:"], "Pump"),
    ):
        assert len(instances(graph, brick_class)) == sum(count(objects, kind) for kind in kinds), brick_class


def test_semantic_model__counts_are_those_of_the_models_objects() -> None:
    for name in QUICK:
        check_counts(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", [entry.name for entry in bundled_buildings()])
def test_semantic_model__of_each_building_counts_and_conforms(name: str) -> None:
    check_counts(name)
    building = read_building(find_building(name))
    offered = discover(building, weathers()[0].path)
    points = with_monitoring(building, offered, select_points(building, offered, None, None, None))
    turtle = semantic_turtle(building, "office", points)
    assert not violations(turtle)
    graph = graph_of(turtle)
    expected = {point.name for point in (*points.sensors, *points.meters, *points.actuators)}
    assert {str(name) for name in graph.objects(None, own.name)} == expected


def test_semantic_model__conforms_to_bricks_shapes() -> None:
    building = read_building(find_building("ref-small-office"))
    turtle = semantic_turtle(building, "office", points_of(building))
    assert not violations(turtle)
    assert violations(f"{turtle}\nbldg:Zone.Core_ZN brick:hasPart bldg:sensor.outdoor .\n")


@pytest.mark.slow
def test_semantic_model__conforms_by_another_validator_as_well() -> None:
    import pyshacl

    _, graph = model_of("ref-small-office")
    shapes = rdflib.Graph().parse(ontology_file())
    _, report, text = pyshacl.validate(graph, shacl_graph=shapes, ont_graph=shapes, advanced=True, allow_warnings=True)
    own_terms = set(shapes.subjects(RDF.type))  # three classes of Brick 1.4.4 lack what its own shapes ask of them
    violating = {report.value(result, SH.focusNode) for result in report.subjects(SH.resultSeverity, SH.Violation)}
    assert not violating - own_terms, text


def test_brick_classes__are_bricks_with_its_superclasses() -> None:
    ontology = superclasses()
    used = {*EQUIPMENT.values(), *VARIABLES.values(), *NODE_VARIABLES.values(), *SENSOR_OF_UNIT.values()}
    used |= {*SETPOINT_OF_UNIT.values(), *(name for names in METERS.values() for name in names), *SUPERCLASSES}
    used |= {above for names in SUPERCLASSES.values() for above in names}
    assert used <= {*ontology, "Location"}
    for name, above in SUPERCLASSES.items():
        assert set(above) <= ontology[name] | {"Location"}, name
    roots = {"Point", "Equipment", "Location", "Collection"}
    assert used <= {*SUPERCLASSES, *roots}


def test_semantic_model__equipment_feeds_what_it_serves() -> None:
    _, graph = model_of("hotel-large")
    query = """
        SELECT ?boiler ?zone WHERE {
            ?boiler a brick:Boiler ; brick:feeds ?coil .
            ?terminal a/rdfs:subClassOf* brick:VAV ; brick:hasPart ?coil ; brick:feeds ?zone .
            ?handler a brick:AHU ; brick:feeds ?terminal ; brick:hasPart ?economizer .
            ?economizer a brick:Economizer .
        }"""
    rows = list(graph.query(query, initNs={"brick": brick, "rdfs": RDFS}))
    objects = read_building(find_building("hotel-large")).objects
    assert len(rows) == len(objects["AirTerminal:SingleDuct:VAV:Reheat"])


def test_semantic_model__points_refer_to_bus_bacnet_and_modbus() -> None:
    building, graph = model_of("ref-small-office")
    points = points_of(building)
    manifest = build_manifest(sensors=points.sensors, meters=points.meters, actuators=points.actuators)
    specs = {(spec.kind.value, spec.name): spec for spec in point_specs(manifest)}
    entries = {(entry.table.value, entry.name): entry for entry in RegisterMap(manifest).entries}
    topics = {"sensor": keys.SENSOR, "meter": keys.METER, "actuator": keys.ACTUATOR}
    checked = 0
    for reference in graph.subjects(RDF.type, own.BusReference):
        name, kind = (str(graph.value(reference, own[field])) for field in ("name", "kind"))
        assert str(graph.value(reference, own.key)) == topics[kind].at("office", name=name, sender="*")
        (point,) = graph.subjects(ref.hasExternalReference, reference)
        others = {*graph.objects(point, ref.hasExternalReference)} - {reference}
        (device_object,) = [each for each in others if (each, RDF.type, ref.BACnetReference) in graph]
        object_type = "analog-output" if kind == "actuator" else "analog-input"
        spec = specs[object_type, name]
        identifier = graph.value(device_object, bacnet["object-identifier"])
        assert str(identifier) == f"{object_type},{spec.instance}"
        assert str(graph.value(device_object, bacnet["object-name"])) == spec.object_name
        tables = {}
        for each in others - {device_object}:
            table = str(graph.value(each, own.table))
            tables[table] = (graph.value(each, own.address).toPython(), graph.value(each, own.registers).toPython())
        expected = {"input register", "holding register"} if kind == "actuator" else {"input register"}
        assert tables == {table: (entries[table, name].address, entries[table, name].count) for table in expected}
        checked += 1
    assert checked == len(points.sensors) + len(points.meters) + len(points.actuators)


def test_semantic_model__zone_has_its_points_and_meters_their_readings() -> None:
    _, graph = model_of("ref-small-office")
    zone = URIRef(f"{building_namespace('ref-small-office')}Zone.Core_ZN")
    classes = {graph.value(point, RDF.type) for point in graph.objects(zone, brick.hasPoint)}
    assert classes == {
        brick.Zone_Air_Temperature_Sensor,
        brick.Heating_Zone_Air_Temperature_Setpoint,
        brick.Cooling_Zone_Air_Temperature_Setpoint,
    }
    (meter,) = instances(graph, "Building_Electrical_Meter")
    assert graph.value(meter, brick.meters) == URIRef(
        f"{building_namespace('ref-small-office')}Building.ref-small-office"
    )
    assert [str(graph.value(sub, RDFS.label)) for sub in graph.objects(meter, brick.hasSubMeter)] == [
        "Cooling:Electricity"
    ]


def test_semantic_model__schedules_are_the_setpoints_of_the_zones_that_use_them() -> None:
    building = read_building(find_building("ref-small-office"))
    schedule = Actuator(
        name="cooling", component_type="Schedule:Compact", control_type="Schedule Value", key="CLGSETP_SCH", unit="1"
    )
    graph = graph_of(semantic_turtle(building, "office", Points(actuators=(schedule,))))
    (point,) = instances(graph, "Cooling_Zone_Air_Temperature_Setpoint")
    assert len(list(graph.subjects(brick.hasPoint, point))) == len(building.objects["ZoneControl:Thermostat"])


def test_semantic_model__is_the_same_text_each_time() -> None:
    building = read_building(find_building("hotel-large"))
    assert len({semantic_turtle(building, "office", points_of(building)) for _ in range(2)}) == 1


HOSTILE = (
    'a" . <urn:x> <urn:y> "b',
    "<script>alert(1)</script>",
    "back\\slash \\u0041",
    "new\nline\ttab\r",
    "日本 Zone é",
    "ends with a dot.",
    "#/?%20~.",
    "\u2028 \u202e {brick:Zone}",
)


def test_semantic_model__names_from_strangers_are_data() -> None:
    objects: dict[str, Any] = {"Zone": {name: {} for name in HOSTILE}}
    objects["ZoneHVAC:EquipmentConnections"] = {
        str(i): {"zone_name": name, "zone_conditioning_equipment_list_name": name} for i, name in enumerate(HOSTILE)
    }
    objects["ZoneHVAC:EquipmentList"] = {
        name: {"equipment": [{"zone_equipment_object_type": "ZoneHVAC:UnitHeater", "zone_equipment_name": name}]}
        for name in HOSTILE
    }
    building = Building('my "own" <building>#', objects, "")
    setpoints = [thermostat(zone, "Heating Setpoint") for zone in HOSTILE]
    points = Points(actuators=tuple(p.model_copy(update={"name": f"p{i}"}) for i, p in enumerate(setpoints)))
    turtle = semantic_turtle(building, "office", points)
    graph = graph_of(turtle)
    zones = instances(graph, "HVAC_Zone")
    assert {str(graph.value(zone, RDFS.label)) for zone in zones} == set(HOSTILE)
    assert len(instances(graph, "Space_Heater")) == len(HOSTILE)
    owned = {str(graph.value(zone, RDFS.label)) for zone in zones if (zone, brick.hasPoint, None) in graph}
    assert owned == {name for name in HOSTILE if replace_controls(name) == name}  # as keys on the bus are without
    assert URIRef("urn:x") not in graph.all_nodes()
    assert not violations(turtle)
    assert graph_of(graph.serialize(format="turtle")).isomorphic(graph)


TEXTS = st.text(st.characters(codec=None), max_size=20)


@settings(max_examples=examples(30))
@given(subject=TEXTS, label=TEXTS, number=st.integers() | st.floats(0, 1e9).map(lambda x: round(x, 3)))
def test_triples__turtle_has_the_texts(subject: str, label: str, number: float) -> None:
    triples = Triples({"x": "urn:x#"})
    entity = Iri(f"urn:x#{encoded_name(subject)}")
    triples.add(entity, Iri("urn:x#label"), label)
    triples.add(entity, Iri("urn:x#number"), number)
    graph = graph_of(triples.turtle())
    whole = label.encode(errors="surrogatepass").decode("utf-8", errors="ignore")
    (text,) = graph.objects(URIRef(str(entity)), URIRef("urn:x#label"))
    assert isinstance(text, Literal)
    assert str(text).replace("\ufffd", "") == whole.replace("\ufffd", "")
    (value,) = graph.objects(URIRef(str(entity)), URIRef("urn:x#number"))
    assert value == Literal(number) or float(value) == number


def test_semantic_model__of_damaged_or_odd_objects_leaves_out_what_it_cannot_place(tmp_path: Path) -> None:
    objects: dict[str, Any] = {
        "Zone": {"A": {}},
        "BuildingSurface:Detailed": {"f": {"surface_type": "Floor", "zone_name": "A", "vertices": [{}]}},
        "AirLoopHVAC": {"Loop": {"branch_list_name": "missing", "demand_side_inlet_node_names": "n"}},
        "PlantLoop": {"Water": {"plant_side_branch_list_name": "also missing"}},
        "Space": {"S": {"zone_name": "B"}},
    }
    turtle = semantic_turtle(Building("odd", objects, ""), "office", Points())
    graph = graph_of(turtle)
    assert len(instances(graph, "Zone")) == len(instances(graph, "AHU")) == 1
    assert json.dumps(str(next(iter(instances(graph, "Water_Loop")))))
