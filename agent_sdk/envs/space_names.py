"""The names of what an environment observes and sets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any
from weakref import WeakSet

import numpy as np
from numpy.typing import ArrayLike

from agent_sdk.envs.actions import Actions
from topics.errors import InvalidConfig
from topics.messages import Manifest

_ANY_LAYER = "agent_sdk.wrappers.observation_dict(env, observation) names the values of any layer"


def by_name(names: Sequence[str], observation: ArrayLike, whose: str) -> dict[str, float]:
    """The values of one observation by name.

    Raises:
        InvalidConfig: another shape than (names,), as of an observation of another layer of wrappers.
    """
    values = np.asarray(observation)
    if values.shape != (len(names),):
        raise InvalidConfig(
            f"{whose}: an observation of shape ({len(names)},) expected, got {values.shape}; {_ANY_LAYER}"
        )
    return dict(zip(names, values.tolist(), strict=True))


class SpaceNames:
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

    def add_layer(self, wrapper: Any) -> None:
        """Register a wrapper with `observation_names` of its own around this environment."""
        self.__dict__.setdefault("_layers", WeakSet()).add(wrapper)

    def observation_dict(self, observation: ArrayLike) -> dict[str, float]:
        """The values of one building's observation by name, in the unit that the manifest says.

        An observation of a wrapper of `agent_sdk.wrappers` around this environment has that wrapper's names.

        Raises:
            InvalidConfig: no layer has observations of that shape, or several that name their values differently.
        """
        layers = self.__dict__.get("_layers", ())
        known = {self.observation_names, *(tuple(layer.observation_names) for layer in layers)}
        fitting = [names for names in known if np.shape(observation) == (len(names),)]
        if len(fitting) > 1:
            raise InvalidConfig(
                f"observation_dict: {len(fitting)} layers of wrappers have {len(fitting[0])} values in different "
                f"order, and an array does not say whose it is; {_ANY_LAYER}"
            )
        return by_name(fitting[0] if fitting else self.observation_names, observation, "observation_dict")
