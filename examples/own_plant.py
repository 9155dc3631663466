"""Your own plant: a room with a heat pump and a buffer tank. The file needs nothing of Zenostat.

    zenostat node --plant examples/own_plant.py:HeatPumpRoom --name room

`examples/own_plant_controller.py` controls it; docs/own-plants.md explains it.
"""

from collections.abc import Mapping
from math import cos, pi
from random import Random

TANK_J_K, ROOM_J_K = 1.5e6, 1.2e7
RADIATOR_W_K, WALL_W_K = 350.0, 150.0
DAY_S = 86400.0


class HeatPumpRoom:
    """A heat pump heats a buffer tank, and a pump circulates the tank's water through the radiators of a room.

        C_tank dT_tank/dt = COP P - u UA_radiator (T_tank - T_room)
        C_room dT_room/dt = u UA_radiator (T_tank - T_room) - UA_wall (T_room - T_outdoor)

    The equations are integrated with one explicit Euler step per timestep. The COP is that of an air-source heat pump
    for a lift of dT = T_tank - T_outdoor between 15 and 60 K, 6.81 - 0.121 dT + 0.000630 dT² (I. Staffell et al., A
    review of domestic heat pumps, Energy & Environmental Science 5, 2012).
    """

    step_s = 60.0
    begin = "2026-01-12T00:00"
    duration_s = 2 * DAY_S
    sensors = {
        "room_temperature": ("degC", -50.0, 100.0),
        "tank_temperature": ("degC", -50.0, 100.0),
        "outdoor_temperature": ("degC", -50.0, 50.0),
        "cop": ("1", 0.0, 7.0),
    }
    meters = {"electricity": ("J", 0.0, None)}
    actuators = {"compressor": ("W", 0.0, 2000.0), "circulation": ("1", 0.0, 1.0, 0.6)}
    time = ("hour",)
    forkable = True

    def reset(self, seed: int) -> dict[str, float]:
        """Begin an episode; the seed draws mean and amplitude of the outdoor temperature, a sine."""
        random = Random(seed)
        self.mean, self.amplitude = random.uniform(-3.0, 5.0), random.uniform(2.0, 6.0)
        self.elapsed_s, self.room, self.tank = 0.0, 20.0, 40.0
        return self.values(0.0)

    def step(self, commands: Mapping[str, float]) -> dict[str, float]:
        """Simulate a minute. If nobody commands the compressor, a thermostat keeps the tank at 45 degC."""
        power = commands.get("compressor", 2000.0 if self.tank < 45.0 else 0.0)
        power = power if self.tank < 60.0 else 0.0  # the compressor's own limit
        radiator = commands["circulation"] * RADIATOR_W_K * (self.tank - self.room)
        wall = WALL_W_K * (self.room - self.outdoor)
        self.tank += self.step_s * (self.cop * power - radiator) / TANK_J_K
        self.room += self.step_s * (radiator - wall) / ROOM_J_K
        self.elapsed_s += self.step_s
        return self.values(power * self.step_s)

    @property
    def outdoor(self) -> float:
        """Outdoor temperature in degC, lowest at 4 o'clock."""
        return self.mean - self.amplitude * cos(2.0 * pi * (self.elapsed_s / DAY_S - 4.0 / 24.0))

    @property
    def cop(self) -> float:
        """Heat divided by electricity."""
        lift = min(max(self.tank - self.outdoor, 15.0), 60.0)
        return 6.81 - 0.121 * lift + 0.000630 * lift**2

    def values(self, electricity_j: float) -> dict[str, float]:
        """Return all sensors and meters."""
        return {
            "room_temperature": self.room,
            "tank_temperature": self.tank,
            "outdoor_temperature": self.outdoor,
            "cop": self.cop,
            "electricity": electricity_j,
        }
