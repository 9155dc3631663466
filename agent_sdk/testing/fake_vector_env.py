"""Vector environment of fake buildings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from zenostat.agent_sdk.envs import arguments
from zenostat.agent_sdk.envs.vector_env import BuildingVectorEnv
from zenostat.agent_sdk.rewards import AnyReward
from zenostat.agent_sdk.testing.fake_building import FakeBuilding
from zenostat.agent_sdk.testing.fake_link import FakeLink
from zenostat.bridge.client.sample import SampleView
from zenostat.topics.errors import EpisodeChanged, InvalidAction, InvalidConfig, PeerError
from zenostat.topics.messages import Ack, Sample, WeatherSeries
from zenostat.topics.points import value_index

Floats = NDArray[np.float64]


class FakeSlots:
    """Connection to several fake buildings that step together, like `ControllerLink` on a node with slots.

    Args:
        buildings: fake buildings with equal points.

    Attributes:
        manifest: manifest of the first building, with the number of slots.
        accepted: reply to the latest reset.
    """

    accepted: Ack

    def __init__(self, buildings: Sequence[FakeBuilding]) -> None:
        self._links = [FakeLink(building) for building in buildings]
        self.manifest = self._links[0].manifest.model_copy(update={"slots": len(self._links)})
        self.name = self._links[0].name
        self._latest: list[SampleView] = []
        self._episodes = [-1] * len(self._links)
        self._sent: list[int] = []

    def reset(
        self, *, seed: int | list[int | None] | None = None, slots: list[int] | None = None, snapshot: str = ""
    ) -> SampleView:
        """Start new episodes in the given slots, or in all.

        Raises:
            PeerError: not all slots were reset before, or `snapshot` is set, which fake buildings do not support.
        """
        if snapshot or (slots is not None and not self._latest):
            raise PeerError("node 'fake' has no snapshots" if snapshot else "reset all slots first")
        chosen = list(range(len(self._links))) if slots is None else slots
        seeds = [seed + i for i in range(len(chosen))] if isinstance(seed, int) else seed or [None] * len(chosen)
        new = {slot: self._links[slot].reset(seed=slot_seed) for slot, slot_seed in zip(chosen, seeds, strict=True)}
        self._latest = [new.get(slot) or self._latest[slot] for slot in range(len(self._links))]
        self._episodes = [view.episode for view in self._latest]
        starts = [self._links[slot].accepted.episode_starts[0] for slot in chosen]
        self.accepted, self._sent = Ack(episode=self._episodes, episode_starts=starts), []
        return self._sample()

    def send(self, values: Floats, operations: bytes | None = None, *, still: Sequence[int] = ()) -> None:
        """Answer the present sample of all slots except `still`.

        Raises:
            InvalidAction: a wrong shape.
        """
        count = len(self.manifest.actuators)
        shape = (len(self._links), count) if len(self._links) > 1 else (count,)
        if values.shape != shape:
            raise InvalidAction(f"values of shape {values.shape}; {shape} expected: one for each actuator")
        self._sent = [slot for slot in range(len(self._links)) if slot not in still]
        rows = values.reshape(len(self._links), count)
        for slot in self._sent:
            part = None if operations is None else operations[slot * count : (slot + 1) * count]
            self._links[slot].send(rows[slot], part)

    def receive(self) -> SampleView:
        """Simulate a timestep, and return its sample.

        Raises:
            EpisodeChanged: the episode of an answered slot is over.
            PeerError: no command was sent; a real node would wait forever.
        """
        if not self._sent:
            raise PeerError("the present sample is not answered; call send() before receive()")
        over = [slot for slot in self._sent if self._latest[slot].truncated]
        if over:
            raise EpisodeChanged(f"the episode of slot {over[0]} is over; reset the slot, or list it in still=")
        for slot in self._sent:
            self._latest[slot] = self._links[slot].receive()
        self._sent = []
        return self._sample()

    def weather(self, columns: Sequence[str], slot: int = 0) -> WeatherSeries:
        """Return columns of the weather of a slot; see `FakeBuilding.weather`."""
        return self._links[slot].weather(columns)

    def close(self) -> None:
        """Do nothing: a fake link has no resources."""

    def _sample(self) -> SampleView:
        messages = [view.message for view in self._latest]
        wire = Sample(
            episode=[message.episode[0] for message in messages],
            step=[message.step[0] for message in messages],
            time=[message.time[0] for message in messages],
            elapsed_s=[message.elapsed_s[0] for message in messages],
            flags=[message.flags[0] for message in messages],
            values=b"".join(message.values for message in messages),
            effective=b"".join(message.effective for message in messages),
            commanded=b"".join(message.commanded for message in messages),
            source_index=b"".join(message.source_index for message in messages),
            sources=messages[0].sources,
        )
        return SampleView(wire, self.manifest, value_index(self.manifest))


class FakeVectorEnv(BuildingVectorEnv):
    """`BuildingVectorEnv` without EnergyPlus: `gym.make_vec("zenostat/Fake-v1", num_envs=8, zones=5)`.

    Args:
        num_envs: number of environments.
        zones: number of zones of each building, or the zones.
        reward, render_mode: see `FakeEnv`.
        autoreset_mode: see `BuildingVectorEnv`.
        building: further arguments of `FakeBuilding`.

    Raises:
        InvalidConfig: an argument is invalid.
    """

    def __init__(
        self,
        num_envs: int = 1,
        zones: Any = 3,
        *,
        reward: AnyReward | None = arguments.FROM_SCENARIO,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **building: Any,
    ) -> None:
        if render_mode == "rerun":
            raise InvalidConfig("render_mode 'rerun' shows a bus, but a fake building has none; use 'rgb_array'")
        if not isinstance(num_envs, int | np.integer) or num_envs < 1:
            raise InvalidConfig(f"num_envs = {num_envs!r}; at least 1 expected")
        arguments.check_arguments(building, FakeBuilding)
        link = FakeSlots([FakeBuilding(zones, **building) for _ in range(num_envs)])
        super().__init__(num_envs, reward=reward, render_mode=render_mode, autoreset_mode=autoreset_mode, link=link)
