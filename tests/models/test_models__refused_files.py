"""Models that cannot be: each error names the user's file and what in it is wrong."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from zenostat.models import energyplus
from zenostat.models.building.model import Building, check_runnable, read_building
from zenostat.models.building.unreadable import diagnose_unreadable
from zenostat.models.catalog import bundled_weathers, find_building
from zenostat.models.points.discovery import discover
from zenostat.models.weather.design_days import site
from zenostat.models.weather.header import read_header
from zenostat.topics.errors import MAX_LISTED, InvalidConfig

pytestmark = pytest.mark.process

OFFICE = find_building("office-small")


@pytest.fixture
def idf(tmp_path: Path) -> Callable[[str], Path]:
    def write(text: str) -> Path:
        path = tmp_path / "mine.idf"
        path.write_text(text, encoding="latin-1")
        return path

    return write


def read(path: Path) -> Building:
    return read_building(find_building(str(path)))


def test_models__unknown_object_of_an_idf_is_named_with_its_file_and_line(idf: Callable[[str], Path]) -> None:
    text = OFFICE.path.read_text("latin-1")
    begin = text.index("  Zone,")
    path = idf(text[:begin] + "  Zonne," + text[begin + len("  Zone,") :])
    with pytest.raises(InvalidConfig) as caught:
        read(path)
    line = text[:begin].count("\n") + 1
    for words in (str(path), f"line {line}: EnergyPlus has no object type 'Zonne'; did you mean 'Zone'"):
        assert words in str(caught.value)


def test_diagnose_unreadable__of_a_version_that_is_not_read_the_version_is_the_only_error(
    idf: Callable[[str], Path],
) -> None:
    path = idf("Version,7.2;\nBuilding,B" + ",1" * 30 + ";\nZoneHVAC:Old,it;")
    with pytest.raises(InvalidConfig) as caught:
        read(path)
    (diagnostic,) = diagnose_unreadable(path, caught.value)
    assert "is for EnergyPlus 7.2" in diagnostic.text


def test_models__object_that_is_in_the_file_twice_is_an_error(idf: Callable[[str], Path]) -> None:
    text = OFFICE.path.read_text("latin-1")
    begin = text.index("  Zone,")
    zone = text[begin : text.index(";", begin) + 1]
    with pytest.raises(
        InvalidConfig, match=r"mine\.idf is not a valid model(?s:.*)line \d+: Zone '.*' is in the file twice"
    ):
        read(idf(text + zone))


@pytest.mark.parametrize("text", ["", "hello world, this is none", "\x00\xff;\x02,", "! only a comment\n"])
def test_read_building__rejects_what_is_no_idf(idf: Callable[[str], Path], text: str) -> None:
    path = idf(text)
    with pytest.raises(InvalidConfig, match=r"mine\.idf is not an IDF") as caught:
        read(path)
    assert str(path) in str(caught.value)


def test_models__epjson_of_any_depth_is_one_error(tmp_path: Path) -> None:
    path = tmp_path / "deep.epJSON"
    path.write_text('{"Building":' + "[" * 50_000 + "]" * 50_000 + "}")
    with pytest.raises(InvalidConfig, match=r"deep\.epJSON is not an epJSON"):
        read(path)


def _office_with(more: Mapping[str, Any]) -> Building:
    building = read_building(OFFICE)
    objects = {**building.objects, **more}
    return Building("mine", objects, building.content + json.dumps(more), (), "/home/me/mine.epJSON")


def test_models__unknown_objects_and_fields_of_an_epjson_are_all_named() -> None:
    with pytest.raises(InvalidConfig) as caught:
        check_runnable(_office_with({"Zonne": {"a": {}}, "Zone": {"b": {"colour": "red"}}}))
    for words in ("/home/me/mine.epJSON", "no object type 'Zonne'", "Zone 'b' has no field 'colour'"):
        assert words in str(caught.value)


@pytest.mark.parametrize(
    "kind",
    [
        {"PythonPlugin:Instance": {"p": {"python_module_name": "m", "plugin_class_name": "P"}}},
        {"ExternalInterface": {"p": {"name_of_external_interface": "PtolemyServer"}}},
        {"ExternalInterface:FunctionalMockupUnitImport": {"p": {"fmu_file_name": "x.fmu"}}},
    ],
    ids=lambda kind: next(iter(kind)),
)
def test_models__model_that_has_other_programs_run_is_refused_by_name(kind: dict[str, Any]) -> None:
    with pytest.raises(InvalidConfig, match=rf"mine\.epJSON is not .*\n  {next(iter(kind))} 'p': .*not supported"):
        discover(_office_with(kind), bundled_weathers()[0].path)


def test_models__zone_that_does_not_exist_is_refused_with_the_users_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ZENOSTAT_CACHE", str(tmp_path / "cache"))
    lights = read_building(OFFICE).objects["Lights"]
    name, fields = next(iter(lights.items()))
    lost = _office_with({"Lights": {name: fields | {"zone_or_zonelist_or_space_or_spacelist_name": "Nowhere"}}})
    with pytest.raises(InvalidConfig, match=r"/home/me/mine\.epJSON is not a valid model(?s:.*)Nowhere"):
        discover(lost, bundled_weathers()[0].path)


def test_models__error_of_a_ddy_names_that_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ZENOSTAT_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(energyplus, "ISOLATED", ("false",))  # an EnergyPlus that ends without a word
    epw = tmp_path / "Ort.epw"
    epw.write_bytes(bundled_weathers()[0].path.read_bytes())
    epw.with_suffix(".ddy").write_text("Zone,a;")
    with pytest.raises(InvalidConfig, match=r"could not convert .*Ort\.ddy") as caught:
        site(epw, read_header(epw))
    assert "making-" not in str(caught.value)


def test_model_errors__list_the_first_of_many() -> None:
    with pytest.raises(InvalidConfig) as caught:
        check_runnable(Building("many", {f"None{i}": {} for i in range(1000)}, "", (), "many.epJSON"))
    assert len(str(caught.value).splitlines()) == MAX_LISTED + 2
