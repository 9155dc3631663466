"""PID control of the heating and the cooling setpoint, as a baseline."""

from __future__ import annotations

from zenostat.agent_sdk.controllers import Controller, PIDController, Values
from zenostat.agent_sdk.controllers.action_roles import Role, bind_actions
from zenostat.agent_sdk.controllers.comfort_band import comfort_bands, inside
from zenostat.agent_sdk.controllers.parameters import ControllerMismatch
from zenostat.bridge.client.sample import SampleView
from zenostat.metrics.reward_comfort import comfort
from zenostat.topics.messages import Manifest


class TwoLoopPID(Controller):
    """Keep one zone 1 K inside the comfort band, day and night, with a PID loop for heating and one for cooling.

    The zone is the first one whose comfort the task's reward rates. Each loop moves one setpoint of all thermostats,
    with the default gains of `PIDController`.

    Args:
        manifest: manifest of the node.

    Raises:
        ControllerMismatch: the task has not one heating and one cooling setpoint, or no zone.
    """

    def __init__(self, manifest: Manifest) -> None:
        super().__init__(manifest)
        rated = comfort(manifest)
        actions = {binding.role: binding.action.name for binding in bind_actions(manifest)}
        if rated is None or set(actions) != {Role.HEATING, Role.COOLING}:
            raise ControllerMismatch("two PID loops need zones with a comfort band, a heating and a cooling setpoint")
        low, high = inside(comfort_bands(manifest)(manifest.time_at(0)))
        sensor = manifest.sensors[int(rated.zones[0])].name
        self._loops = [
            PIDController(manifest, setpoint=setpoint, sensor=sensor, actuator=actions[role])
            for role, setpoint in ((Role.HEATING, low), (Role.COOLING, high))
        ]

    def begin(self, sample: SampleView) -> None:
        """Reset the integrals."""
        for loop in self._loops:
            loop.begin(sample)

    def act(self, sample: SampleView) -> Values:
        """Return both setpoints."""
        values: Values = {}
        for loop in self._loops:
            values |= loop.act(sample)
        return values
