"""The reason why EnergyPlus cannot start a model: its first errors, and the line of the user's file."""

import re
from pathlib import Path

import pytest

from zenostat.models.building.model import read_building
from zenostat.models.building.source_lines import locate, read_source
from zenostat.models.catalog import bundled_weathers, find_building
from zenostat.models.err_file import explain
from zenostat.models.points.discovery import discover
from zenostat.topics.errors import InvalidConfig, ModelError

REFERENCES = {
    "Lights": "Schedule Name",
    "People": "Number of People Schedule Name",
    "ElectricEquipment": "Schedule Name",
    "ZoneInfiltration:DesignFlowRate": "Schedule Name",
}
"""Object types, with a field that refers to a schedule. EnergyPlus crashes where one is invalid."""


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
    with pytest.raises(InvalidConfig) as caught:
        discover(read_building(find_building(str(path))), bundled_weathers()[0].path)
    head, error = str(caught.value).splitlines()
    assert head.startswith(f"{path} is not a valid model for EnergyPlus ")
    assert re.search(rf"line {line}: {kind} '.+': .*schedule_name is '\w+_TYPO', .*; did you mean '\w+'", error), error


MAY_BE_ALLOWED = {
    "Fan:ConstantVolume": ("Availability Schedule Name", "the model has no schedule of that name; did you mean "),
    "AirTerminal:SingleDuct:ConstantVolume:NoReheat": (
        "Air Inlet Node Name",
        "a node that nothing else in the model names; did you mean ",
    ),
}


@pytest.mark.variants
@pytest.mark.process
@pytest.mark.parametrize("kind", MAY_BE_ALLOWED)
def test_an_invalid_name__that_may_be_allowed_is_left_to_energyplus_and_told_with_its_error(
    kind: str, tmp_path: Path
) -> None:
    field, words = MAY_BE_ALLOWED[kind]
    text, line = _with_invalid_reference(kind, field)
    path = tmp_path / "mine.idf"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(ModelError) as caught:
        discover(read_building(find_building(str(path))), bundled_weathers()[0].path)
    head, *_, also, hint = str(caught.value).splitlines()
    assert head.startswith(f"EnergyPlus could not start {path}")
    assert also == f"{path} also has:"
    assert re.search(rf"  line {line}: {kind} '.*_TYPO', .*{words}'", hint), hint


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
    assert locate(message, read_source(idf).entries) == "line 5: Lights 'Z Lights': schedule_name"
    assert locate(message, read_source(epjson).entries) == "line 6: Lights 'Z Lights': schedule"
    assert locate('Lights="Z LIGHTS" has a fault', read_source(idf).entries) == "line 3: Lights 'Z Lights'"
    assert locate('Lights="ZZ" has a fault', read_source(idf).entries) is None
    assert read_source(other).entries == ()
