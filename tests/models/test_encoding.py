"""Bytes of a model file: those that EnergyPlus reads, and an error for each other one."""

from pathlib import Path

import pytest

from zenostat.models.building.source_lines import read_source
from zenostat.models.input_format.encoding import check_encoding, decode_epjson
from zenostat.topics.errors import InvalidConfig

ZONE = "Version,25.2;\n! Büro\nZone,\n  Büro;  !- Name\n"


@pytest.mark.parametrize(
    "raw", [ZONE.encode(), ZONE.replace("\n", "\r\n").encode(), b"Version,25.2; ! caf\xe9\nZone,A; !- \xfc\n"]
)
def test_check_encoding__accepts_utf_8_and_any_byte_in_a_comment(raw: bytes) -> None:
    check_encoding(raw, Path("office.idf"))


@pytest.mark.parametrize(
    ("raw", "text"),
    [
        (b" \r\n", "office.idf is not an IDF: it is empty"),
        (ZONE.encode("utf-16"), "perhaps it is in UTF-16"),
        (b"Version,25.2;\nZone,\0A;\n", "office.idf is not an IDF: line 2 has a NUL byte"),
        (b"##include zones.imf\nVersion,25.2;\n", "office.idf, line 1: ##include is a command of EpMacro"),
        (ZONE.encode("utf-8-sig"), "byte-order mark"),
        (b' {"Version": {}}', "not an IDF but JSON: name it office.epJSON"),
        (b"Version,25.2;\rZone,A;\r", "CR alone"),
        (ZONE.encode("latin-1"), "office.idf, line 4: the byte 0xFC is not UTF-8"),
    ],
)
def test_check_encoding__names_what_is_wrong(raw: bytes, text: str) -> None:
    with pytest.raises(InvalidConfig, match=text):
        check_encoding(raw, Path("office.idf"))


def test_read_source__macros_of_a_file_are_no_fields(tmp_path: Path) -> None:
    path = tmp_path / "office.idf"
    path.write_text("Version,25.2;\n##include zones.imf\nZone,A;\n")
    assert read_source(path).issues == ()


TWO_ZONES = '{"Version": {"v": {"version_identifier": "25.2"}},\n"Zone": {"Büro": {},\n"Büro": {"x_origin": 1}}}'


@pytest.mark.parametrize("raw", [TWO_ZONES.encode("utf-8-sig"), TWO_ZONES.replace("\n", "\r\n").encode()])
def test_read_source__epjson_with_a_byte_order_mark_has_lines(raw: bytes, tmp_path: Path) -> None:
    path = tmp_path / "office.epJSON"
    path.write_bytes(raw)
    source = read_source(path)
    assert [(each.kind, each.line) for each in source.entries] == [("Version", 1), ("Zone", 2), ("Zone", 3)]
    assert len(source.issues) == 1


@pytest.mark.parametrize(
    ("encoding", "text"),
    [("utf-16", "perhaps it is in UTF-16"), ("latin-1", "office.epJSON, line 2: the byte 0xFC is not UTF-8")],
)
def test_decode_epjson__names_what_is_wrong(encoding: str, text: str) -> None:
    with pytest.raises(InvalidConfig, match=text):
        decode_epjson(TWO_ZONES.encode(encoding), Path("office.epJSON"))
