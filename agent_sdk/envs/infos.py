"""The info dictionaries of an environment's samples."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from zenostat.agent_sdk.envs.connection import AGENT
from zenostat.agent_sdk.envs.vector_infos import Infos, Slots, merge, select
from zenostat.agent_sdk.envs.vector_sample import VectorSample
from zenostat.bridge.client.sample import SampleView
from zenostat.topics.messages import EpisodeStart


class Named(Protocol):
    """A link to a node under a name."""

    name: str


class SampleInfos:
    """Infos of a single environment.

    Args:
        has_limits: Whether the task has termination limits.

    Attributes:
        episode_start: Weather, weather noise and engine start of the running episode.
        output_dir: Folder of EnergyPlus's output files of the running episode; empty if they are not kept.
    """

    def __init__(self, *, has_limits: bool) -> None:
        self.episode_start: dict[str, Any] = {"weather": "", "weather_noise": {}, "engine_start": ""}
        self.output_dir = ""
        self._has_limits = has_limits
        self._sources: tuple[bytes, list[str]] = (b"", [])
        self._value_source: tuple[str, ...] = ()

    def start_episode(self, start: EpisodeStart) -> None:
        """Replace the entries that an episode has from its start."""
        self.output_dir = start.output_dir
        self.episode_start = _start_entries(start)

    def of_sample(self, sample: SampleView, link: Named) -> dict[str, Any]:
        """Build the info of a sample, without the entries of action and reward."""
        message = sample.message
        if (message.source_index, message.sources) != self._sources:
            own_name = link.name
            self._sources = (message.source_index, message.sources)
            self._value_source = tuple(AGENT if name == own_name else name for name in sample.value_source.values())
        info = {
            "time": message.time[0],
            "step": message.step[0],
            "effective": sample.effective,
            "value_source": self._value_source,
            "late": message.late,
            "rejected": message.rejected,
            **self.episode_start,
            "weather_noise": dict(self.episode_start["weather_noise"]),
        }
        if self._has_limits:
            info["terminated_by"] = ""
        if self.output_dir:
            info["output_dir"] = ""
        if message.fault_free_values:
            info["fault_free_values"] = sample.fault_free_values
        if message.baseline:
            info |= {"baseline": sample.baseline, "baseline_effective": sample.baseline_effective}
        return info


class VectorSampleInfos:
    """Infos of a vector environment, in Gymnasium's form for vectors.

    Args:
        count: Number of slots.
        has_limits: Whether the task has termination limits.

    Attributes:
        episode_start: Weather, weather noise and engine start of each slot's running episode.
    """

    def __init__(self, count: int, *, has_limits: bool) -> None:
        self.episode_start: Infos = {}
        self._count, self._has_limits = count, has_limits
        self._output_dir = [""] * count
        self._sources: tuple[bytes, list[str]] = (b"", [])
        self._value_source: NDArray[np.object_] = np.empty(count, object)

    def start_episodes(
        self,
        slots: Sequence[int],
        starts: Sequence[EpisodeStart],
        add_info: Callable[[Infos, dict[str, Any], int], Infos],
    ) -> Slots:
        """Replace the entries that the episodes of these slots have from their start.

        Args:
            slots: Numbers of the slots.
            starts: The start of each one's episode.
            add_info: Gymnasium's method that adds a slot's info to those of the vector.

        Returns:
            Which slots these are, shape (slots,).
        """
        started: Infos = {}
        for slot, start in zip(slots, starts, strict=True):
            self._output_dir[slot] = start.output_dir
            started = add_info(started, _start_entries(start), slot)
        chosen = np.zeros(self._count, np.bool_)
        chosen[list(slots)] = True
        self.episode_start = merge(select(self.episode_start, ~chosen), started)
        return chosen

    def of_sample(self, sample: VectorSample, link: Named) -> dict[str, Any]:
        """Build the entries of a sample for all slots, without those of action, reward and episode start."""
        message = sample.message
        if (message.source_index, message.sources) != self._sources:
            own_name = link.name
            self._sources = (message.source_index, message.sources)
            self._value_source = sample.value_source([AGENT if n == own_name else n for n in message.sources])
        infos = {
            "time": np.array(message.time, object),
            "step": np.array(message.step),
            "effective": sample.effective,
            "value_source": self._value_source.copy(),
            "late": message.late,
            "rejected": message.rejected,
            **sample.baseline,
        }
        if message.fault_free_values:
            infos["fault_free_values"] = sample.fault_free_values
        if self._has_limits:
            infos["terminated_by"] = np.full(self._count, "", object)
        if any(self._output_dir):
            infos["output_dir"] = np.full(self._count, "", object)
        return infos

    def add_ends(self, infos: dict[str, Any], violations: Mapping[int, str], truncated: Slots) -> None:
        """Add the cause of termination and the output folder to the entries of slots whose episode has ended."""
        for slot, text in violations.items():
            infos["terminated_by"][slot] = text
        if any(self._output_dir):
            for slot in {*violations, *np.flatnonzero(truncated).tolist()}:
                infos["output_dir"][slot] = self._output_dir[slot]


def _start_entries(start: EpisodeStart) -> dict[str, Any]:
    return {"weather": start.weather, "weather_noise": start.noise_parameters, "engine_start": start.engine_start}
