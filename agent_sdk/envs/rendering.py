"""Pictures of an episode's last samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zenostat.agent_sdk.envs.episode_history import EpisodeHistory
from zenostat.agent_sdk.rewards import Reward
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import EpisodeChanged
from zenostat.topics.extras import import_extra
from zenostat.topics.messages import Manifest


class EpisodeRenderer:
    """Records the samples of an environment, or of the slots of a vector, and draws them.

    Args:
        manifest: The node's manifest.
        reward: The reward, whose comfort band is shown; None if there is none.
        slots: Number of slots.

    Attributes:
        histories: The recorded samples of each slot.

    Raises:
        InvalidConfig: matplotlib is not installed.
    """

    def __init__(self, manifest: Manifest, reward: Reward | None, slots: int = 1) -> None:
        import_extra("matplotlib.figure", "plots", "render_mode='rgb_array'")
        # By name, as a plug-in: pictures belong to `views`, which is above the environments.
        frame = import_module("zenostat.views.rendering.frame")
        self.histories = tuple(EpisodeHistory(manifest.timestep) for _ in range(slots))
        self._frame = frame.EpisodeFrame(manifest, reward)

    def start(self, slots: Sequence[int], times: Sequence[datetime], values: Floats, infos: Mapping[str, Any]) -> None:
        """Start the histories of some slots; the other arguments have an entry for each slot of the vector."""
        terms = infos.get("reward_terms", {})
        for slot in slots:
            own = {name: term[slot] for name, term in terms.items()}
            self.histories[slot].start(times[slot], values[slot], infos["effective"][slot], own)

    def add(
        self, slots: Sequence[int], times: Sequence[datetime], values: Floats, infos: Mapping[str, Any], actions: Any,
        rewards: Floats,
    ) -> None:  # fmt: skip
        """Add a timestep of some slots; see `start`."""
        terms = infos.get("reward_terms", {})
        for slot in slots:
            own = {name: term[slot] for name, term in terms.items()}
            reward = float(rewards[slot])
            self.histories[slot].add(times[slot], values[slot], infos["effective"][slot], actions[slot], reward, own)

    def picture(self, slot: int = 0) -> NDArray[np.uint8]:
        """Draw the last day of a slot's episode, shape (640, 960, 3), 0 to 255.

        Raises:
            EpisodeChanged: No episode has started.
        """
        history = self.histories[slot]
        if not history.rows:
            raise EpisodeChanged("call reset() before render()")
        picture: NDArray[np.uint8] = self._frame.draw(history)
        return picture
