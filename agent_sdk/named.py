"""The names of what an environment observes and sets."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from agent_sdk.actions import Actions
from topics.messages import Manifest


class Named:
    """An environment, or a vector of them, on the points of one node."""

    manifest: Manifest
    _actions: Actions

    @property
    def observation_names(self) -> tuple[str, ...]:
        """Names of the values of an observation: time fields, sensors, meters."""
        return (*map(str, self.manifest.task.time), *self.manifest.names)

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the dimensions of an action; of what the choices set where it is discrete."""
        return tuple(self._actions.names)

    def observation_dict(self, observation: ArrayLike) -> dict[str, float]:
        """The values of one building's observation by name, in the unit that the manifest says."""
        return dict(zip(self.observation_names, np.asarray(observation).tolist(), strict=True))
