"""Sensors of the systems of a model: what a schematic shows."""

from zenostat.models.building.model import read_building
from zenostat.models.catalog import find_building
from zenostat.models.points.discovery import PointCatalog, Variable
from zenostat.models.points.system_sensors import system_sensors


def state(name: str, key: str, unit: str) -> Variable:
    return Variable(name, key, unit, system=True, summed=False)


def test_system_sensors__are_those_at_outlets_and_powers_that_the_model_has() -> None:
    building = read_building(find_building("ref-medium-office"))
    outlet = building.objects["Fan:SystemModel"]["VAV_1_Fan"]["air_outlet_node_name"]
    available = PointCatalog(
        variables=(
            state("System Node Temperature", outlet.upper(), "degC"),
            state("System Node Setpoint Temperature", outlet.upper(), "degC"),
            state("System Node Temperature", "A ZONE'S NODE", "degC"),
            state("Fan Electricity Rate", "VAV_1_FAN", "W"),
            state("Fan Rise in Air Temperature", "VAV_1_FAN", "delta_degC"),
            state("Cooling Coil Total Cooling Rate", "VAV_1_COOLC DXCOIL", "W"),
            state("Cooling Coil Sensible Cooling Rate", "VAV_1_COOLC DXCOIL", "W"),
            state("Cooling Coil Crankcase Heater Electricity Rate", "VAV_1_COOLC DXCOIL", "W"),
        ),
        meters=(),
        actuators=(),
    )
    assert {name: variable for name, (variable, _) in system_sensors(building, available).items()} == {
        "vav_1_fan_air_outlet_temperature": "System Node Temperature",
        "vav_1_fan_air_outlet_setpoint": "System Node Setpoint Temperature",
        "vav_1_fan_fan_electricity_rate": "Fan Electricity Rate",
        "vav_1_coolc_dxcoil_cooling_coil_total_cooling_rate": "Cooling Coil Total Cooling Rate",
    }
