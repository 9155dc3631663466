"""Rule-based controller that moves setpoints in small steps."""

from __future__ import annotations

from zenostat.agent_sdk.controllers.action_roles import SETPOINTS, ActionBinding, Role, bind_actions
from zenostat.agent_sdk.controllers.base import Controller, Values
from zenostat.agent_sdk.controllers.comfort_band import Band, comfort_bands, inside
from zenostat.agent_sdk.controllers.parameters import ControllerMismatch, number
from zenostat.agent_sdk.controllers.plant import PlantRules
from zenostat.bridge.client.sample import SampleView
from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Manifest


class IncrementalRules(Controller):
    """Move each setpoint by one step per timestep: to save energy while it is comfortable, and back if it is not.

    A heating setpoint stays between the lower limit of the day's comfort band and its middle, a cooling setpoint
    between the middle and the upper limit, both within the action's bounds; they start at the limits. Zones are
    comfortable while the mean temperature of the action's zones is at least `margin` inside the limit that the
    setpoint maintains. `PlantRules` controls all other actions.

    Args:
        manifest: manifest of the node.
        step: change of a setpoint per timestep, K.
        margin: margin, K; None: 1, but at most a third of the band.
        low: lower limit of the comfort band, degC; None: that of the task's reward, or of `LinearReward`.
        high: upper limit, degC.

    Raises:
        InvalidConfig: the task has no setpoint or no air temperature, or a parameter is invalid.
    """

    def __init__(
        self,
        manifest: Manifest,
        *,
        step: float = 0.5,
        margin: float | None = None,
        low: float | None = None,
        high: float | None = None,
    ) -> None:
        super().__init__(manifest)
        self._band = comfort_bands(manifest, low, high)
        self._step_k = number("step", step, minimum=0.01)
        self._margin_k = None if margin is None else number("margin", margin, minimum=0.0)
        self._bindings = bind_actions(manifest)
        if not any(binding.role in SETPOINTS and binding.temperatures for binding in self._bindings):
            raise ControllerMismatch(
                f"the incremental controller needs an action that sets a heating or cooling setpoint, and a sensor of "
                f"'Zone Air Temperature'; node {manifest.node!r} lacks one of them: add both to the scenario"
            )
        self._plant = PlantRules(self._margin_k)
        self._setpoints: dict[str, float] = {}

    def begin(self, sample: SampleView) -> None:  # noqa: ARG002
        """Reset the setpoints to the limits of the band."""
        self._setpoints.clear()
        self._plant.begin()

    def act(self, sample: SampleView) -> Values:
        """Move each setpoint by one step."""
        band, measured = self._band(sample.time), sample.values
        values: Values = {}
        for binding in self._bindings:
            if binding.role in SETPOINTS and binding.temperatures:
                values |= binding.at(self._move(binding, measured, band))
            else:
                values |= self._plant.act(binding, measured, band)
        return values

    def _move(self, binding: ActionBinding, measured: Floats, band: Band) -> float:
        low, high = band
        mean, middle = float(measured[list(binding.temperatures)].mean()), (low + high) / 2
        coolest, warmest = inside(band, self._margin_k)
        if binding.role is Role.HEATING:
            setpoint = self._setpoints.get(binding.action.name, low)
            is_comfortable = mean >= coolest
            setpoint = min(max(setpoint + (-self._step_k if is_comfortable else self._step_k), low), middle)
        else:
            setpoint = self._setpoints.get(binding.action.name, high)
            is_comfortable = mean <= warmest
            setpoint = min(max(setpoint + (self._step_k if is_comfortable else -self._step_k), middle), high)
        self._setpoints[binding.action.name] = setpoint = binding.clip(setpoint)
        return setpoint
