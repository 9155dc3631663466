"""Values of a wrong type in an epJSON: each is an error with its object and field, never a traceback."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from support.box_model import box_model
from support.run_cli import run_in_process

from zenostat.models.building.diagnostics import Severity, diagnose
from zenostat.models.upgrade.upgrade import upgrade_epjson
from zenostat.topics.errors import InvalidConfig

EMS = "EnergyManagementSystem:"
CASES: dict[str, tuple[dict[str, Any], str]] = {
    "no objects": ({"Version": []}, "Version: expected objects by name"),
    "no type": ({"Version": None}, "Version: expected objects by name"),
    "no fields": ({"Version": {"v": None}}, "Version 'v': expected fields by name"),
    "a number for a text": ({"Version": {"v": {"version_identifier": 25.2}}}, "version_identifier is 25.2"),
    "a decimal comma": ({"Site:Location": {"x": {"latitude": "39,8"}}}, "latitude is '39,8'"),
    "a text for a number": ({"Zone": {"Box": {"multiplier": "x", "floor_area": "f"}}}, "multiplier is 'x'"),
    "a number for a word": (
        {"OtherEquipment": {"o": {"fuel_type": 5, "zone_or_zonelist_or_space_or_spacelist_name": "Box"}}},
        "fuel_type is 5",
    ),
    "a space without its zone": ({"Space": {"s": {}}}, "lacks 'zone_name'"),
    "null for a list": ({"ZoneHVAC:EquipmentList": {"e": {"equipment": None}}}, "equipment is null"),
    "null in a list": ({"ZoneHVAC:EquipmentList": {"e": {"equipment": [None]}}}, "equipment[0] is None"),
    "a text for a line": ({f"{EMS}Program": {"p": {"lines": ["SET a = 1"]}}}, "lines[0] is 'SET a = 1'"),
    "a number for lines": ({f"{EMS}Subroutine": {"p": {"lines": 1.0}}}, "lines is 1.0"),
    "a text for a program": (
        {
            f"{EMS}ProgramCallingManager": {
                "m": {"energyplus_model_calling_point": "BeginNewEnvironment", "programs": ["p"]}
            }
        },
        "programs[0] is 'p'",
    ),
    "a text for a node": ({"NodeList": {"n": {"nodes": ["x"]}}}, "nodes[0] is 'x'"),
}  # fmt: skip


@pytest.mark.process
@pytest.mark.parametrize("case", CASES)
def test_model__with_a_value_of_a_wrong_type_has_an_error(case: str, tmp_path: Path) -> None:
    more, words = CASES[case]
    path = tmp_path / "box.epJSON"
    path.write_text(json.dumps(box_model() | more))
    ran = run_in_process("model", str(path), columns=1000)
    assert ran.returncode == 1
    assert words in ran.stdout


def test_diagnose__error_of_a_surface_leaves_its_zone_with_surfaces() -> None:
    objects = box_model()
    for surface in objects["BuildingSurface:Detailed"].values():
        surface["sun_exposure"] = 1.0
    errors = [each for each in diagnose(objects) if each.severity is Severity.ERROR]
    assert {each.field for each in errors} == {"sun_exposure"}


@pytest.mark.parametrize(
    ("kind", "fields"), [(f"{EMS}Program", {"lines": ["SET a = 1"]}), ("ZoneHVAC:EquipmentList", {"equipment": [None]})]
)
def test_upgrade__entries_that_are_no_objects_are_refused(kind: str, fields: dict[str, Any]) -> None:
    objects = {**box_model(), "Version": {"v": {"version_identifier": "9.0"}}, kind: {"x": fields}}
    (name, (entry,)), *_ = fields.items()
    with pytest.raises(InvalidConfig) as caught:
        upgrade_epjson(objects, name="mine.epJSON")
    assert f"{kind} 'x': {name}[0] is {entry!r}; expected fields by name" in str(caught.value)
