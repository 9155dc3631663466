"""Reading and writing IDF files: against EnergyPlus's own converter, and small files with their lines."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from zenostat.models import catalog, energyplus, schema
from zenostat.models.building.model import read_building
from zenostat.models.input_format.encoding import decode_idf
from zenostat.models.input_format.idd import idd_text
from zenostat.models.input_format.idf_reader import idf_version, read_idf
from zenostat.models.input_format.idf_writer import write_idf
from zenostat.models.input_format.layout import engine_layout
from zenostat.topics.errors import InvalidConfig

QUICK = ("office-small", "ref-midrise-apartment")
NAMES = [entry.name for entry in catalog.bundled_buildings()]


def without_metadata(objects: dict[str, Any]) -> dict[str, Any]:
    """Leave out what the converter adds."""
    return {
        kind: {name: {f: v for f, v in fields.items() if not f.startswith("idf_")} for name, fields in items.items()}
        for kind, items in objects.items()
    }


@pytest.mark.parametrize("name", [pytest.param(n, marks=[] if n in QUICK else pytest.mark.slow) for n in NAMES])
def test_idf_reader__reads_what_energyplus_converts_and_writes_it_again(name: str) -> None:
    entry = catalog.find_building(name)
    converted = without_metadata(dict(read_building(entry).objects))
    layout = engine_layout()
    own = read_idf(entry.path.read_text(encoding="latin-1"), layout, name=name).objects
    assert json.dumps(own, sort_keys=True) == json.dumps(converted, sort_keys=True)
    assert read_idf(write_idf(own, layout), layout, name=name).objects == own


def test_idf_reader__keeps_the_line_of_each_object_and_field() -> None:
    text = "! first\n\nZone,\n  Core, ! name\n  10.0; Zone, Attic;\nZoneList,\n  All,\n\n  Core,\n  Attic;\n"
    model = read_idf(text, engine_layout(), name="small.idf")
    assert model.objects == {
        "Zone": {"Core": {"direction_of_relative_north": 10.0}, "Attic": {}},
        "ZoneList": {"All": {"zones": [{"zone_name": "Core"}, {"zone_name": "Attic"}]}},
    }
    assert model.line("Zone", "Core") == 3
    assert model.line("Zone", "Core", "direction_of_relative_north") == 5
    assert model.line("Zone", "Attic") == 5
    assert model.line("ZoneList", "All", "zones[1].zone_name") == 10
    assert model.line("Zone", "Core", "volume") == 3
    assert model.line("Zone", "Nowhere") is None


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("\nZones,\n Core;", "line 2: EnergyPlus has no object type 'Zones'; did you mean 'Zone"),
        ("Version,25.2,\n 1;", "line 2: Version 'Version 1' has 2 fields, but the type has 1"),
        ("Zone,Core;\nZone,\nCORE;", "line 2: Zone 'CORE' is in the file twice; first in line 1"),
    ],
)
def test_idf_reader__names_the_line_of_what_it_cannot_read(text: str, reason: str) -> None:
    with pytest.raises(InvalidConfig) as raised:
        read_idf(text, engine_layout(), name="small.idf")
    assert reason in str(raised.value)
    assert "small.idf is not an IDF for EnergyPlus" in str(raised.value)


@pytest.mark.parametrize(
    ("value", "expected"),
    [("AUTOSIZE", "Autocalculate"), ("1e3", 1000.0), ("10", 10), ("99999999999", 99999999999.0), ("x", "x")],
)
def test_idf_reader__value_is_what_energyplus_reads(value: str, expected: object) -> None:
    fields = read_idf(f"Zone,Core,,,,,,,,{value};", engine_layout(), name="x").objects["Zone"]["Core"]
    assert fields == {"volume": expected}
    assert type(fields["volume"]) is type(expected)


def test_idf_reader__finds_the_version() -> None:
    assert idf_version("! Version,1.0;\nZone,Core;\nVERSION,\n 9.4 ! the version\n;") == "9.4"
    assert idf_version("Zone,Core;") is None


@pytest.mark.parametrize("text", ["Ålesund", "Voilà", "цех", "会议室", "\x85A\u2028", "A\x0b", "\xa0A\u3000", "A\x1cB"])
def test_idf_reader__names_and_comments_are_those_of_energyplus(text: str, tmp_path: Path) -> None:
    path, target = tmp_path / "model.idf", tmp_path / "model.epJSON"
    idf = f"! {text}; Zone, B\nVersion,25.2;\r\n! {text}\r, or not\r\nZone, {text} ; ! a\rb\n"
    path.write_bytes(idf.encode())
    energyplus.call("convert", path, target)
    model = read_idf(decode_idf(path.read_bytes()), engine_layout(), name="model.idf")
    assert list(model.objects["Zone"]) == list(json.loads(target.read_bytes())["Zone"]) == [text]
    assert model.line("Zone", text) == 4


def test_idf_writer__refuses_a_text_that_would_be_two_fields() -> None:
    with pytest.raises(InvalidConfig, match="contains a separator"):
        write_idf({"ZoneList": {"All": {"zones": [{"zone_name": "a, b"}]}}}, engine_layout())
    with pytest.raises(InvalidConfig, match="half of a surrogate pair"):
        write_idf({"ZoneList": {"All": {"zones": [{"zone_name": "\ud800"}]}}}, engine_layout())


def test_idd__has_each_type_and_each_field_of_the_schema() -> None:
    layout = engine_layout()
    text = idd_text(layout)
    assert text.startswith(f"!IDD_Version {layout.version}\n")
    starts = {line[:-1] for line in text.splitlines() if line[:1].isalpha()}
    assert starts == set(schema.types())
    zone = text.partition("\nZone,\n")[2].partition("\n\n")[0]
    entry = layout.find("Zone")
    assert entry is not None
    assert zone.count("\\field") == len(entry.order)
