"""HVACTemplate objects: expanded by ExpandObjects, simulated, and refused with EnergyPlus's own reasons."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.variable_runs import run

from zenostat.models import energyplus
from zenostat.models.building import templates
from zenostat.models.building.diagnostics import Severity, cached_diagnostics
from zenostat.models.building.model import Building, check_runnable, read_building, with_edits
from zenostat.models.building.template_references import templates_of
from zenostat.models.catalog import find_building
from zenostat.models.input_format.idf_writer import write_idf
from zenostat.models.input_format.layout import engine_layout
from zenostat.topics.errors import InvalidConfig

ZONES = ("Core_ZN", "Perimeter_ZN_1", "Perimeter_ZN_2", "Perimeter_ZN_3", "Perimeter_ZN_4")
HEATING_C, COOLING_C = 20.0, 25.0
ENVELOPE = (
    *("Building", "Construction", "ElectricEquipment", "FenestrationSurface", "GlobalGeometryRules", "InternalMass"),
    *("HeatBalance", "Lights", "Material", "People", "RunPeriod", "Schedule", "ShadowCalculation", "SimulationControl"),
    *("Site:", "Sizing:Parameters", "SizingPeriod", "SurfaceConvection", "Timestep", "Version", "WindowMaterial"),
    *("ZoneAirHeatBalance", "ZoneInfiltration"),
)

Objects = dict[str, dict[str, Any]]

THERMOSTAT: Objects = {
    "HVACTemplate:Thermostat": {"all": {"constant_heating_setpoint": HEATING_C, "constant_cooling_setpoint": COOLING_C}}
}
HOT_WATER: Objects = {
    "HVACTemplate:Plant:HotWaterLoop": {"hot water": {}},
    "HVACTemplate:Plant:Boiler": {
        "boiler": {"boiler_type": "HotWaterBoiler", "efficiency": 0.8, "fuel_type": "NaturalGas"}
    },
}
CHILLED_WATER: Objects = {
    "HVACTemplate:Plant:ChilledWaterLoop": {"chilled water": {}},
    "HVACTemplate:Plant:Chiller": {"chiller": {"chiller_type": "ElectricReciprocatingChiller", "nominal_cop": 3.2}},
    "HVACTemplate:Plant:Tower": {"tower": {"tower_type": "SingleSpeed"}},
}
MIXED_WATER: Objects = {
    "HVACTemplate:Plant:MixedWaterLoop": {"mixed water": {}},
    "HVACTemplate:Plant:Boiler": HOT_WATER["HVACTemplate:Plant:Boiler"],
    "HVACTemplate:Plant:Tower": CHILLED_WATER["HVACTemplate:Plant:Tower"],
}


def zone_templates(kind: str, **fields: Any) -> Objects:
    """A template of a type for each zone; a field `{zone}` in a text stands for the zone's name."""
    common = {"template_thermostat_name": "all"} | fields
    return {
        f"HVACTemplate:Zone:{kind}": {
            f"{kind} {zone}": {"zone_name": zone}
            | {k: v.format(zone=zone) if isinstance(v, str) else v for k, v in common.items()}
            for zone in ZONES
        }
    }


def systems_per_zone(kind: str, **fields: Any) -> Objects:
    """A system of a type for each zone."""
    return {
        f"HVACTemplate:System:{kind}": {
            f"system {zone}": {"control_zone_or_thermostat_location_name": zone, **fields} for zone in ZONES
        }
    }


SYSTEMS: dict[str, Objects] = {
    "ideal loads": zone_templates("IdealLoadsAirSystem"),
    "hot-water baseboard": zone_templates(
        "BaseboardHeat", zone_heating_sizing_factor=1.2, baseboard_heating_type="HotWater"
    )
    | HOT_WATER,
    "VAV": zone_templates("VAV", template_vav_system_name="vav", reheat_coil_type="HotWater")
    | {"HVACTemplate:System:VAV": {"vav": {"heating_coil_type": "HotWater"}}}
    | HOT_WATER
    | CHILLED_WATER,
    "unitary": zone_templates("Unitary", template_unitary_system_name="system {zone}")
    | systems_per_zone("Unitary", heating_coil_type="Gas"),
    "PTAC": zone_templates("PTAC"),
    "PTHP": zone_templates("PTHP"),
    "fan coil": zone_templates("FanCoil") | HOT_WATER | CHILLED_WATER,
    "packaged VAV": zone_templates("VAV", template_vav_system_name="vav", reheat_coil_type="Electric")
    | {"HVACTemplate:System:PackagedVAV": {"vav": {"heating_coil_type": "Gas"}}},
    "fan-powered VAV": zone_templates("VAV:FanPowered", template_vav_system_name="vav", reheat_coil_type="Electric")
    | {"HVACTemplate:System:PackagedVAV": {"vav": {}}},
    "VAV with heating and cooling": zone_templates(
        "VAV:HeatAndCool", template_vav_system_name="vav", reheat_coil_type="HotWater"
    )
    | {"HVACTemplate:System:VAV": {"vav": {"heating_coil_type": "HotWater"}}}
    | HOT_WATER
    | CHILLED_WATER,
    "heat pump": zone_templates("Unitary", template_unitary_system_name="system {zone}")
    | systems_per_zone("UnitaryHeatPump:AirToAir"),
    "unitary system": zone_templates("Unitary", template_unitary_system_name="system {zone}")
    | systems_per_zone(
        "UnitarySystem",
        cooling_coil_type="SingleSpeedDX",
        heating_coil_type="Gas",
        heating_design_supply_air_temperature=50.0,
    ),
    "constant volume": zone_templates(
        "ConstantVolume", template_constant_volume_system_name="cv", reheat_coil_type="HotWater"
    )
    | {"HVACTemplate:System:ConstantVolume": {"cv": {}}}
    | HOT_WATER
    | CHILLED_WATER,
    "dual duct": zone_templates("DualDuct", template_dual_duct_system_name="dual")
    | {"HVACTemplate:System:DualDuct": {"dual": {}}}
    | HOT_WATER
    | CHILLED_WATER,
    "VRF": zone_templates("VRF", template_vrf_system_name="vrf")
    | {"HVACTemplate:System:VRF": {"vrf": {"master_thermostat_priority_control_type": "ThermostatOffsetPriority"}}},
    "water-to-air heat pump": zone_templates("WaterToAirHeatPump") | MIXED_WATER,
    "dedicated outdoor air": zone_templates("FanCoil", dedicated_outdoor_air_system_name="doas")
    | {"HVACTemplate:System:DedicatedOutdoorAir": {"doas": {}}}
    | HOT_WATER
    | CHILLED_WATER,
}
MILD = {"VRF": "03-15", "VAV with heating and cooling": "03-15"}
"""Days for systems whose capacity does not suffice in January."""

QUICK = ("hot-water baseboard",)


@cache
def envelope() -> Objects:
    """A small office without its systems, sized for its own design days."""
    office = read_building(find_building("ref-small-office")).objects
    kept = {kind: items for kind, items in office.items() if kind.startswith(ENVELOPE) or kind == "Zone"}
    control = {"do_zone_sizing_calculation": "Yes", "do_system_sizing_calculation": "Yes"}
    return kept | {"SimulationControl": {"SimulationControl 1": control | {"do_plant_sizing_calculation": "Yes"}}}


def office_with(system: Mapping[str, Mapping[str, Any]], path: Path) -> Building:
    """Write the envelope with templates as an IDF or epJSON, by the path's suffix, and read it as a node does."""
    objects = envelope() | THERMOSTAT | system
    is_idf = path.suffix == ".idf"
    path.write_text(write_idf(objects, engine_layout()) if is_idf else json.dumps(objects))
    building = read_building(find_building(str(path)))
    check_runnable(building)
    return building


def temperatures(building: Building, folder: Path, day: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    points = [("Zone Mean Air Temperature", zone) for zone in ZONES]
    return run(building, points, folder / day, begin=day, end=day)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in QUICK else pytest.mark.slow) for name in SYSTEMS]
)
def test_templates__expanded_systems_keep_the_setpoints(name: str, tmp_path: Path) -> None:
    building = office_with(SYSTEMS[name], tmp_path / "office.idf")
    assert not templates_of(building.objects)
    winter = temperatures(building, tmp_path, MILD.get(name, "01-15"))
    assert np.all(winter > HEATING_C - 0.6), winter.min(axis=0)
    if name != "hot-water baseboard":
        summer = temperatures(building, tmp_path, "07-15")
        assert np.all(summer < COOLING_C + 0.6), summer.max(axis=0)
        assert name == "constant volume" or np.any(summer > COOLING_C - 0.6)  # that one reheats all day


@pytest.mark.parametrize("name", [*QUICK[:1], pytest.param("VAV", marks=pytest.mark.slow)])
def test_templates__idf_and_epjson_expand_alike(name: str, tmp_path: Path) -> None:
    from_idf = office_with(SYSTEMS[name], tmp_path / "office.idf")
    from_epjson = office_with(SYSTEMS[name], tmp_path / "office.epJSON")
    for kind in from_idf.objects.keys() | from_epjson.objects.keys():
        assert from_idf.objects[kind] == from_epjson.objects[kind], kind


def test_templates__note_tells_how_many_objects_were_made(tmp_path: Path) -> None:
    building = office_with(SYSTEMS["ideal loads"], tmp_path / "office.idf")
    added = sum(map(len, building.objects.values())) - sum(map(len, envelope().values()))
    assert building.notes == (f"6 HVACTemplate objects expanded to {added} objects by ExpandObjects",)


def test_templates__edits_of_templates_give_the_model_with_these_templates(tmp_path: Path) -> None:
    """Other edits are those of the expanded objects."""
    system, (kind, items) = SYSTEMS["ideal loads"], next(iter(SYSTEMS["ideal loads"].items()))
    plain = office_with(system, tmp_path / "office.epJSON")
    warm: Objects = {
        "HVACTemplate:Thermostat": {"warm": {"constant_heating_setpoint": 23.0, "constant_cooling_setpoint": 26.0}}
    }
    name = f"IdealLoadsAirSystem {ZONES[0]}"
    changed = {kind: items | {name: items[name] | {"template_thermostat_name": "warm"}}}
    thermostats = {"HVACTemplate:Thermostat": THERMOSTAT["HVACTemplate:Thermostat"] | warm["HVACTemplate:Thermostat"]}
    by_hand = office_with(thermostats | changed, tmp_path / "other.epJSON")
    edits = {kind.upper(): {name.upper(): {"template_thermostat_name": "warm"}}} | warm
    edited = with_edits(plain, edits)
    assert edited.objects == by_hand.objects
    assert (edited.notes, edited.unexpanded) == (by_hand.notes, by_hand.unexpanded)
    ideal, supply = f"{ZONES[0]} Ideal Loads Air System", {"maximum_heating_supply_air_temperature": 30.0}
    both = with_edits(plain, edits | {"ZoneHVAC:IdealLoadsAirSystem": {ideal: supply}})
    assert both.find("ZoneHVAC:IdealLoadsAirSystem", ideal).items() >= supply.items()


def test_templates__edits_add_and_remove_templates(tmp_path: Path) -> None:
    system, kind = SYSTEMS["ideal loads"], "HVACTemplate:Zone:IdealLoadsAirSystem"
    plain = office_with(system, tmp_path / "office.epJSON")
    path = tmp_path / "empty.epJSON"
    path.write_text(json.dumps(envelope()))
    empty = read_building(find_building(str(path)))
    assert with_edits(empty, THERMOSTAT | system).objects == plain.objects
    removed = with_edits(plain, {kind: {"*": None}, "HVACTemplate:Thermostat": {"*": None}})
    assert (removed.objects, removed.notes) == (empty.objects, ())
    with pytest.raises(InvalidConfig, match=f"{kind} 'all': the model has no such object"):
        with_edits(plain, {kind: {"all": None}})
    with pytest.raises(InvalidConfig, match=f"{kind} .*: template_thermostat_name"):
        check_runnable(with_edits(plain, {"HVACTemplate:Thermostat": {"all": None}}))


def test_templates__names_keep_their_characters() -> None:
    objects = THERMOSTAT | zone_templates("IdealLoadsAirSystem")
    names = dict(zip(ZONES, ("Büro", "Voilà", "Ålesund", "会议室", "цех"), strict=True))
    text = json.dumps(objects | {"Zone": {zone: {} for zone in ZONES}})
    for zone, name in names.items():
        text = text.replace(zone, name)
    expanded, _ = templates.expand(json.loads(text), file="office.epJSON")
    assert {each["zone_name"] for each in expanded["ZoneHVAC:EquipmentConnections"].values()} == {*names.values()}


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("Zone, one", "zone_name is 'Zone, one', which an IDF cannot have: it contains a separator of fields"),
        ("x" * 101, f"Zone '{'x' * 101}' has 101 or more characters; use shorter names"),
    ],
    ids=["comma", "long"],
)
def test_templates__name_that_expand_objects_cannot_read_is_refused_with_the_file(name: str, reason: str) -> None:
    """An epJSON without templates may have such names: EnergyPlus simulates it."""
    model = THERMOSTAT | zone_templates("IdealLoadsAirSystem") | {"Zone": {zone: {} for zone in ZONES}}
    objects = json.loads(json.dumps(model).replace("Core_ZN", name))
    with pytest.raises(InvalidConfig) as raised:
        templates.expand(objects, file="office.epJSON")
    assert str(raised.value).startswith("office.epJSON: its HVACTemplate objects cannot be expanded:")
    assert reason in str(raised.value)


def test_templates__model_without_templates_is_the_same_object() -> None:
    objects = envelope()
    assert templates.expand(objects, file="office.idf") == (objects, ())


def test_templates__field_that_the_schema_rejects_is_named(tmp_path: Path) -> None:
    with pytest.raises(
        InvalidConfig, match=r"line 1: .* outdoor_air_method is 'Nothing'; expected one of 'DetailedSpecification'"
    ):
        office_with(zone_templates("IdealLoadsAirSystem", outdoor_air_method="Nothing"), tmp_path / "office.epJSON")


def mistyped_office(path: Path, change: Callable[[str], str]) -> str:
    """Write the envelope with ideal loads as an IDF, change its text, and return the error of reading it."""
    objects = envelope() | THERMOSTAT | SYSTEMS["ideal loads"]
    path.write_text(change(write_idf(objects, engine_layout())))
    with pytest.raises(InvalidConfig) as raised:
        check_runnable(read_building(find_building(str(path))))
    return str(raised.value)


REFERENCES = {
    "ideal loads": (
        ("Zone:IdealLoadsAirSystem", "template_thermostat_name", "al"),
        "the model has no HVACTemplate:Thermostat of that name; did you mean 'all'?",
    ),
    "VAV": (
        ("Zone:VAV", "template_vav_system_name", "va"),
        "the model has no HVACTemplate:System of VAV of that name; did you mean 'vav'?",
    ),
    "PTAC": (("Zone:PTAC", "zone_name", "Coree_ZN"), "the model has no zone of that name; did you mean 'Core_ZN'?"),
    "fan coil": (
        ("Plant:HotWaterLoop", "hot_water_setpoint_schedule_name", "Nowhere"),
        "the model has no schedule of that name; ",
    ),
}


def mistyped_template(system: str, path: Path) -> tuple[str, str]:
    """The error of an IDF of which the first template of a type has another value in a field, and what it should be."""
    (kind, field, value), reason = REFERENCES[system]
    kind, changed = f"HVACTemplate:{kind}", copy.deepcopy(SYSTEMS[system])
    next(iter(changed[kind].values()))[field] = value
    path.write_text(write_idf(envelope() | THERMOSTAT | changed, engine_layout()))
    with pytest.raises(InvalidConfig) as raised:
        check_runnable(read_building(find_building(str(path))))
    line = next(
        i for i, text in enumerate(path.read_text().splitlines(), 1) if text.startswith((f"  {value},", f"  {value};"))
    )
    name = "hot water" if kind.endswith("Loop") else f"{kind} 1"
    return str(raised.value), f"  line {line}: {kind} {name!r}: {field} is {value!r}, but {reason}"


@pytest.mark.parametrize("system", REFERENCES)
def test_templates__missing_object_is_named_with_the_line_of_the_template(system: str, tmp_path: Path) -> None:
    error, expected = mistyped_template(system, tmp_path / "office.idf")
    head, first, *rest = error.splitlines()
    assert head == f"{tmp_path / 'office.idf'} is not a valid model for EnergyPlus {energyplus.version()}:"
    assert first.startswith(expected)
    reason = "  Could not find air handler name referenced in HVACTemplate:Zone:VAV object: Core_ZN"
    assert rest == ([reason] if system == "VAV" else [])  # that of ExpandObjects, and not what follows in the result


@pytest.mark.parametrize("suffix", [".idf", ".epJSON"])
def test_templates__missing_object_of_an_optional_field_is_a_warning_about_the_template(
    suffix: str, tmp_path: Path
) -> None:
    system = zone_templates("IdealLoadsAirSystem", heating_availability_schedule_name="Nowhere")
    path = tmp_path / f"office{suffix}"
    diagnostics = cached_diagnostics(office_with(system, path))
    lines = path.read_text().splitlines() if suffix == ".idf" else []
    expected = [i for i, text in enumerate(lines, 1) if text.startswith("  Nowhere")]
    named = [each for each in diagnostics if "'Nowhere'" in each.text]
    assert [each.kind for each in named] == ["HVACTemplate:Zone:IdealLoadsAirSystem"] * len(ZONES)
    assert {each.severity for each in named} == {Severity.WARNING}
    assert not lines or [each.line for each in named] == expected


def test_templates__own_object_with_the_same_missing_name_is_named_as_well(tmp_path: Path) -> None:
    objects = envelope() | SYSTEMS["ideal loads"]
    setpoints = {"heating_setpoint_schedule_name": "Nowhere", "constant_cooling_setpoint": COOLING_C}
    lights = next(iter(objects["Lights"]))
    changed = objects["Lights"] | {lights: objects["Lights"][lights] | {"schedule_name": "Nowhere"}}
    path = tmp_path / "office.epJSON"
    path.write_text(json.dumps(objects | {"HVACTemplate:Thermostat": {"all": setpoints}, "Lights": changed}))
    with pytest.raises(InvalidConfig) as raised:
        check_runnable(read_building(find_building(str(path))))
    first, second = sorted(str(raised.value).splitlines()[1:])
    assert "HVACTemplate:Thermostat 'all': heating_setpoint_schedule_name is 'Nowhere'" in first
    assert f"Lights {lights!r}: schedule_name is 'Nowhere'" in second


def test_templates__dangling_reference_is_named_with_the_line_of_the_users_file(tmp_path: Path) -> None:
    path = tmp_path / "office.idf"
    name = next(iter(envelope()["Lights"]))
    schedule = envelope()["Lights"][name]["schedule_name"]
    error = mistyped_office(path, lambda text: re.sub(rf"(\nLights,(?s:.)*?{schedule}),", r"\1_TYPO,", text, count=1))
    line = 1 + next(i for i, text in enumerate(path.read_text().splitlines()) if f"{schedule}_TYPO," in text)
    assert error.startswith(f"{path} is not a valid model for EnergyPlus")
    assert f"line {line}: Lights {name!r}: schedule_name is '{schedule}_TYPO', but the model has no schedule" in error


def test_templates__missing_comma_is_named_with_the_line_of_the_users_file(tmp_path: Path) -> None:
    path = tmp_path / "office.idf"
    error = mistyped_office(path, lambda text: re.sub(r"(IdealLoadsAirSystem,\n  Core_ZN),", r"\1", text, count=1))
    line = 2 + next(i for i, text in enumerate(path.read_text().splitlines()) if "IdealLoadsAirSystem," in text)
    assert f"line {line}: HVACTemplate:Zone:IdealLoadsAirSystem " in error
    assert "',' or ';' is missing within 'Core_ZN all'" in error
