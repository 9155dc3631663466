"""Setpoints that move by a step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent_sdk.bus.sample import SampleView
from agent_sdk.controllers.action_roles import SETPOINTS, ActionBinding, Role, bind_actions
from agent_sdk.controllers.base import Controller, Values
from agent_sdk.controllers.comfort_band import Band, comfort_bands, inside
from agent_sdk.controllers.parameters import ControllerMismatch, number
from agent_sdk.controllers.plant import PlantRules
from topics.messages import Manifest


class IncrementalRules(Controller):
    """Moves each setpoint by a step a timestep: to less energy while it is comfortable, back when it is not.

    A heating setpoint lies between the lower end of the day's comfort band and its middle, a cooling setpoint between
    the middle and the upper end, both within the action's bounds; they begin at the ends. It is comfortable while the
    mean temperature of the zones that the action rules is at least `margin` inside the end that the setpoint guards.
    What is no setpoint is ruled by `PlantRules`.

    Args:
        manifest: of the node.
        step: K, how far a setpoint moves in a timestep.
        margin: K; None: 1, and a third of a band that is narrower than 3 K.
        low: lower end of the comfort band, degC; None: that of the task's reward, or of `LinearReward`.
        high: its upper end.

    Raises:
        InvalidConfig: no setpoint or no air temperature in the task, or a parameter that cannot be.
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
        self._step_k = number("step", step, least=0.01)
        self._margin_k = None if margin is None else number("margin", margin, least=0.0)
        self._parts = bind_actions(manifest)
        if not any(part.role in SETPOINTS and part.temperatures for part in self._parts):
            raise ControllerMismatch(
                f"the incremental rules need an action that sets a heating or cooling setpoint and a sensor of 'Zone "
                f"Air Temperature'; node {manifest.node!r} lacks one of them: name both in the scenario"
            )
        self._plant = PlantRules(self._margin_k)
        self._at: dict[str, float] = {}

    def begin(self, sample: SampleView) -> None:  # noqa: ARG002
        """Puts the setpoints back to the ends of the band."""
        self._at.clear()
        self._plant.begin()

    def act(self, sample: SampleView) -> Values:
        """Each setpoint a step further."""
        band, measured = self._band(sample.time), sample.values
        values: Values = {}
        for part in self._parts:
            if part.role in SETPOINTS and part.temperatures:
                values |= part.at(self._moved(part, measured, band))
            else:
                values |= self._plant.act(part, measured, band)
        return values

    def _moved(self, part: ActionBinding, measured: NDArray[np.float64], band: Band) -> float:
        low, high = band
        mean, middle = float(measured[list(part.temperatures)].mean()), (low + high) / 2
        coolest, warmest = inside(band, self._margin_k)
        if part.role is Role.HEATING:
            at = self._at.get(part.action.name, low)
            outwards = mean >= coolest
            at = min(max(at + (-self._step_k if outwards else self._step_k), low), middle)
        else:
            at = self._at.get(part.action.name, high)
            outwards = mean <= warmest
            at = min(max(at + (self._step_k if outwards else -self._step_k), middle), high)
        self._at[part.action.name] = at = part.clip(at)
        return at
