"""Settings of the nodes of a district's plants, from its file."""

from pathlib import Path

import pytest
from support.coupled_plants import district_file

from zenostat.bridge.transport.certificates import make
from zenostat.cosim.launch import PlantSet, input_files
from zenostat.topics.errors import InvalidConfig


@pytest.mark.parametrize(
    ("field", "value", "is_path"),
    [
        ("plant", "tank.py:Tank", True),
        ("plant", "package.module:Tank", False),
        ("grid", "feeder.yaml", True),
        ("grid", "pandapower:cigre_lv", False),
        ("fmu", "tank.fmu", True),
        ("building", "models/office.idf", True),
        ("building", "office-small", False),
        ("scenario", "office.yaml", True),
        ("scenario", "zenostat/office-small-USA_CO_Denver-continuous-v1", False),
    ],
)
def test_settings__paths_are_relative_to_the_file_though_it_has_no_such_file(
    folder: Path, monkeypatch: pytest.MonkeyPatch, field: str, value: str, *, is_path: bool
) -> None:
    """A file of this name in the working directory is not meant."""
    elsewhere = folder / "elsewhere"
    place = elsewhere / (value.rpartition(":")[0] or value)
    place.parent.mkdir(parents=True)
    place.touch()
    monkeypatch.chdir(elsewhere)
    file = district_file(folder, f"plants:\n  a: {{{field}: '{value}'}}\n")
    settings = PlantSet(file)._settings("a")
    assert settings[field] == (f"{folder}/{value}" if is_path else value)
    assert set(input_files(file)) == {"district"}


def test_settings__nested_district_in_the_home_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/somebody")
    file = district_file(folder, "plants:\n  a: {district: ~/inner.yaml}\n")
    assert PlantSet(file)._settings("a") == {"district": "/home/somebody/inner.yaml"}


def test_settings__weather_files_and_names(folder: Path) -> None:
    (folder / "site").touch()
    weather = ["a.epw", "USA_CO_Denver", "/b.epw", "site"]
    file = district_file(folder, f"plants:\n  a: {{building: office-small, weather: {weather}}}\n")
    expected = [f"{folder}/a.epw", "USA_CO_Denver", "/b.epw", f"{folder}/site"]
    assert PlantSet(file)._settings("a")["weather"] == expected


def test_open__plant_whose_certificate_may_not_reset_is_named_with_its_line(folder: Path) -> None:
    make(folder / "keys")
    plant = "{node: office, connect: tls/127.0.0.1:1, keys: keys/monitor.pem}"
    file = district_file(folder, f"plants:\n  house: {plant}\n")
    with pytest.raises(InvalidConfig) as raised:
        PlantSet(file).open()
    expected = "is of the role monitor; controller and operator expected, as trainer.pem has"
    assert str(raised.value) == f"{file.path}:2: plant 'house': {folder}/keys/monitor.pem {expected}"
