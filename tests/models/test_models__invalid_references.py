"""The reason why EnergyPlus cannot start a model: its first errors, and the line of the user's file."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from zenostat.models.building.model import read_building
from zenostat.models.building.source_lines import locate, read_objects
from zenostat.models.catalog import bundled_weathers, find_building
from zenostat.models.err_file import explain
from zenostat.models.points.discovery import discover
from zenostat.topics.errors import ModelError

REFERENCES = {
    "Lights": "Schedule Name",
    "People": "Number of People Schedule Name",
    "ElectricEquipment": "Schedule Name",
    "ZoneInfiltration:DesignFlowRate": "Schedule Name",
    "Fan:ConstantVolume": "Availability Schedule Name",
}
"""Object types, with a field that refers to a schedule. EnergyPlus crashes where one of the first four is invalid."""


def _with_invalid_reference(kind: str, field: str) -> tuple[str, int]:
    """Return an IDF in which a field of the first object of a type is mistyped, and the number of that line."""
    lines = find_building("ref-small-office").path.read_text(encoding="latin-1").splitlines()
    begin = next(i for i, line in enumerate(lines) if line.strip().casefold() == f"{kind},".casefold())
    at = next(i for i in range(begin, len(lines)) if re.search(rf"!- {field}", lines[i]))
    lines[at] = re.sub(r"(\w+)([,;])", r"\1_TYPO\2", lines[at], count=1)
    return "\n".join(lines), at + 1


@pytest.mark.process
@pytest.mark.parametrize("kind", REFERENCES)
def test_an_invalid_schedule__is_named_with_object_file_and_line(kind: str, tmp_path: Path) -> None:
    text, line = _with_invalid_reference(kind, REFERENCES[kind])
    path = tmp_path / "mine.idf"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(ModelError) as caught:
        discover(read_building(find_building(str(path))), bundled_weathers()[0].path)
    head, first, second, location, *_ = str(caught.value).splitlines()
    assert head.startswith(f"EnergyPlus could not start {path}")
    assert head.endswith("EnergyPlus reports:")
    assert f"{kind} = " in first
    assert "_TYPO, item not found" in second
    assert re.search(rf"\({path}, line {line}: {kind} '.+'; did you mean '\w+'", location), location


def _err_file(folder: Path, messages: int) -> None:
    lines = [
        f'   ** Severe  ** Zone="Z{i}", invalid\n   **   ~~~   ** part {i}\n   ** Warning ** no'
        for i in range(messages)
    ]
    (folder / "eplusout.err").write_text("\n".join([*lines, "   **  Fatal  ** because of Z0"]))


def test_explain__has_the_first_and_the_last_messages(tmp_path: Path) -> None:
    _err_file(tmp_path, 40)
    text = explain(tmp_path, "nothing")
    assert re.findall(r"part (\d+)", text) == ["0", "1", "2", "3", "4", "5", "6", "38", "39"]
    assert "… 31 more messages …" in text
    assert text.endswith("** Fatal ** because of Z0")
    _err_file(tmp_path, 9)
    assert re.findall(r"part (\d+)", explain(tmp_path, "nothing")) == list("012345678")
    assert explain(tmp_path / "none", "nothing") == "nothing"


def test_locate__finds_object_and_field_in_both_formats(tmp_path: Path) -> None:
    idf, epjson, other = (tmp_path / name for name in ("m.idf", "m.epJSON", "m.txt"))
    idf.write_text(
        "! Zone, Z;\nZone,Z; Lights,\n  Z Lights, !- Name\n  Z,\n  SCH_A; !- Schedule; \nLights,Z,Z,SCH_A;\n"
    )
    epjson.write_text(
        '{\n"Zone": {"Z": {}},\n"Lights": {\n"Z Lights": {\n"list": [{"a": "b"}],\n"schedule": "SCH_A"}\n}\n}'
    )
    message = 'GetLights: Lights="Z LIGHTS" invalid schedule=SCH_A of zone'
    assert locate(message, read_objects(idf)) == "line 5: Lights 'Z Lights'"
    assert locate(message, read_objects(epjson)) == "line 6: Lights 'Z Lights'"
    assert locate('Lights="Z LIGHTS" has a fault', read_objects(idf)) == "line 3: Lights 'Z Lights'"
    assert locate('Lights="ZZ" has a fault', read_objects(idf)) is None
    assert read_objects(other) == []
