"""OpenStudio models and gbXML: translated by OpenStudio, then read as any IDF. Skipped where it is not installed."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest

from zenostat.eplus_node.config import read_config
from zenostat.eplus_node.plan import plan
from zenostat.models.building import openstudio
from zenostat.models.building.model import read_building
from zenostat.models.building.systems import air_loops
from zenostat.models.catalog import find_building
from zenostat.topics.errors import InvalidConfig

pytestmark = pytest.mark.process

_EXAMPLE = """
import openstudio, sys
model = openstudio.model.exampleModel()
model.save(openstudio.toPath(sys.argv[1] + "/example.osm"), True)
openstudio.gbxml.GbXMLForwardTranslator().modelToGbXML(model, openstudio.toPath(sys.argv[1] + "/example.xml"))
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with OpenStudio's example model, as OSM and as gbXML."""
    pytest.importorskip("openstudio", reason="pip install openstudio==3.11.0")
    path = tmp_path_factory.mktemp("openstudio")
    subprocess.run([sys.executable, "-c", _EXAMPLE, str(path)], check=True, stdout=subprocess.DEVNULL)
    return path


def test_read_building__translates_an_openstudio_model_with_its_hvac(folder: Path) -> None:
    building = read_building(find_building(str(folder / "example.osm")))
    assert building.notes[0].startswith("translated by OpenStudio 3.")
    (loop,) = air_loops(building.objects)
    assert [part.name for part in loop.parts if part.kind == "Zone"] == list(building.objects["Zone"])
    assert "Coil:Cooling:DX:SingleSpeed" in building.objects


def test_plan__of_an_openstudio_model_has_points_and_geometry(folder: Path) -> None:
    planned = plan(
        read_config(
            {"building": str(folder / "example.osm"), "weather": "USA_CO_Denver", "begin": "07-03", "end": "07-03"}
        )
    )
    assert {actuator.control_type for actuator in planned.points.actuators} >= {"Heating Setpoint", "Cooling Setpoint"}
    geometry = planned.geometry.geometry
    assert geometry is not None
    assert [zone.name for zone in geometry.zones] == list(planned.building.objects["Zone"])
    assert sum(zone.floor_area_m2 for zone in geometry.zones) == pytest.approx(400.0)  # four spaces of 10 m by 10 m


def test_read_building__reads_zones_and_surfaces_of_a_gbxml(folder: Path) -> None:
    of_gbxml = read_building(find_building(str(folder / "example.xml"))).objects
    of_osm = read_building(find_building(str(folder / "example.osm"))).objects
    assert len(of_gbxml["Zone"]) == 1
    assert "AirLoopHVAC" not in of_gbxml
    windows = "FenestrationSurface:Detailed"
    assert len(of_gbxml[windows]) == len(of_osm[windows])


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("bad.osm", "hello", "is not an OpenStudio model that OpenStudio can read"),
        ("bad.xml", "<a/>", "is not a gbXML file that OpenStudio can read"),
    ],
)
@pytest.mark.usefixtures("folder")
def test_translate__file_that_is_none_is_one_error(name: str, text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InvalidConfig, match=words) as caught:
        read_building(find_building(str(path)))
    assert str(path) in str(caught.value)


def test_translate__without_openstudio_names_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> str:
        raise PackageNotFoundError(name)

    monkeypatch.setattr(openstudio, "version", missing)
    path = tmp_path / "mine.osm"
    path.write_text("")
    with pytest.raises(InvalidConfig, match=r"mine\.osm needs OpenStudio.*pip install openstudio"):
        read_building(find_building(str(path)))
