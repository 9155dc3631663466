"""Conflicts over a scenario's actuators: found in small models, and true in EnergyPlus."""

import json
from pathlib import Path
from typing import Any

import pytest
from support.energyplus_alone import run_energyplus

from zenostat.models.building.conflicts import conflicts
from zenostat.models.building.edits import Edits, apply_edits
from zenostat.models.building.model import for_episode, read_building, write
from zenostat.models.catalog import find_building, find_weather
from zenostat.models.points.discovery import discover
from zenostat.models.points.selection import select_points
from zenostat.topics.messages import Actuator

ZONE, SCHEDULE = "Zone Temperature Control", "Schedule:Compact"
COOLING = Actuator(name="zone", component_type=ZONE, control_type="Cooling Setpoint", key="CORE_ZN", unit="degC")
HEATING = Actuator(name="heat", component_type=ZONE, control_type="Heating Setpoint", key="CORE_ZN", unit="degC")
COOLING_SCHEDULE = Actuator(
    name="plan", component_type=SCHEDULE, control_type="Schedule Value", key="CLGSETP_SCH", unit="degC"
)

MODEL: dict[str, dict[str, Any]] = {
    "Zone": {"Core_ZN": {}, "Attic": {}},
    "ZoneControl:Thermostat": {
        "t": {
            "zone_or_zonelist_name": "Core_ZN",
            "control_1_object_type": "ThermostatSetpoint:DualSetpoint",
            "control_1_name": "dual",
        }
    },
    "ThermostatSetpoint:DualSetpoint": {
        "Dual": {
            "heating_setpoint_temperature_schedule_name": "Htgsetp_Sch",
            "cooling_setpoint_temperature_schedule_name": "Clgsetp_Sch",
        },
        "idle": {"cooling_setpoint_temperature_schedule_name": "Spare_Sch"},
    },
}


def ems(
    component: str,
    control: str,
    key: str,
    *lines: str,
    point: str = "BeginTimestepBeforePredictor",
    more: Edits | None = None,
) -> Edits:
    """EMS with one actuator, and one program that is called at `point`."""
    return {
        "EnergyManagementSystem:Actuator": {
            "Rival": {
                "actuated_component_type": component,
                "actuated_component_control_type": control,
                "actuated_component_unique_name": key,
            }
        },
        "EnergyManagementSystem:Program": {"Prog": {"lines": [{"program_line": line} for line in lines]}},
        "EnergyManagementSystem:ProgramCallingManager": {
            "Mgr": {"energyplus_model_calling_point": point, "programs": [{"program_name": "Prog"}]}
        },
    } | (more or {})


SETS_ZONE = ems("zone temperature control", "COOLING setpoint", "Core_zn", "IF 1 > 0", " set rival = 28.0", "ENDIF")
UNSET_ZONE = ems(ZONE, "Cooling Setpoint", "Core_ZN", "SET other = 28.0")
SIZING_ZONE = ems(ZONE, "Cooling Setpoint", "Core_ZN", "SET Rival = 28.0", point="EndOfZoneSizing")
NULL_ZONE = ems(ZONE, "Cooling Setpoint", "Core_ZN", "SET Rival = Null")
SETS_SCHEDULE = ems(SCHEDULE, "Schedule Value", "CLGSETP_SCH", "SET Rival = 28.0")
WINS = "EMS program 'Prog' sets the same control through EnergyManagementSystem:Actuator 'Rival' and takes precedence"
GIVES_BACK = (
    "EnergyManagementSystem:Actuator 'Rival' is on the same control, but no program sets it during the run; "
    "EnergyPlus then returns the control to the building"
)
BY_ZONE = (
    "EMS program 'Prog' sets the cooling setpoint of zone 'Core_ZN' through EnergyManagementSystem:Actuator 'Rival', "
    "which takes precedence over schedule 'CLGSETP_SCH' there"
)

FIGHTS = {
    "no EMS": ({}, COOLING, ""),
    "a program on the same zone control": (SETS_ZONE, COOLING, WINS),
    "another control of the zone": (SETS_ZONE, HEATING, ""),
    "an actuator that is not set": (UNSET_ZONE, COOLING, GIVES_BACK),
    "an actuator that is set for sizing only": (SIZING_ZONE, COOLING, GIVES_BACK),
    "a program on the schedule below a zone control": (SETS_SCHEDULE, COOLING, ""),
    "a program on the same schedule": (SETS_SCHEDULE, COOLING_SCHEDULE, WINS),
    "a program on a zone above the schedule": (SETS_ZONE, COOLING_SCHEDULE, BY_ZONE),
    "an actuator of the zone that is not set": (UNSET_ZONE, COOLING_SCHEDULE, ""),
    "an actuator of the zone that is only released": (NULL_ZONE, COOLING_SCHEDULE, ""),
    "an actuator of the zone that is set for sizing only": (SIZING_ZONE, COOLING_SCHEDULE, ""),
}


def conflict_texts(edits: dict[str, Any], *actuators: Actuator) -> list[str]:
    return conflicts(MODEL | edits, actuators)


@pytest.mark.parametrize("case", FIGHTS)
def test_conflicts__name_the_actuator_and_its_rival(case: str) -> None:
    edits, actuator, text = FIGHTS[case]
    assert conflict_texts(edits, actuator) == ([f"actuator {actuator.name!r}: {text}"] if text else [])


_DRIVE = """
orders = json.loads(arguments[0])
exchange.request_variable(state, "Zone Thermostat Cooling Setpoint Temperature", "CORE_ZN")
seen = []

def order(at):
    for kind, control, key, value in orders:
        exchange.set_actuator_value(at, exchange.get_actuator_handle(at, kind, control, key), value)

def begin(at):
    if exchange.kind_of_sim(at) == 3:
        order(at)

def end(at):
    if exchange.kind_of_sim(at) == 3 and not exchange.warmup_flag(at):
        handle = exchange.get_variable_handle(at, "Zone Thermostat Cooling Setpoint Temperature", "CORE_ZN")
        seen.append(exchange.get_variable_value(at, handle))
        order(at)

runtime.callback_after_new_environment_warmup_complete(state, begin)
runtime.callback_end_zone_timestep_after_zone_reporting(state, end)
"""


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("case", [case for case, (_, actuator, _) in FIGHTS.items() if actuator is not HEATING])
def test_conflicts__it_is_so_in_energyplus(case: str, folder: Path) -> None:
    """A day of the small office on which the actuator is always set to 26.5 degC."""
    edits, actuator, text = FIGHTS[case]
    office = read_building(find_building("ref-small-office"))
    objects = apply_edits(for_episode(office, office.period("07-03", "07-03", None)), edits)
    orders = json.dumps([(actuator.component_type, actuator.control_type, actuator.key, 26.5)])
    inputs = write(objects, folder), find_weather("Denver").path, folder
    done = run_energyplus(*inputs, orders, before=_DRIVE, after="print(json.dumps(sorted(set(seen))))")
    assert done.returncode == 0, done.stderr
    setpoints = json.loads(done.stdout.splitlines()[-1])
    own = [24.0, 26.7]  # its schedule's on that day
    assert setpoints == pytest.approx({"": [26.5], WINS: [28.0], BY_ZONE: [28.0], GIVES_BACK: own}[text])
    assert bool(conflicts(objects, [actuator])) == bool(text)


# Programs


def test_conflicts__programs_that_nobody_calls_and_comments_set_nothing() -> None:
    quiet = ems(ZONE, "Cooling Setpoint", "Core_ZN", "! SET Rival = 28.0")
    assert GIVES_BACK in conflict_texts(quiet, COOLING)[0]
    idle = {**SETS_ZONE, "EnergyManagementSystem:ProgramCallingManager": {}}
    assert GIVES_BACK in conflict_texts(idle, COOLING)[0]


def test_conflicts__subroutine_that_is_run_is_named() -> None:
    sub = {"EnergyManagementSystem:Subroutine": {"Sub": {"lines": [{"program_line": "SET Rival = 28.0"}]}}}
    called = ems(ZONE, "Cooling Setpoint", "Core_ZN", "RUN sub", more=sub)  # type: ignore[arg-type]
    assert "EMS program 'Sub' sets the same control" in conflict_texts(called, COOLING)[0]


def test_conflicts__report_a_program_that_also_reads_the_schedule() -> None:
    sensor = {
        "Seen": {
            "output_variable_or_output_meter_name": "Schedule Value",
            "output_variable_or_output_meter_index_key_name": "clgsetp_sch",
        }
    }
    edits = ems(
        SCHEDULE, "Schedule Value", "CLGSETP_SCH", "SET Rival = Seen + 1",
        more={"EnergyManagementSystem:Sensor": sensor},  # type: ignore[dict-item]
    )  # fmt: skip
    (line,) = conflict_texts(edits, COOLING_SCHEDULE)
    assert line.endswith("'Rival' (program 'Prog' also reads it) and takes precedence")


# Schedules


def schedule(key: str) -> Actuator:
    return COOLING_SCHEDULE.model_copy(update={"key": key})


def test_conflicts__report_a_schedule_that_nothing_uses() -> None:
    assert conflict_texts({}, schedule("SPARE_SCH")) == [
        "actuator 'plan': nothing in the model uses schedule 'SPARE_SCH'"
    ]
    assert conflict_texts({"Lights": {"l": {"schedule_name": "Spare_Sch"}}}, schedule("SPARE_SCH")) == []
    assert len(conflict_texts({"Output:Variable": {"o": {"key_value": "Spare_Sch"}}}, schedule("SPARE_SCH"))) == 1


def test_conflicts__use_within_a_list_is_a_use() -> None:
    edits = {"X": {"x": {"entries": [{"schedule_name": "Spare_Sch"}]}}}
    assert conflict_texts(edits, schedule("SPARE_SCH")) == []


def test_conflicts__report_a_schedule_for_sizing_only() -> None:
    sizing = {"Sizing:Zone": {"s": {"some_schedule_name": "Spare_Sch"}}}
    assert conflict_texts(sizing, schedule("SPARE_SCH")) == [
        "actuator 'plan': schedule 'SPARE_SCH' is used for sizing only (Sizing:Zone)"
    ]


def test_conflicts__report_a_schedule_that_only_ems_reads() -> None:
    model = read_building(find_building("office-small"))
    assert conflicts(model.objects, [schedule("BINARY OCCUPANCY")])[0].startswith(
        "actuator 'plan': no object uses schedule 'BINARY OCCUPANCY'; only EMS program"
    )


def test_conflicts__optimum_start_programs_win_over_their_schedules() -> None:
    model = read_building(find_building("office-medium"))
    (line,) = conflicts(model.objects, [schedule("CLGSETP_SCH_YES_OPTIMUM")])
    assert line.endswith(
        "sets the same control through EnergyManagementSystem:Actuator 'CLGSETP_SCH_Actuator' and takes precedence"
    )


# Thermostats


def test_conflicts__report_a_thermostat_without_that_setpoint() -> None:
    model = {
        **MODEL,
        "ZoneControl:Thermostat": {
            "t": {
                "zone_or_zonelist_name": "both",
                "control_1_object_type": "ThermostatSetpoint:SingleHeating",
                "control_1_name": "warm",
            }
        },
        "ThermostatSetpoint:SingleHeating": {"warm": {"setpoint_temperature_schedule_name": "Htgsetp_Sch"}},
        "ZoneList": {"Both": {"zones": [{"zone_name": "Core_ZN"}, {"zone_name": "Attic"}]}},
    }
    assert conflicts(model, [HEATING, COOLING]) == [
        "actuator 'zone': the thermostat of zone 'Core_ZN' has only a heating setpoint"
    ]


@pytest.mark.parametrize(("building", "idle"), [("office-medium", 0), ("hotel-small", 9), ("warehouse", 1)])
def test_conflicts__default_actuators_of_bundled_models_rule_but_for_zones_without_cooling(
    building: str, idle: int
) -> None:
    model = read_building(find_building(building))
    points = select_points(model, discover(model, find_weather("Denver").path), {}, {}, None)
    lines = conflicts(model.objects, points.actuators)
    assert len(lines) == idle
    assert all(line.endswith("has only a heating setpoint") for line in lines)


# IT equipment, plugins, external interfaces


def servers(method: str, outlet: str = "Rack In") -> dict[str, Any]:
    return {
        "ElectricEquipment:ITE:AirCooled": {
            "Rack": {
                "zone_or_space_name": "core_zn",
                "air_flow_calculation_method": method,
                "supply_air_node_name": outlet,
            }
        },
        "AirTerminal:SingleDuct:VAV:NoReheat": {"Box": {"air_outlet_node_name": "rack in"}},
    }


def test_conflicts__it_equipment_under_approach_temperatures_takes_the_cooling_setpoint_away() -> None:
    approach = servers("FlowControlWithApproachTemperatures")
    text = (
        "the cooling setpoint of zone 'Core_ZN' has no effect: ElectricEquipment:ITE:AirCooled 'Rack' uses "
        "FlowControlWithApproachTemperatures, which determines the supply air temperature"
    )
    assert conflict_texts(approach, COOLING, COOLING_SCHEDULE) == [
        f"actuator 'zone': {text}",
        f"actuator 'plan': {text}",
    ]
    assert conflict_texts(approach, HEATING) == []
    assert conflict_texts(servers("FlowFromSystem"), COOLING) == []
    assert conflict_texts(servers("FlowControlWithApproachTemperatures", "Elsewhere"), COOLING) == []


def test_conflicts__plugins_and_external_interfaces_may_fight() -> None:
    plugin = {"PythonPlugin:Instance": {"P": {"python_module_name": "mine", "plugin_class_name": "Ruler"}}}
    assert conflict_texts(plugin, COOLING, HEATING) == [
        "actuators 'zone', 'heat': PythonPlugin:Instance 'P' runs mine.Ruler, which may set the same controls"
    ]
    outer = {"ExternalInterface:Actuator": SETS_ZONE["EnergyManagementSystem:Actuator"]}
    assert conflict_texts(outer, COOLING, HEATING) == [
        "actuator 'zone': ExternalInterface:Actuator 'Rival' is on the same control and may take precedence"
    ]
    assert conflict_texts(plugin) == []
