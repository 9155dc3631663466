"""EnergyPlus's names of the points that Zenostat treats specially.

EnergyPlus ignores case; where a name comes from a model, compare it case-folded.
"""

from __future__ import annotations

THERMOSTAT = "Zone Temperature Control"
"""Component type of the actuators of a zone's thermostat."""

HEATING_SETPOINT = "Heating Setpoint"
COOLING_SETPOINT = "Cooling Setpoint"
"""Control types of a zone's thermostat."""

SCHEDULE_VALUE = "Schedule Value"
"""Control type of a schedule, and the output variable that reports its value."""

HEATING_SETPOINT_VARIABLE = "Zone Thermostat Heating Setpoint Temperature"
COOLING_SETPOINT_VARIABLE = "Zone Thermostat Cooling Setpoint Temperature"
"""Output variables that report a thermostat's effective setpoints."""

HVAC_POWER = "Facility Total HVAC Electricity Demand Rate"
"""Output variable of an electric power in W, with the key `Whole Building`.

EnergyPlus adds up the meters `Electricity:HVAC` and `Electricity:Plant`: with chillers and pumps, and with electric
water heaters. `HVAC_METERS` count the HVAC alone.
"""

ZONE_TEMPERATURE = "Zone Air Temperature"
OCCUPANTS = "Zone People Occupant Count"
"""Output variables of a zone."""

ZONE_TEMPERATURES = ("zone air temperature", "zone mean air temperature")
"""Output variables that report a zone's air temperature, case-folded."""

FUELS = (
    "Electricity",
    "NaturalGas",
    "DistrictCooling",
    "DistrictHeatingWater",
    "DistrictHeatingSteam",
    "Propane",
    "FuelOilNo1",
    "FuelOilNo2",
    "Gasoline",
    "Diesel",
    "Coal",
    "OtherFuel1",
    "OtherFuel2",
)
"""Resources whose meters count consumption, as in `Electricity:Facility`."""

FACILITY_POWER = "Facility Total Electricity Demand Rate"
"""Output variable of the whole building's electric power in W, with the key `Whole Building`."""

UNMET_HEATING = "Facility Heating Setpoint Not Met While Occupied Time"
UNMET_COOLING = "Facility Cooling Setpoint Not Met While Occupied Time"
"""Output variables of the hours in which any occupied zone misses its setpoint, with the key `Facility`."""

OUTDOOR_TEMPERATURE = "Site Outdoor Air Drybulb Temperature"
"""Output variable of the outdoor air, with the key `Environment`."""

ZONE_HUMIDITY = "Zone Air Relative Humidity"

END_USES = (
    "Heating",
    "Cooling",
    "Fans",
    "Pumps",
    "HeatRejection",
    "Humidifier",
    "HeatRecovery",
    "InteriorLights",
    "ExteriorLights",
    "InteriorEquipment",
    "ExteriorEquipment",
    "WaterSystems",
    "Refrigeration",
    "Cogeneration",
)
"""End uses as in the meters `Cooling:Electricity`, those of HVAC first."""

HVAC_END_USES = END_USES[:7]
"""End uses of heating, cooling and ventilation."""

COMPUTED_ON_REQUEST = frozenset(
    {
        "system node dewpoint temperature",
        "system node relative humidity",
        "system node specific heat",
        "system node wetbulb temperature",
        "space wetbulb globe temperature",
        "zone wetbulb globe temperature",
        "facility any zone oscillating temperatures during occupancy time",
        "facility any zone oscillating temperatures in deadband time",
        "facility any zone oscillating temperatures time",
        "zone oscillating temperatures during occupancy time",
        "zone oscillating temperatures in deadband time",
        "zone oscillating temperatures time",
    }
)
"""Output variables that stay 0 unless an `Output:Variable` object requests them, case-folded.

A request by EnergyPlus's API does not suffice in 25.2.
"""

HVAC_METERS = {f"HVAC:{fuel}": tuple(f"{use}:{fuel}" for use in HVAC_END_USES) for fuel in FUELS}
"""Meters that Zenostat adds to those of EnergyPlus, with the meters of EnergyPlus whose sum they are.

EnergyPlus's own `Electricity:HVAC` leaves out plant loops (chillers, boilers, cooling towers, their pumps), and
`NaturalGas:Facility` has kitchens and hot water; these are the rows of its end-use table.
"""

GENERATION_METERS = (
    "ElectricityProduced:Facility",
    "ElectricityPurchased:Facility",
    "ElectricitySurplusSold:Facility",
    "ElectricityNet:Facility",
)
"""What a building with generators produces, buys, sells, and buys less what it sells. EnergyPlus has the first one for
models with generators alone."""
