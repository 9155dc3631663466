"""The vector environment on fake buildings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from agent_sdk.bus.sample import SampleView
from agent_sdk.envs import arguments
from agent_sdk.envs.vector_env import BuildingVectorEnv
from agent_sdk.rewards import AnyReward
from agent_sdk.testing.fake_building import FakeBuilding
from agent_sdk.testing.fake_link import FakeLink
from topics.errors import EpisodeChanged, InvalidAction, InvalidConfig, PeerError
from topics.messages import Ack, Sample, WeatherSeries

Floats = NDArray[np.float64]


class FakeSlots:
    """A hold on several fake buildings that step together, as `ControllerLink` is one on a node with slots.

    Args:
        buildings: with the same points.
        name: of the controller, as `value_source` has it.

    Attributes:
        manifest: that of the first, with the number of slots.
        accepted: the answer to the latest reset.
    """

    accepted: Ack

    def __init__(self, buildings: Sequence[FakeBuilding], *, name: str = "env") -> None:
        self._links = [FakeLink(building, name=name) for building in buildings]
        self.manifest = self._links[0].manifest.model_copy(update={"slots": len(self._links)})
        self.name = name
        self._latest: list[SampleView] = []
        self._episodes = [-1] * len(self._links)
        self._sent: list[int] = []

    def reset(
        self, *, seed: int | list[int | None] | None = None, slots: list[int] | None = None, snapshot: str = ""
    ) -> SampleView:
        """Starts new episodes, in these slots or in all.

        Raises:
            PeerError: some slots never began, or a snapshot, which fake buildings do not keep.
        """
        if snapshot or (slots is not None and not self._latest):
            raise PeerError("node 'fake' keeps no snapshots" if snapshot else "reset all slots first")
        chosen = list(range(len(self._links))) if slots is None else slots
        seeds = [seed + i for i in range(len(chosen))] if isinstance(seed, int) else seed or [None] * len(chosen)
        new = {slot: self._links[slot].reset(seed=one) for slot, one in zip(chosen, seeds, strict=True)}
        self._latest = [new.get(slot) or self._latest[slot] for slot in range(len(self._links))]
        self._episodes = [view.episode for view in self._latest]
        begun = [self._links[slot].accepted.episode_starts[0] for slot in chosen]
        self.accepted, self._sent = Ack(episode=self._episodes, episode_starts=begun), []
        return self._frame()

    def send(self, values: Floats, operations: bytes | None = None, *, still: Sequence[int] = ()) -> None:
        """Answers the present sample of all slots but those that are `still`.

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
            kinds = None if operations is None else operations[slot * count : (slot + 1) * count]
            self._links[slot].send(rows[slot], kinds)

    def receive(self) -> SampleView:
        """The next sample.

        Raises:
            EpisodeChanged: a slot that was answered is over.
            PeerError: nothing was sent, for which a real node would wait for ever.
        """
        if not self._sent:
            raise PeerError("the present sample is not answered; call send() before receive()")
        over = [slot for slot in self._sent if self._latest[slot].truncated]
        if over:
            raise EpisodeChanged(f"slot {over[0]} is over; reset it, or leave it standing still")
        for slot in self._sent:
            self._latest[slot] = self._links[slot].receive()
        self._sent = []
        return self._frame()

    def weather(self, columns: Sequence[str], slot: int = 0) -> WeatherSeries:
        """See `FakeBuilding.weather`."""
        return self._links[slot].weather(columns)

    def close(self) -> None:
        """Nothing is held."""

    def _frame(self) -> SampleView:
        wires = [view.message for view in self._latest]
        wire = Sample(
            episode=[one.episode[0] for one in wires],
            step=[one.step[0] for one in wires],
            time=[one.time[0] for one in wires],
            elapsed_s=[one.elapsed_s[0] for one in wires],
            flags=[one.flags[0] for one in wires],
            values=b"".join(one.values for one in wires),
            effective=b"".join(one.effective for one in wires),
            source_index=b"".join(one.source_index for one in wires),
            sources=wires[0].sources,
        )
        return SampleView(wire, self.manifest, {name: i for i, name in enumerate(self.manifest.names)})


class FakeVectorEnv(BuildingVectorEnv):
    """`BuildingVectorEnv` without EnergyPlus: `gym.make_vec("zenostat/Fake-v1", num_envs=8, zones=5)`.

    Args:
        num_envs: how many.
        zones: of each building: how many, or each of them.
        reward, render_mode: see `FakeEnv`.
        autoreset_mode: see `BuildingVectorEnv`.
        building: all else that `FakeBuilding` takes.

    Raises:
        InvalidConfig: what cannot be.
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
            raise InvalidConfig("render_mode 'rerun' shows a bus, which a fake building has none of; take 'rgb_array'")
        if not isinstance(num_envs, int) or num_envs < 1:
            raise InvalidConfig(f"num_envs = {num_envs!r}; at least 1 expected")
        link = FakeSlots([FakeBuilding(zones, **building) for _ in range(num_envs)])
        super().__init__(num_envs, reward=reward, render_mode=render_mode, autoreset_mode=autoreset_mode, link=link)
