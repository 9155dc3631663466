"""References that are refused: EnergyPlus itself ends at each of them, so no model that it simulates is refused."""

from __future__ import annotations

import copy
import json
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from support.box_model import box_model
from support.data_packs import sinergym

from zenostat.models import schema
from zenostat.models.building.model import for_episode, read_building
from zenostat.models.building.object_lists import object_lists
from zenostat.models.building.references import dangling_references
from zenostat.models.catalog import bundled_weathers, find_building
from zenostat.models.run_period import Period

_RUN = """
import sys
from pyenergyplus.api import EnergyPlusAPI
api = EnergyPlusAPI()
state = api.state_manager.new_state()
api.runtime.set_console_output_status(state, False)
sys.exit(api.runtime.run_energyplus(state, ["-w", sys.argv[1], "-d", sys.argv[2], sys.argv[3]]))
"""

Objects = dict[str, dict[str, Any]]


def mistyped(objects: Objects) -> Iterator[tuple[str, str, Objects]]:
    """Each type and field of a model that refers to an object, with the model in which the first one is mistyped."""
    for kind, items in objects.items():
        for path in object_lists(kind):
            first, _, member = path.partition(".")
            for name, fields in items.items():
                value = fields.get(first)
                holder = value[0] if member and isinstance(value, list) and value else fields
                text = holder.get(member or first)
                if path != "name" and isinstance(text, str) and text:
                    changed = copy.deepcopy(objects)
                    target = changed[kind][name]
                    (target[first][0] if member else target)[member or first] = f"{text}_TYPO"
                    yield kind, path, changed
                    break


def exit_code(objects: Objects, folder: Path) -> int:
    """The exit code of EnergyPlus for a day of a model."""
    folder.mkdir()
    path = folder / "in.epJSON"
    path.write_text(json.dumps(objects))
    command = [sys.executable, "-P", "-c", _RUN, str(bundled_weathers()[0].path), str(folder), str(path)]
    return subprocess.run(command, check=False, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode


@pytest.mark.slow
@pytest.mark.process
@pytest.mark.parametrize("name", ["5ZoneAutoDXVAV", "2ZoneDataCenterHVAC_wEconomizer_CW", "warehouse"])
def test_dangling_references__energyplus_ends_at_each_that_is_fatal(name: str, tmp_path: Path) -> None:
    sinergym()
    day = date(2017, 1, 1)
    objects = for_episode(read_building(find_building(name)), Period(day, day, 4))
    cases = []
    for number, (kind, path, changed) in enumerate(mistyped(objects)):
        reference = next(dangling_references(changed))
        assert (reference.kind, reference.field.replace("[0]", "")) == (kind, path)
        if reference.is_fatal:
            cases.append((f"{kind} {path}", changed, tmp_path / str(number)))
    assert len(cases) > 30
    with ThreadPoolExecutor(2) as pool:
        codes = dict(zip([c[0] for c in cases], pool.map(lambda c: exit_code(c[1], c[2]), cases), strict=True))
    assert [case for case, code in codes.items() if code == 0] == []
    assert any(code < 0 for code in codes.values())  # some by a crash


VRF = [
    ("AirConditioner:VariableRefrigerantFlow", "availability_schedule_name", False),
    (
        "AirConditioner:VariableRefrigerantFlow",
        "cooling_capacity_ratio_modifier_function_of_low_temperature_curve_name",
        True,
    ),
    ("AirConditioner:VariableRefrigerantFlow", "cooling_part_load_fraction_correlation_curve_name", False),
    ("ZoneHVAC:TerminalUnit:VariableRefrigerantFlow", "supply_air_fan_object_name", True),
]
"""Fields of VRF systems, and whether EnergyPlus crashes at a missing object; it was tried for each, with a model."""


@pytest.mark.parametrize(("kind", "field", "is_fatal"), VRF)
def test_dangling_references__of_vrf_systems_are_fatal_where_energyplus_crashes(
    kind: str, field: str, *, is_fatal: bool
) -> None:
    (reference,) = dangling_references({kind: {"it": {field: "none"}}})
    assert reference.is_fatal == is_fatal


NOUNS = [
    ("ElectricLoadCenter:Distribution", "electrical_storage_object_name", "electrical storage"),
    ("ElectricLoadCenter:Distribution", "inverter_name", "inverter"),
    ("Generator:FuelCell", "water_supply_name", "fuel cell water supply"),
    ("Generator:PVWatts", "surface_name", "surface"),
    ("Lights", "schedule_name", "schedule"),
]


@pytest.mark.parametrize(("kind", "field", "noun"), NOUNS)
def test_describe__names_what_is_missing_in_words(kind: str, field: str, noun: str) -> None:
    (reference,) = dangling_references({kind: {"it": {field: "none"}}})
    assert f"but the model has no {noun} of that name" in reference.describe()


@pytest.mark.parametrize("kind", [kind for kind in schema.types() if f"{kind}:Design" in schema.types()])
def test_dangling_references__design_objects_of_each_type_are_found(kind: str) -> None:
    objects = {kind: {"it": {"design_object": "Sizes"}}, f"{kind}:Design": {"SIZES": {}}}
    assert list(dangling_references(objects)) == []


TYPES_BESIDE_NAMES = [
    ("AirLoopHVAC:UnitaryHeatCool:VAVChangeoverBypass", "heating_coil_{}", "Coil:Heating:DX:SingleSpeed"),
    ("AirLoopHVAC:UnitaryHeatPump:AirToAir:MultiSpeed", "heating_coil_{}", "Coil:Heating:Water"),
    ("FaultModel:Fouling:EvaporativeCooler", "evaporative_cooler_object_{}", "EvaporativeCooler:Indirect:WetCoil"),
    ("PlantEquipmentOperationSchemes", "control_scheme_1_{}", "PlantEquipmentOperation:UserDefined"),
]
"""Names beside which the schema allows a type that their object lists lack."""


@pytest.mark.parametrize(("kind", "field", "named"), TYPES_BESIDE_NAMES)
def test_dangling_references__object_of_the_type_beside_the_name_is_found(kind: str, field: str, named: str) -> None:
    type_field = next(
        name for name in (field.format("object_type"), field.format("type")) if schema.has_field(kind, name)
    )
    objects = {kind: {"it": {type_field: named, field.format("name"): "A"}}}
    assert schema.schema_errors(objects, complete=False) == []
    assert list(dangling_references(objects | {named: {"a": {}}})) == []
    assert [each.is_fatal for each in dangling_references(objects | {named: {"b": {}}})] == [True]


@pytest.mark.process
@pytest.mark.parametrize(("walls", "is_there"), [("", True), ("Half", False)])
def test_dangling_references__space_of_what_is_left_of_a_zone_is_found_where_energyplus_creates_it(
    walls: str, tmp_path: Path, *, is_there: bool
) -> None:
    """EnergyPlus creates a space for the surfaces of a zone that have none, if the zone has spaces."""
    objects = box_model() | {"Space": {"Half": {"zone_name": "box"}}}
    for surface in objects["BuildingSurface:Detailed"].values():
        surface["space_name"] = walls
    objects["BuildingSurface:Detailed"]["Floor"]["space_name"] = "Half"
    objects["Lights"]["Lights"]["zone_or_zonelist_or_space_or_spacelist_name"] = "BOX-REMAINDER"
    assert (list(dangling_references(objects)) == []) == is_there
    assert (exit_code(objects, tmp_path / "run") == 0) == is_there
