"""Connection to a fake building with the interface of `ControllerLink`, in the same process."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from zenostat.agent_sdk.testing.fake_building import FakeBuilding
from zenostat.bridge.client.command_publisher import CommandArrays
from zenostat.bridge.client.sample import SampleView
from zenostat.topics import codec
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import EpisodeChanged, PeerError, RequestRejected, UsageError
from zenostat.topics.messages import Ack, CommandOp, EngineStart, EpisodeStart, Flag, Sample, WeatherSeries
from zenostat.topics.points import bound_arrays, describe_violation, value_index

_KEEP, _SET, _RELINQUISH = int(CommandOp.KEEP), int(CommandOp.SET), int(CommandOp.RELINQUISH)
_TRUNCATED = int(Flag.TRUNCATED)


class FakeLink:
    """Receive samples from a fake building and send commands, from an environment or a controller's loop.

    Args:
        building: the fake building, or one for each slot, with equal points; default: `FakeBuilding()`.
        name: name of the controller in `value_source`.

    Attributes:
        building: the fake building, that of the first slot.
        manifest: manifest of the building, with the number of slots.
        accepted: reply to the latest reset.
    """

    accepted: Ack

    def __init__(self, building: FakeBuilding | Sequence[FakeBuilding] | None = None, *, name: str = "env") -> None:
        building = FakeBuilding() if building is None else building
        self._buildings = [building] if isinstance(building, FakeBuilding) else [*building]
        self.building, slots = self._buildings[0], len(self._buildings)
        self.manifest = self.building.manifest.model_copy(update={"slots": slots})
        self.name = name
        self._names, self._arrays = value_index(self.manifest), CommandArrays(self.manifest)
        self._low, self._high = bound_arrays(self.manifest.actuators)
        self._values = np.full((slots, len(self._names)), np.nan)
        self._commanded = np.full((slots, len(self.manifest.actuators)), np.nan)
        self._effective = self._commanded.copy()
        self._latest: SampleView | None = None
        self._sent: tuple[Floats, NDArray[np.uint8], list[int]] | None = None
        self._episodes = [-1] * slots

    def reset(
        self, *, seed: int | list[int | None] | None = None, slots: list[int] | None = None, snapshot: str = ""
    ) -> SampleView:
        """Start new episodes under baseline control in these slots, or in all, and return the sample.

        Raises:
            PeerError: not all slots were reset before, or `snapshot` is set, which fake buildings do not support.
        """
        if snapshot or (slots is not None and self._latest is None):
            raise PeerError("node 'fake' has no snapshots" if snapshot else "reset all slots first")
        chosen = range(self.manifest.slots) if slots is None else slots
        seeds = seed if isinstance(seed, list) else [None if seed is None else seed + i for i in range(len(chosen))]
        for slot, slot_seed in zip(chosen, seeds, strict=True):
            building = self._buildings[slot]
            self._values[slot], self._effective[slot] = building.reset(slot_seed), building.baseline_control
            self._commanded[slot] = np.nan
            self._episodes[slot] += 1
        self._sent = None
        starts = [_episode_start(self._buildings[slot]) for slot in chosen]
        self.accepted = Ack(episode=[*self._episodes], episode_starts=starts)
        return self._sample()

    def receive(self) -> SampleView:
        """Simulate a timestep, and return its sample.

        Raises:
            RequestRejected: a value is out of its actuator's bounds; the building waits for another command.
            ModelError: a heating setpoint is above the cooling setpoint.
            EpisodeChanged: the episode of a slot that was answered is over.
            PeerError: no command was sent; a real node would wait forever.
        """
        if self._latest is None or _is_over(self._latest):
            raise EpisodeChanged("the episode is over; call reset()" if self._latest else "call reset() first")
        if self._sent is None:
            raise PeerError("the present sample is not answered; call send() before receive()")
        (values, operations, advancing), self._sent = self._sent, None
        for slot in advancing:
            if self._latest.message.flags[slot] & _TRUNCATED:
                raise EpisodeChanged(f"the episode of slot {slot} is over; reset the slot, or list it in still=")
        self._check_bounds(values, operations)
        self._commanded = np.where(
            operations == _SET, values, np.where(operations == _RELINQUISH, np.nan, self._commanded)
        )
        for slot in advancing:
            self._values[slot], self._effective[slot] = self._buildings[slot].advance(self._commanded[slot])
        return self._sample()

    def send(
        self,
        values: Mapping[str, float | None] | Floats | None = None,
        operations: bytes | None = None,
        *,
        still: Sequence[int] = (),
    ) -> None:
        """Answer the present sample; see `ControllerLink.send`.

        Raises:
            InvalidAction: an unknown actuator, a wrong shape, or a value that is not finite.
        """
        if self._latest is None:
            raise UsageError("there is no sample to answer yet; call reset() first")
        if _is_over(self._latest):
            return
        raw, raw_operations = self._arrays.of(values, operations)
        shape = self._commanded.shape
        codes = np.full(shape, _SET, np.uint8)
        if raw_operations is not None:
            codes[:] = codec.uint8s(raw_operations, shape, "operations")
        if still:
            codes[[*still]] = _KEEP
        advancing = [slot for slot in range(self.manifest.slots) if slot not in still]
        self._sent = codec.floats(raw, shape, "values"), codes, advancing

    def weather(self, columns: Sequence[str], slot: int = 0) -> WeatherSeries:
        """Return columns of the weather of a slot; see `FakeBuilding.weather`."""
        return self._buildings[slot].weather(columns)

    def close(self) -> None:
        """Do nothing: a fake link has no resources."""

    def __iter__(self) -> Iterator[SampleView]:
        """Yield the samples from the present to the last of the episode; without `send`, commands stay as they are."""
        sample = self._latest if self._latest is not None and not self._latest.truncated else self.reset()
        while True:
            yield sample
            if sample.truncated:
                return
            if self._sent is None:
                self.send()
            sample = self.receive()

    def _check_bounds(self, values: Floats, operations: NDArray[np.uint8]) -> None:
        outside = (operations == _SET) & ~((values >= self._low) & (values <= self._high))
        if outside.any():
            slot, index = np.argwhere(outside)[0]
            reason = describe_violation(self.manifest.actuators[index], values[slot, index])
            raise RequestRejected(f"node 'fake' rejected the command: {reason}")

    def _sample(self) -> SampleView:
        wire = Sample(
            episode=[*self._episodes],
            step=[building.step for building in self._buildings],
            time=[building.now.isoformat() for building in self._buildings],
            elapsed_s=[building.step * building.run_period.step_s for building in self._buildings],
            flags=[_flags(building) for building in self._buildings],
            values=self._values.astype(codec.FLOAT).tobytes(),
            effective=self._effective.astype(codec.FLOAT).tobytes(),
            commanded=self._commanded.astype(codec.FLOAT).tobytes(),
            source_index=np.where(np.isnan(self._commanded), 0, 1).astype(codec.INDEX).tobytes(),
            sources=["", self.name],
        )
        self._latest = SampleView(wire, self.manifest, self._names, self)
        return self._latest


def _is_over(sample: SampleView) -> bool:
    """Return whether the episodes of all slots are over."""
    return all(flag & _TRUNCATED for flag in sample.message.flags)


def _episode_start(building: FakeBuilding) -> EpisodeStart:
    climate = building.climate
    noise = {"sigma": climate.noise_k, "mu": 0.0, "tau_h": climate.noise_tau_h} if climate.noise_k else {}
    return EpisodeStart(
        engine_start=EngineStart.REUSED,
        weather=building.manifest.weather,
        noise_parameters={f"dry_bulb_temperature.{name}": value for name, value in noise.items()},
    )


def _flags(building: FakeBuilding) -> Flag:
    is_last = building.step == building.manifest.steps
    return (Flag.NONE if building.step else Flag.FIRST) | (Flag.TRUNCATED if is_last else Flag.NONE)
