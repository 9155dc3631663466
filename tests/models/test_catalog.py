"""Buildings and weather by name: those of the EnergyPlus wheel, a part of a name, a path."""

from pathlib import Path
from typing import Any

import pytest

from zenostat.models import catalog
from zenostat.models.catalog import Entry, building_name, find_building, find_weather, weather_name
from zenostat.models.weather.header import read_header
from zenostat.topics.errors import InvalidConfig, UnknownName
from zenostat.topics.keys import safe_name


def test_catalog__wheel_has_32_buildings_and_16_weathers() -> None:
    assert len(catalog.bundled_buildings()) == 32
    assert len(catalog.bundled_weathers()) == 16


@pytest.mark.parametrize(
    "entries", [catalog.bundled_buildings(), catalog.bundled_weathers()], ids=["buildings", "weathers"]
)
def test_catalog__names_are_sorted_unique_and_of_files(entries: tuple[Entry, ...]) -> None:
    names = [entry.name for entry in entries]
    assert names == sorted(set(names))
    assert len({name.casefold() for name in names}) == len(names)
    assert all(entry.path.is_file() for entry in entries)


def test_catalog__buildings_name_can_be_the_name_of_a_node() -> None:
    for entry in catalog.bundled_buildings():
        assert entry.name == safe_name(entry.name)


@pytest.mark.parametrize("entry", catalog.bundled_buildings(), ids=lambda e: e.name)
def test_catalog__building_is_found_by_its_name_and_by_its_file(entry: Entry) -> None:
    for text in (entry.name, entry.name.upper(), entry.path.stem, str(entry.path)):
        assert find_building(text).path == entry.path


@pytest.mark.parametrize("entry", catalog.bundled_weathers(), ids=lambda e: e.name)
def test_catalog__weather_is_found_and_covers_a_year(entry: Entry) -> None:
    for text in (entry.name, entry.name.lower(), entry.path.stem, str(entry.path)):
        assert find_weather(text).path == entry.path
    header = read_header(entry.path)
    assert (header.first, header.last) == ((1, 1), (12, 31))
    # All 16 are in the contiguous United States.
    assert 24.0 < header.latitude_deg < 50.0
    assert -125.0 < header.longitude_deg < -66.0
    assert -8.0 <= header.time_zone_h <= -5.0
    assert header.place.split(", ")[1:] == [entry.name.split("_")[1], "USA"]


@pytest.mark.parametrize(
    ("name_of", "stem", "name"),
    [
        (building_name, "ASHRAE901_OfficeMedium_STD2019_Denver", "office-medium"),
        (building_name, "ASHRAE901_RestaurantSitDown_STD2019_Denver", "restaurant-sit-down"),
        (building_name, "ASHRAE901_OutPatientHealthCare_STD2019_Denver", "outpatient"),
        (building_name, "RefBldgStand-aloneRetailNew2004_Chicago", "ref-stand-alone-retail"),
        (building_name, "RefBldgOutPatientNew2004_Chicago", "ref-outpatient"),
        (building_name, "MyHouse", "MyHouse"),
        (weather_name, "USA_CO_Denver-Aurora-Buckley.AFB.724695_TMY3", "USA_CO_Denver"),
        (weather_name, "USA_CO_Golden-NREL.724666_TMY3", "USA_CO_Golden"),
        (weather_name, "USA_CA_San.Francisco.Intl.AP.724940_TMY3", "USA_CA_San.Francisco"),
        (weather_name, "USA_CA_Fresno.Air.Terminal.723890_TMY3", "USA_CA_Fresno"),
        (weather_name, "here", "here"),
    ],
)
def test_catalog__building_has_a_short_name_and_weather_that_of_its_place(name_of: Any, stem: str, name: str) -> None:
    assert name_of(stem) == name


@pytest.mark.parametrize(
    ("find", "part", "name"),
    [
        (find_building, "sit-down", "restaurant-sit-down"), (find_building, "SUPER", "ref-super-market"),
        (find_building, "BldgMediumOffice", "ref-medium-office"), (find_weather, "denver", "USA_CO_Denver"),
        (find_weather, "722020", "USA_FL_Miami"),
    ],
)  # fmt: skip
def test_catalog__part_that_fits_one_building_or_weather_is_enough(find: Any, part: str, name: str) -> None:
    assert find(part).name == name


def test_catalog__whole_name_is_meant_even_where_it_is_a_part_of_another() -> None:
    assert find_building("hospital").name == "hospital"
    assert find_building("ref-hospital").name == "ref-hospital"


def test_catalog__part_that_fits_several_names_them_all() -> None:
    with pytest.raises(UnknownName) as raised:
        find_building("hotel")
    message = str(raised.value)
    assert "'hotel' matches several" in message
    assert all(name in message for name in ("hotel-large", "hotel-small", "ref-large-hotel", "ref-small-hotel"))
    assert "hospital" not in message


def test_catalog__misspelt_name_lists_near_ones() -> None:
    with pytest.raises(UnknownName, match=r"no building 'ofice-medium'; did you mean .*'office-medium'"):
        find_building("ofice-medium")
    with pytest.raises(UnknownName, match=r"no weather 'USA_CO_Denvr'; did you mean .*'USA_CO_Denver'"):
        find_weather("USA_CO_Denvr")


@pytest.mark.parametrize("text", ["", "qqq"])
def test_catalog__what_is_like_nothing_lists_what_there_is(text: str) -> None:
    with pytest.raises(UnknownName, match=r"there are: 'apartment-high-rise'.* and \d+ more"):
        find_building(text)


# Paths


def test_catalog__path_is_a_building_of_that_name(tmp_path: Path) -> None:
    for name in ("house.idf", "house.IDF", "house.epJSON"):
        path = tmp_path / name
        path.write_text("")
        assert find_building(str(path)) == Entry("house", path)


def test_catalog__relative_path_is_made_absolute(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "here.epw").write_text("")
    monkeypatch.chdir(tmp_path)
    for text in ("here.epw", "./here.epw"):
        assert find_weather(text).path == tmp_path / "here.epw"


def test_catalog__path_may_begin_at_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "house.idf").write_text("")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert find_building("~/house.idf").path == tmp_path / "house.idf"


@pytest.mark.parametrize("text", ["house.idf", "some/house", "/nowhere/house.epJSON"])
def test_missing_path__is_named_in_full(text: str) -> None:
    with pytest.raises(UnknownName) as raised:
        find_building(text)
    assert str(Path(text).absolute()) in str(raised.value)


def test_catalog__home_that_is_not_there_is_unknown() -> None:
    with pytest.raises(UnknownName):
        find_building("~nobody-of-that-name/house.idf")
    with pytest.raises(UnknownName, match="File name too long"):
        find_building("x" * 3000 + ".idf")


@pytest.mark.parametrize(("name", "words"), [("m.imf", "EPMacro makes an IDF of it"), ("m.json", r"\.epjson or \.idf")])
def test_catalog__bare_name_of_a_file_of_another_kind_is_no_building_name(
    name: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text("")
    with pytest.raises(UnknownName, match=f"{name} is not a building file: its suffix should be .*{words}"):
        find_building(name)


def test_catalog__file_of_another_kind_is_refused_with_the_right_one(tmp_path: Path) -> None:
    path = tmp_path / "house.txt"
    path.write_text("")
    with pytest.raises(UnknownName, match=r"house\.txt is not a building file: its suffix should be \.epjson or \.idf"):
        find_building(str(path))
    with pytest.raises(UnknownName, match=r"house\.txt is not a weather file: its suffix should be \.epw"):
        find_weather(str(path))


def test_catalog__folder_is_no_building(tmp_path: Path) -> None:
    (tmp_path / "house.idf").mkdir()
    with pytest.raises(UnknownName, match=r"house\.idf is a folder, and a file is expected; it has no building file"):
        find_building(str(tmp_path / "house.idf"))


# What a weather file says of itself


def epw(path: Path, *, location: str, periods: str) -> Path:
    holidays = "HOLIDAYS/DAYLIGHT SAVINGS,No,0,0,0"
    path.write_text("\n".join([location, *["COMMENTS"] * 3, holidays, *["COMMENTS"] * 2, periods, "data"]))
    return path


LOCATION = "LOCATION,Denver,CO,USA,TMY3,724695,39.8,-104.7,-7.0,1650.0"
PERIODS = "DATA PERIODS,1,1,Data,Sunday, 5/ 1, 9/30"


def test_catalog__header_is_read(tmp_path: Path) -> None:
    header = read_header(epw(tmp_path / "a.epw", location=LOCATION, periods=PERIODS))
    assert header.place == "Denver, CO, USA"
    assert (header.latitude_deg, header.longitude_deg) == (39.8, -104.7)
    assert (header.time_zone_h, header.elevation_m) == (-7.0, 1650.0)
    assert (header.first, header.last) == ((5, 1), (9, 30))


@pytest.mark.parametrize(
    ("location", "periods"),
    [
        ("PLACE,Denver", PERIODS),
        (LOCATION, "HOLIDAYS"),
        ("LOCATION,Denver", PERIODS),
        (LOCATION, "DATA PERIODS,1,1,Data,Sunday,May,9/30"),
        ("", ""),
    ],
)
def test_catalog__header_that_is_none_is_refused_with_the_files_name(
    tmp_path: Path, location: str, periods: str
) -> None:
    path = epw(tmp_path / "broken.epw", location=location, periods=periods)
    with pytest.raises(InvalidConfig, match=r"broken\.epw"):
        read_header(path)
