"""Names of the dimensions of observations and actions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from zenostat.agent_sdk.envs.action_values import Actions
from zenostat.agent_sdk.envs.wrapper_set import WrapperSet
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Manifest

_HINT = "zenostat.wrappers.observation_dict(env, observation) names the values of any layer"


def by_name(names: Sequence[str], observation: ArrayLike, caller: str) -> dict[str, float]:
    """Return the values of one observation by name.

    Args:
        names: Names of the values.
        observation: Shape (names,).
        caller: Name of the calling function, for the error.

    Raises:
        InvalidConfig: Another shape, as of an observation of another layer of wrappers.
    """
    values = np.asarray(observation)
    if values.shape != (len(names),):
        raise InvalidConfig(f"{caller}: an observation of shape ({len(names)},) expected, got {values.shape}; {_HINT}")
    return dict(zip(names, values.tolist(), strict=True))


class SpaceNames:
    """Names of the observations and actions of an environment, or of a vector of them, on one node."""

    manifest: Manifest
    _actions: Actions

    @property
    def observation_names(self) -> tuple[str, ...]:
        """Names of the values of an observation: time fields, observed sensors, observed meters."""
        return (*map(str, self.manifest.task.time), *self.manifest.observed_names)

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the dimensions of an action; of a discrete one, those of the actions that its choices set."""
        return tuple(self._actions.names)

    def add_layer(self, wrapper: Any) -> None:
        """Register a wrapper with `observation_names` of its own around this environment."""
        self.__dict__.setdefault("_layers", WrapperSet()).add(wrapper)

    def observation_dict(self, observation: ArrayLike) -> dict[str, float]:
        """Return the values of one building's observation by name, in the units of the manifest.

        For an observation of a wrapper of `zenostat.wrappers` around this environment, that wrapper's names are used.

        Raises:
            InvalidConfig: No layer has observations of that shape, or several layers name their values differently.
        """
        layers = self.__dict__.get("_layers", ())
        candidates = {self.observation_names, *(tuple(layer.observation_names) for layer in layers)}
        matching = [names for names in candidates if np.shape(observation) == (len(names),)]
        if len(matching) > 1:
            raise InvalidConfig(
                f"observation_dict: {len(matching)} layers of wrappers have {len(matching[0])} values in different "
                f"order, and an array does not show which layer it is from; {_HINT}"
            )
        return by_name(matching[0] if matching else self.observation_names, observation, "observation_dict")
