"""A controller's hold on a fake building: the interface of `ControllerLink`, in this process."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from agent_sdk.bus.sample import SampleView
from agent_sdk.testing.fake_building import FakeBuilding
from topics.errors import EpisodeChanged, InvalidAction, PeerError, RequestRejected, did_you_mean
from topics.messages import Ack, CommandOp, EngineStart, EpisodeStart, Flag, Sample, WeatherSeries
from topics.units import with_unit

Floats = NDArray[np.float64]


class FakeLink:
    """Samples of a fake building out, commands in: what an environment or a controller's loop runs on.

    Args:
        building: a default one if left out.
        name: of the controller, as `value_source` has it.

    Attributes:
        manifest: the building's.
        accepted: the answer to the latest reset.
    """

    accepted: Ack

    def __init__(self, building: FakeBuilding | None = None, *, name: str = "env") -> None:
        self.building = FakeBuilding() if building is None else building
        self.manifest = self.building.manifest
        self.name = name
        self._names = {point: i for i, point in enumerate(self.manifest.names)}
        self._actuators = {a.name: i for i, a in enumerate(self.manifest.actuators)}
        self._low = np.array([-np.inf if a.low is None else a.low for a in self.manifest.actuators])
        self._high = np.array([np.inf if a.high is None else a.high for a in self.manifest.actuators])
        self._held = np.full(len(self._actuators), np.nan)
        self._latest: SampleView | None = None
        self._sent: tuple[Floats, Floats] | None = None
        self._episode = -1

    def reset(self, *, seed: int | None = None) -> SampleView:
        """Starts a new episode: its sample 0; all actuators are the building's own again."""
        values = self.building.reset(seed)
        self._episode += 1
        self._held[:] = np.nan
        self._sent = None
        climate = self.building.climate
        noise = {"sigma": climate.noise_k, "mu": 0.0, "tau_h": climate.noise_tau_h} if climate.noise_k else {}
        self.accepted = Ack(
            episode=[self._episode],
            episode_starts=[
                EpisodeStart(
                    engine_start=EngineStart.REUSED,
                    weather=self.manifest.weather,
                    noise_parameters={f"dry_bulb_temperature.{name}": value for name, value in noise.items()},
                )
            ],
        )
        return self._sample(values, self.building.own_control)

    def receive(self) -> SampleView:
        """The next sample.

        Raises:
            RequestRejected: a value out of its actuator's bounds; the building waits for another command.
            ModelError: a heating setpoint above the cooling setpoint.
            EpisodeChanged: the episode is over.
            PeerError: nothing was sent, for which a real node would wait for ever.
        """
        if self._latest is None or self._latest.truncated:
            raise EpisodeChanged("the episode is over; call reset()" if self._latest else "call reset() first")
        if self._sent is None:
            raise PeerError("the present sample is not answered; call send() before receive()")
        (values, kinds), self._sent = self._sent, None
        self._refuse(values, kinds)
        self._held = np.where(
            kinds == CommandOp.SET, values, np.where(kinds == CommandOp.RELINQUISH, np.nan, self._held)
        )
        return self._sample(*self.building.advance(self._held))

    def send(self, values: Mapping[str, float | None] | Floats | None = None, operations: bytes | None = None) -> None:
        """Answers the present sample, as `ControllerLink.send` does.

        Raises:
            InvalidAction: an unknown actuator, a wrong shape, or a value that is not finite.
        """
        if self._latest is None:
            raise PeerError("there is no sample to answer yet; call reset() first")
        if self._latest.truncated:
            return
        self._sent = (
            self._read_array(values, operations) if isinstance(values, np.ndarray) else self._read(values or {})
        )

    def weather(self, columns: Sequence[str]) -> WeatherSeries:
        """See `FakeBuilding.weather`."""
        return self.building.weather(columns)

    def close(self) -> None:
        """Nothing is held."""

    def __iter__(self) -> Iterator[SampleView]:
        """Samples from the present one to the episode's last; one that was not answered keeps all as it is."""
        sample = self._latest if self._latest is not None and not self._latest.truncated else self.reset()
        while True:
            yield sample
            if sample.truncated:
                return
            if self._sent is None:
                self.send()
            sample = self.receive()

    def _read_array(self, values: Floats, operations: bytes | None) -> tuple[Floats, Floats]:
        if values.shape != self._held.shape:
            raise InvalidAction(f"values of shape {values.shape}; {self._held.shape} expected: one for each actuator")
        kinds = (
            np.full(values.shape, float(CommandOp.SET))
            if operations is None
            else np.frombuffer(operations, np.uint8).astype(float)
        )
        return values.astype(np.float64), kinds

    def _read(self, values: Mapping[str, float | None]) -> tuple[Floats, Floats]:
        row, kinds = np.zeros_like(self._held), np.full_like(self._held, float(CommandOp.KEEP))
        for name, value in values.items():
            if name not in self._actuators:
                raise InvalidAction(f"node 'fake' has no actuator {name!r}; {did_you_mean(name, self._actuators)}")
            if value is not None and not np.isfinite(value):
                raise InvalidAction(f"{name} = {value}; a finite number or None (release) expected")
            index = self._actuators[name]
            row[index], kinds[index] = (0.0, CommandOp.RELINQUISH) if value is None else (value, CommandOp.SET)
        return row, kinds

    def _refuse(self, values: Floats, kinds: Floats) -> None:
        for index in np.flatnonzero((kinds == CommandOp.SET) & ~((values >= self._low) & (values <= self._high))):
            actuator = self.manifest.actuators[index]
            value = with_unit(f"{values[index]:g}", actuator.unit)
            said = f"{actuator.name} = {value}; its bounds are {actuator.low} to {actuator.high}"
            raise RequestRejected(f"node 'fake' did not take the command: {said}")

    def _sample(self, values: Floats, effective: Floats) -> SampleView:
        building = self.building
        last = building.step == self.manifest.steps
        wire = Sample(
            episode=[self._episode],
            step=[building.step],
            time=[building.now.isoformat()],
            elapsed_s=[building.step * building.run.step_s],
            flags=[(Flag.NONE if building.step else Flag.FIRST) | (Flag.TRUNCATED if last else Flag.NONE)],
            values=values.astype("<f8").tobytes(),
            effective=effective.astype("<f8").tobytes(),
            source_index=np.where(np.isnan(self._held), 0, 1).astype("<u2").tobytes(),
            sources=["", self.name],
        )
        self._latest = SampleView(wire, self.manifest, self._names, self)
        return self._latest
