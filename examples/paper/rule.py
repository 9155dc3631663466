"""The rule of the Sinergym paper for the data center: `--controller examples/paper/rule.py:DataCenterRule`.

Both setpoints move down by one kelvin while the mean temperature of the two zones is above the band that ASHRAE TC 9.9
recommends for data centers (18 to 27 degC), up while it is below, and stay where they are inside it.
"""

from __future__ import annotations

from zenostat import Manifest, SampleView
from zenostat.controllers import Controller, Values

ZONES = ("west_zone_air_temperature", "east_zone_air_temperature")
SETPOINTS = {"heating_setpoint": "west_zone_htg_setpoint", "cooling_setpoint": "west_zone_clg_setpoint"}


class DataCenterRule(Controller):
    """Move both setpoints together by one step per timestep while the zones are outside the band.

    Args:
        manifest: Manifest of a node with one of the `paper-*` scenarios.
        low: Lower limit of the zones' mean temperature, degC.
        high: Upper limit, degC.
        step: Change of the setpoints per timestep, K.
    """

    def __init__(self, manifest: Manifest, *, low: float = 18.0, high: float = 27.0, step: float = 1.0) -> None:
        super().__init__(manifest)
        self.low, self.high, self.step = low, high, step
        self.bounds = {actuator.name: (actuator.low, actuator.high) for actuator in manifest.actuators}

    def act(self, sample: SampleView) -> Values:
        """Return both setpoints, within the bounds of the actions."""
        mean = sum(sample[zone] for zone in ZONES) / len(ZONES)
        change = self.step if mean < self.low else -self.step if mean > self.high else 0.0
        values: Values = {}
        for actuator, sensor in SETPOINTS.items():
            low, high = self.bounds[actuator]
            values[actuator] = min(max(sample[sensor] + change, low), high)
        return values
