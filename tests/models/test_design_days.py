"""Location and design days of a weather file: which source is taken, and that EnergyPlus has them so."""

from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.energyplus_alone import run_energyplus
from support.weather_files import DRY_BULB, Outdoors, run

from zenostat.models.building.model import for_episode, read_building, write
from zenostat.models.catalog import find_building, find_weather
from zenostat.models.err_file import severe_messages
from zenostat.models.run_period import Period
from zenostat.models.weather.design_days import Site, apply, check_edits, from_header, site, standard_pressure
from zenostat.models.weather.header import DesignConditions, Header, read_header
from zenostat.topics.errors import InvalidConfig

DENVER = find_weather("USA_CO_Denver").path
BOULDER = find_weather("USA_CO_Boulder").path

# As such files are written: comments, the unit's degree sign in Latin-1, CRLF, a day beside the two.
HEATING = """
 ! Ort Annual Heating 99.6%, MaxDB=-11.5°C
 SizingPeriod:DesignDay,
  Ort Ann Htg 99.6% Condns DB,     !- Name
          1,      !- Month
         21,      !- Day of Month
  WinterDesignDay,!- Day Type
      -11.5,      !- Maximum Dry-Bulb Temperature {C}
        0.0,      !- Daily Dry-Bulb Temperature Range {C}
 DefaultMultipliers, !- Dry-Bulb Temperature Range Modifier Type
           ,      !- Dry-Bulb Temperature Range Modifier Schedule Name
    Wetbulb,      !- Humidity Condition Type
      -11.5,      !- Wetbulb at Maximum Dry-Bulb {C}
           ,      !- Humidity Indicating Day Schedule Name
           ,      !- Humidity Ratio at Maximum Dry-Bulb {kgWater/kgDryAir}
           ,      !- Enthalpy at Maximum Dry-Bulb {J/kg}
           ,      !- Daily Wet-Bulb Temperature Range {deltaC}
     98000.,      !- Barometric Pressure {Pa}
        3.1,      !- Wind Speed {m/s}
        250,      !- Wind Direction {Degrees; N=0, S=180}
         No,      !- Rain {Yes/No}
         No,      !- Snow on ground {Yes/No}
         No,      !- Daylight Savings Time Indicator
  ASHRAEClearSky, !- Solar Model Indicator
           ,      !- Beam Solar Day Schedule Name
           ,      !- Diffuse Solar Day Schedule Name
           ,      !- taub
           ,      !- taud
       0.00;      !- Clearness {0.0 to 1.1}
"""
COOLING = """
 SizingPeriod:DesignDay,
  Ort Ann Clg .4% Condns DB=>MWB,
  7, 21, SummerDesignDay, 31.5, 10.4, DefaultMultipliers, , Wetbulb, 20.5, , , , ,
  98000., 4.2, 90, No, No, No, ASHRAETau, , , 0.421, 2.172;
"""
OTHER = COOLING.replace(".4% Condns DB=>MWB", "1% Condns DB=>MWB").replace("31.5", "29.5")
LOCATION = " Site:Location,\n  Ort Design_Conditions,\n  48.10, 11.70, 1.00, 520.00;\n"


def beside(folder: Path, ddy: str, *, name: str = "Ort.ddy") -> tuple[Path, Header]:
    """Denver's weather under another name, with a DDY."""
    epw = folder / "Ort.epw"
    epw.symlink_to(DENVER)
    (folder / name).write_bytes(ddy.replace("\n", "\r\n").encode("latin-1"))
    return epw, read_header(epw)


def outdoors(folder: Path, where: Site, **more: Any) -> Outdoors:
    """Return EnergyPlus's outdoor values in the design days of `where`."""
    names = [DRY_BULB, "Site Outdoor Air Wetbulb Temperature", "Site Outdoor Air Barometric Pressure"]
    names += ["Site Wind Speed", "Site Wind Direction", "Site Direct Solar Radiation Rate per Area"]
    objects = {"Site:Location": where.location, "SizingPeriod:DesignDay": where.design_days}
    return run(folder, DENVER, None, None, variables=names, **objects, **more)


@pytest.mark.parametrize("name", ["Ort.ddy", "Ort.DDY"])
def test_design_days__ddy_beside_a_weather_file_states_place_and_days(folder: Path, name: str) -> None:
    design = site(*beside(folder, LOCATION + HEATING + OTHER + COOLING, name=name))
    assert design.source == f"design days from {name}"
    assert design.location == {
        "Ort Design_Conditions": {"latitude": 48.1, "longitude": 11.7, "time_zone": 1.0, "elevation": 520.0}
    }
    assert list(design.design_days) == ["Ort Ann Htg 99.6% Condns DB", "Ort Ann Clg .4% Condns DB=>MWB"]
    heating, cooling = design.design_days.values()
    assert (heating["month"], heating["day_of_month"], heating["day_type"]) == (1, 21, "WinterDesignDay")
    assert (heating["maximum_dry_bulb_temperature"], heating["wind_speed"], heating["wind_direction"]) == (
        -11.5,
        3.1,
        250,
    )
    assert heating["sky_clearness"] == 0.0
    assert (cooling["maximum_dry_bulb_temperature"], cooling["daily_dry_bulb_temperature_range"]) == (31.5, 10.4)
    assert cooling["ashrae_clear_sky_optical_depth_for_beam_irradiance_taub_"] == 0.421
    assert cooling["ashrae_clear_sky_optical_depth_for_diffuse_irradiance_taud_"] == 2.172
    ran = outdoors(folder / "run", design)
    assert ran.code == 0
    assert "** Severe  **" not in ran.errors
    assert "** Warning **" not in ran.errors
    summer, winter = ran.values  # by name
    assert np.allclose(winter[:, 0], -11.5)
    assert summer[:, 0].max() == pytest.approx(31.5)
    assert summer[:, 0].min() == pytest.approx(31.5 - 10.4)
    assert np.allclose(summer[:, 2], 98_000.0)


@pytest.mark.parametrize(
    "ddy",
    [LOCATION + HEATING, LOCATION + COOLING, HEATING + COOLING, LOCATION + HEATING + OTHER, "", "no objects at all\n"],
)
def test_design_days__ddy_that_lacks_something_is_not_taken_and_the_source_is_reported(folder: Path, ddy: str) -> None:
    design = site(*beside(folder, ddy))
    assert design.source.startswith("design days from the header of Ort.epw (Ort.ddy lacks")
    assert [d["maximum_dry_bulb_temperature"] for d in design.design_days.values()] == [-17.9, 33.9]  # Denver's


def test_design_days__ddy_that_energyplus_cannot_convert_is_refused(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from zenostat.models.weather import design_days
    from zenostat.topics.errors import ModelError

    def refuse(*_: object, **__: object) -> None:
        raise ModelError("EnergyPlus could not convert it")

    monkeypatch.setenv("ZENOSTAT_CACHE", str(folder / "cache"))
    monkeypatch.setattr(design_days.energyplus, "call", refuse)
    with pytest.raises(InvalidConfig, match=r"Ort\.ddy cannot be read as design days: EnergyPlus could not"):
        site(*beside(folder, LOCATION + HEATING + COOLING))


def test_design_days__ddy_is_converted_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from zenostat.models.weather import design_days

    monkeypatch.setenv("ZENOSTAT_CACHE", str(folder / "cache"))
    epw, header = beside(folder, LOCATION + HEATING + COOLING)
    first = site(epw, header)
    monkeypatch.setattr(design_days.energyplus, "call", None)
    assert site(epw, header) == first


def test_design_days__without_a_ddy_the_header_states_them() -> None:
    design = site(DENVER, read_header(DENVER))
    assert design.source == f"design days from the header of {DENVER.name}"
    (place,) = design.location.values()
    assert place == {"latitude": 39.72, "longitude": -104.75, "time_zone": -7.0, "elevation": 1726.0}


def test_design_days__header_of_denver_states_what_the_model_of_denver_was_sized_for() -> None:
    # The wheel's models for Denver carry the design days of Denver's DDY; those of the header differ in the sky.
    own = read_building(find_building("office-small")).objects["SizingPeriod:DesignDay"]
    days = site(DENVER, read_header(DENVER)).design_days
    sky = {
        "solar_model_indicator",
        "sky_clearness",
        "ashrae_clear_sky_optical_depth_for_beam_irradiance_taub_",
        "ashrae_clear_sky_optical_depth_for_diffuse_irradiance_taud_",
    }
    for kind in ("Htg 99.6%", "Clg .4%"):
        (theirs,) = (day for name, day in own.items() if kind in name)
        (ours,) = (day for name, day in days.items() if kind in name)
        but = sky if kind == "Clg .4%" else set()
        assert {k: v for k, v in ours.items() if k not in but} == {k: v for k, v in theirs.items() if k not in but}


def test_design_days__header_without_design_conditions_leaves_the_models_own() -> None:
    design = site(BOULDER, read_header(BOULDER))
    assert design.design_days == {}
    assert design.source == f"{BOULDER.name} has no design conditions: the model's own design days are kept"
    (place,) = design.location.values()
    assert place["latitude"] == 40.13


@pytest.mark.parametrize(
    ("elevation_m", "pascal"),
    # ASHRAE Handbook of Fundamentals, chapter 1, table 1 (kPa): standard atmosphere.
    [(-500, 107_478), (0, 101_325), (500, 95_461), (1000, 89_875), (1500, 84_556), (3000, 70_108)],
)
def test_design_days__standard_pressure_is_that_of_the_table(elevation_m: float, pascal: float) -> None:
    assert standard_pressure(elevation_m) == pytest.approx(pascal, rel=2e-4)


SOUTH = DesignConditions(
    heating_month=7,
    heating_dry_bulb_c=6.0,
    heating_wind_m_s=2.3,
    heating_wind_deg=320.0,
    cooling_month=2,
    cooling_range_k=6.5,
    cooling_dry_bulb_c=32.8,
    cooling_wet_bulb_c=19.6,
    cooling_wind_m_s=6.4,
    cooling_wind_deg=30.0,
)


def test_design_days__energyplus_has_the_days_of_a_header(folder: Path) -> None:
    header = replace(read_header(DENVER), place="Sydney, AUS", latitude_deg=-33.95, elevation_m=3.0)
    days = from_header(header, SOUTH)
    ran = outdoors(folder, Site({"x": {"latitude": -33.95, "longitude": 151.18, "time_zone": 10}}, days))
    assert ran.code == 0
    assert "** Severe  **" not in ran.errors
    assert "** Warning **" not in ran.errors
    assert [[day[:2] for day in of] for of in ran.days] == [[(2, 21)], [(7, 21)]]
    summer, winter = ran.values  # by name
    pressure = 101_325 * (1 - 2.25577e-5 * 3.0) ** 5.2559
    tolerance = [0.05, 0.05, 0.5, 0.0, 0.0, 0.0]  # the pressure is written in whole Pa
    assert (np.abs(winter - [6.0, 6.0, pressure, 2.3, 320.0, 0.0]) <= tolerance).all()
    hottest = int(np.argmax(summer[:, 0]))
    assert (np.abs(summer[hottest, :5] - [32.8, 19.6, pressure, 6.4, 30.0]) <= tolerance[:5]).all()
    assert summer[:, 0].max() == pytest.approx(32.8)
    assert summer[:, 0].min() == pytest.approx(32.8 - 6.5)
    assert summer[:, 5].max() > 700  # a clear day


# A model gets them

MODEL = {
    "Building": {"b": {}},
    "Site:Location": {"there": {"latitude": 1.0}},
    "SizingPeriod:DesignDay": {"own": {"month": 1}},
    "RunPeriod": {"r": {"begin_month": 1}},
}
PLACE = {"here": {"latitude": 2.0}}
DAYS = {"cold": {"month": 2}, "hot": {"month": 8}}


def test_design_days__location_and_days_are_replaced_and_nothing_else() -> None:
    before = {kind: dict(items) for kind, items in MODEL.items()}
    assert apply(MODEL, Site(PLACE, DAYS, "")) == MODEL | {"Site:Location": PLACE, "SizingPeriod:DesignDay": DAYS}
    assert before == MODEL


def test_design_days__models_days_stay_where_there_are_no_others() -> None:
    assert apply(MODEL, Site(PLACE)) == MODEL | {"Site:Location": PLACE}


def test_design_days__model_without_design_days_gets_none() -> None:
    bare = {kind: items for kind, items in MODEL.items() if kind != "SizingPeriod:DesignDay"}
    assert apply(bare, Site(PLACE, DAYS)) == bare | {"Site:Location": PLACE}


@pytest.mark.parametrize(
    ("edits", "sites", "kinds"),
    [
        ({"site:location": {"*": {"latitude": 10.0}}}, [Site(PLACE)], ["Site:Location"]),
        ({"SizingPeriod:DesignDay": {"cold": {"month": 1}}}, [Site(PLACE, DAYS)], ["SizingPeriod:DesignDay"]),
        ({"SizingPeriod:DesignDay": {"cold": {"month": 1}}}, [Site(PLACE, DAYS), Site(PLACE)], []),
        ({"Site:Location": {"*": {"latitude": 10.0}}}, [None], []),
        ({"Site:Location": {"*": {"latitude": 10.0}}}, [], []),
        ({"SizingPeriod:DesignDay": {"*": None}, "Zone": {"*": {}}}, [Site(PLACE, DAYS)], []),
    ],
)
def test_check_edits__edits_of_what_is_replaced_are_refused(
    edits: dict[str, Any], sites: list[Site | None], kinds: list[str]
) -> None:
    if not kinds:
        check_edits(edits, sites)
        return
    with pytest.raises(InvalidConfig, match=rf"^edits: {kinds[0]} '.*' has no effect, .*`sizing: model` keeps"):
        check_edits(edits, sites)


@pytest.mark.slow
def test_design_days__real_building_is_sized_for_the_header(folder: Path) -> None:
    phoenix = find_weather("USA_AZ_Phoenix").path
    objects = for_episode(read_building(find_building("office-small")), Period(date(2017, 7, 1), date(2017, 7, 1), 4))
    (silent,) = objects["OutputControl:Files"].values()
    objects["OutputControl:Files"] = {"eio": silent | {"output_eio": "Yes"}}
    path = write(apply(objects, site(phoenix, read_header(phoenix))), folder)
    assert run_energyplus(path, phoenix, folder).returncode == 0
    assert severe_messages(folder) == []
    assert "DesignDay" not in (folder / "eplusout.err").read_text()
    sized = [line for line in (folder / "eplusout.eio").read_text().splitlines() if "Zone Sizing Information," in line]
    assert {line.split(",")[7].strip() for line in sized if not line.startswith("!")} == {
        "PHOENIX SKY HARBOR INTL AP AZ USA ANN HTG 99.6% CONDNS DB",
        "PHOENIX SKY HARBOR INTL AP AZ USA ANN CLG .4% CONDNS DB=>MWB",
    }
