"""Project Haystack: entities of buildings against Haystack's own definitions, files read by another library."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

import phable
import pytest
import rusty_haystack
from rusty_haystack import DefNamespace, HDict, Marker
from test_semantic_model import HOSTILE, QUICK, Points, points_of, thermostat

from zenostat.models.building.model import Building, read_building
from zenostat.models.catalog import bundled_buildings, find_building
from zenostat.models.semantic.brick_classes import EQUIPMENT, METERS, OTHER_METER, SUPERCLASSES
from zenostat.models.semantic.haystack import (
    CODECS,
    ENTITY_TAGS,
    POINT_TAGS,
    Entity,
    haystack_entities,
    haystack_text,
    tags_of,
)

OWN = {"zenostatKey", "modbusInputRegister", "modbusHoldingRegister", "bacnetCur", "bacnetWrite"}
NOT_ALONE = {"light", "level", "condenser", "run"}
"""Parts of Haystack's compound definitions (`light-level`), and adjectives, which need no definition of their own."""


@cache
def definitions() -> DefNamespace:
    """The standard libraries ph, phScience, phIoT and phIct, which the library contains."""
    return DefNamespace.load_standard()


@cache
def entities_of(name: str) -> list[Entity]:
    building = read_building(find_building(name))
    return haystack_entities(building, "office", points_of(building))


def with_tags(entities: list[Entity], *tags: str) -> list[Entity]:
    return [entity for entity in entities if all(tag in entity for tag in tags)]


BUNDLED = [entry.name for entry in bundled_buildings()]


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in BUNDLED]
)
def test_haystack__entities_of_a_building_fit_the_definitions(name: str) -> None:
    entities, model = entities_of(name), read_building(find_building(name)).objects
    issues = [str(issue) for entity in entities for issue in definitions().validate_entity(HDict(entity))]
    assert issues == []
    identities = [entity["id"].val for entity in entities]
    assert len(set(identities)) == len(identities)
    refs = [
        value.val for entity in entities for tag, value in entity.items() if tag.endswith("Ref") or tag == "submeterOf"
    ]
    assert set(refs) <= set(identities)
    assert len(with_tags(entities, "site")) == 1
    assert len(with_tags(entities, "zone", "space")) == len(model["Zone"])
    assert len(with_tags(entities, "ahu")) == len(model.get("AirLoopHVAC", {}))
    assert len(with_tags(entities, "plant")) == len(model.get("PlantLoop", {})) + len(model.get("CondenserLoop", {}))
    sites = {entity["id"].val for entity in with_tags(entities, "site")}
    assert {entity["siteRef"].val for entity in entities if "site" not in entity} == sites


@pytest.mark.parametrize(
    "tag", sorted({tag for table in (ENTITY_TAGS, POINT_TAGS) for tags in table.values() for tag in tags.split()})
)
def test_haystack__tag_is_defined(tag: str) -> None:
    assert definitions().get_def(tag) is not None or tag in NOT_ALONE


def test_haystack__each_class_of_the_graph_has_tags() -> None:
    equipment = {
        *EQUIPMENT.values(),
        "AHU",
        "HVAC_Equipment",
        *(c for row in (*METERS.values(), OTHER_METER) for c in row[:2]),
    }
    assert [name for name in equipment if "equip" not in tags_of(name, ENTITY_TAGS)] == []
    points = [name for name in SUPERCLASSES if name.endswith(("_Sensor", "_Setpoint", "_Command"))]
    functions = {"sensor", "sp", "cmd"}
    assert [name for name in points if len(functions & set(tags_of(name, POINT_TAGS))) != 1] == []


@pytest.mark.parametrize(
    ("tags", "definition"),
    [
        (("hvac", "zone"), "hvac-zone-space"), (("ahu",), "ahu"), (("vav",), "vav"),
        (("chilled", "plant"), "chilled-water-plant"), (("hot", "plant"), "hot-water-plant"),
        (("elec", "meter"), "elec-meter"), (("fan",), "fan-motor"), (("pump",), "pump-motor"),
        (("sensor",), "sensor-point"), (("sp",), "sp-point"), (("coolingCoil",), "coolingCoil"),
    ],
)  # fmt: skip
def test_haystack__entities_are_of_the_standard_types(tags: tuple[str, ...], definition: str) -> None:
    members = with_tags(entities_of("hotel-large"), *tags)
    assert members
    assert all(definitions().fits(HDict(entity), definition) for entity in members)


def test_haystack__feeds_and_parts_are_references() -> None:
    entities = entities_of("hotel-large")
    by_id = {entity["id"].val: entity for entity in entities}
    (chiller, *_) = with_tags(entities, "chiller")
    assert "chilled" in by_id[chiller["equipRef"].val]
    (tower, *_) = with_tags(entities_of("hospital"), "coolingTower")
    assert "condenser" in {e["id"].val: e for e in entities_of("hospital")}[tower["equipRef"].val]
    vav = with_tags(entities, "vav")[0]
    assert "ahu" in by_id[vav["airRef"].val]
    assert "zone" in by_id[vav["spaceRef"].val]
    reheat = next(e for e in with_tags(entities, "heatingCoil", "hotWaterHeating") if "vav" in by_id[e["equipRef"].val])
    assert {"hot", "water", "plant"} <= by_id[reheat["hotWaterRef"].val].keys()
    (main,) = with_tags(entities, "elec", "meter", "siteMeter")
    assert [each["submeterOf"].val for each in with_tags(entities, "elec", "submeter")] == [main["id"].val]


def test_haystack__point_has_its_place_unit_and_addresses() -> None:
    (point,) = (e for e in entities_of("ref-small-office") if e["dis"] == "core_zn_cooling_setpoint")
    assert {tag for tag, value in point.items() if isinstance(value, Marker)} == {
        "point", "zone", "air", "temp", "cooling", "sp", "writable",
    }  # fmt: skip
    assert (point["kind"], point["unit"], point["spaceRef"].val) == ("Number", "°C", "Zone.Core_ZN")
    assert point["bacnetWrite"] == point["bacnetCur"]
    assert point["zenostatKey"] == "zenostat/v3/office/actuator/*/core_zn_cooling_setpoint"


def plain(value: Any) -> Any:
    """A value of either library as built-in types."""
    kind = type(value).__name__
    if kind in ("Marker", "_Marker"):
        return True
    if kind == "Ref":
        return ("ref", value.val)
    if kind == "Number":
        return (float(value.val), value.unit)
    return str(value)


@pytest.mark.parametrize(("suffix", "read"), [(".zinc", phable.ph_from_zinc), (".json", phable.ph_from_json)])
def test_haystack__file_is_read_by_another_library(suffix: str, read: Any) -> None:
    entities = entities_of("ref-small-office")
    rows = read(haystack_text("ref-small-office", entities, suffix)).rows
    assert [{tag: plain(v) for tag, v in row.items() if v is not None} for row in rows] == [
        {tag: plain(v) for tag, v in entity.items()} for entity in entities
    ]


@pytest.mark.parametrize("suffix", CODECS)
def test_haystack__names_from_strangers_are_data(suffix: str) -> None:
    names = [*HOSTILE, "half \ud800 of a pair", "---", "id: @Zone.B"]
    building = Building('my "own" <building>#', {"Zone": {name: {} for name in names}}, "")
    setpoints = [thermostat(zone, "Heating Setpoint") for zone in HOSTILE]
    points = Points(actuators=tuple(p.model_copy(update={"name": f"p{i}"}) for i, p in enumerate(setpoints)))
    entities = haystack_entities(building, "office", points)
    text = haystack_text(building.name, entities, suffix)
    rows = rusty_haystack.decode_grid(CODECS[suffix], text).rows()
    zones = [row.get("dis") for row in rows if row.has("zone") and row.has("space")]
    assert [re.sub("\ufffd+", "?", zone) for zone in zones] == [name.replace("\ud800", "?") for name in names]
    assert len(rows) == 1 + len(names) + len(HOSTILE)
    assert all(
        set(row.get("id").val) <= set("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_:-.~")
        for row in rows
    )
