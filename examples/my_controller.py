"""Your own controller: a cooling schedule for any building with thermostats.

Start a node first, in another terminal:

    zenostat node --building office-small --weather USA_CO_Denver --begin 07-01 --end 07-07 --name office

Then: `zenostat run --node office --controller examples/my_controller.py:Mine --set day=25`
"""

from zenostat import Manifest, SampleView
from zenostat.controllers import Controller, Values


class Mine(Controller):
    """Use one cooling setpoint from 6 to 20 o'clock and another at night, both in degC."""

    def __init__(self, manifest: Manifest, *, day: float = 24.5, night: float = 29.0) -> None:
        super().__init__(manifest)
        self.day, self.night = day, night
        self.setpoints = [a.name for a in manifest.actuators if a.control_type == "Cooling Setpoint"]

    def act(self, sample: SampleView) -> Values:
        """Return the setpoints for the timestep that begins at `sample.time`."""
        return dict.fromkeys(self.setpoints, self.day if 6 <= sample.time.hour < 20 else self.night)
