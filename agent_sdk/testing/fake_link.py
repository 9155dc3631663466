"""Connection to a fake building with the interface of `ControllerLink`, in the same process."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from zenostat.agent_sdk.testing.fake_building import FakeBuilding
from zenostat.bridge.client.sample import SampleView
from zenostat.topics.errors import EpisodeChanged, InvalidAction, PeerError, RequestRejected, UsageError
from zenostat.topics.messages import Ack, CommandOp, EngineStart, EpisodeStart, Flag, Sample, WeatherSeries
from zenostat.topics.points import actuator_index, bound_arrays, check_command, describe_violation, value_index

Floats = NDArray[np.float64]


class FakeLink:
    """Receive samples from a fake building and send commands, from an environment or a controller's loop.

    Args:
        building: the fake building; default: `FakeBuilding()`.
        name: name of the controller in `value_source`.

    Attributes:
        manifest: manifest of the building.
        accepted: reply to the latest reset.
    """

    accepted: Ack

    def __init__(self, building: FakeBuilding | None = None, *, name: str = "env") -> None:
        self.building = FakeBuilding() if building is None else building
        self.manifest = self.building.manifest
        self.name = name
        self._names = value_index(self.manifest)
        self._actuators = actuator_index(self.manifest.actuators, InvalidAction)
        self._low, self._high = bound_arrays(self.manifest.actuators)
        self._commanded = np.full(len(self._actuators), np.nan)
        self._latest: SampleView | None = None
        self._sent: tuple[Floats, Floats] | None = None
        self._episode = -1

    def reset(self, *, seed: int | None = None) -> SampleView:
        """Start a new episode under baseline control, and return its sample 0."""
        values = self.building.reset(seed)
        self._episode += 1
        self._commanded[:] = np.nan
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
        return self._sample(values, self.building.baseline_control)

    def receive(self) -> SampleView:
        """Simulate a timestep, and return its sample.

        Raises:
            RequestRejected: a value is out of its actuator's bounds; the building waits for another command.
            ModelError: a heating setpoint is above the cooling setpoint.
            EpisodeChanged: the episode is over.
            PeerError: no command was sent; a real node would wait forever.
        """
        if self._latest is None or self._latest.truncated:
            raise EpisodeChanged("the episode is over; call reset()" if self._latest else "call reset() first")
        if self._sent is None:
            raise PeerError("the present sample is not answered; call send() before receive()")
        (values, operations), self._sent = self._sent, None
        self._check_bounds(values, operations)
        self._commanded = np.where(
            operations == CommandOp.SET, values, np.where(operations == CommandOp.RELINQUISH, np.nan, self._commanded)
        )
        return self._sample(*self.building.advance(self._commanded))

    def send(self, values: Mapping[str, float | None] | Floats | None = None, operations: bytes | None = None) -> None:
        """Answer the present sample; see `ControllerLink.send`.

        Raises:
            InvalidAction: an unknown actuator, a wrong shape, or a value that is not finite.
        """
        if self._latest is None:
            raise UsageError("there is no sample to answer yet; call reset() first")
        if self._latest.truncated:
            return
        self._sent = (
            self._read_array(values, operations) if isinstance(values, np.ndarray) else self._read(values or {})
        )

    def weather(self, columns: Sequence[str], slot: int = 0) -> WeatherSeries:  # noqa: ARG002
        """Return columns of the weather; see `FakeBuilding.weather`."""
        return self.building.weather(columns)

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

    def _read_array(self, values: Floats, operations: bytes | None) -> tuple[Floats, Floats]:
        if values.shape != self._commanded.shape:
            raise InvalidAction(
                f"values of shape {values.shape}; {self._commanded.shape} expected: one for each actuator"
            )
        codes = (
            np.full(values.shape, float(CommandOp.SET))
            if operations is None
            else np.frombuffer(operations, np.uint8).astype(float)
        )
        return values.astype(np.float64), codes

    def _read(self, values: Mapping[str, float | None]) -> tuple[Floats, Floats]:
        row, operations = np.zeros_like(self._commanded), np.full_like(self._commanded, float(CommandOp.KEEP))
        for name, value in values.items():
            index = self._actuators[name]
            check_command(name, value)
            row[index], operations[index] = (0.0, CommandOp.RELINQUISH) if value is None else (value, CommandOp.SET)
        return row, operations

    def _check_bounds(self, values: Floats, operations: Floats) -> None:
        for index in np.flatnonzero((operations == CommandOp.SET) & ~((values >= self._low) & (values <= self._high))):
            reason = describe_violation(self.manifest.actuators[index], values[index])
            raise RequestRejected(f"node 'fake' rejected the command: {reason}")

    def _sample(self, values: Floats, effective: Floats) -> SampleView:
        building = self.building
        last = building.step == self.manifest.steps
        wire = Sample(
            episode=[self._episode],
            step=[building.step],
            time=[building.now.isoformat()],
            elapsed_s=[building.step * building.run_period.step_s],
            flags=[(Flag.NONE if building.step else Flag.FIRST) | (Flag.TRUNCATED if last else Flag.NONE)],
            values=values.astype("<f8").tobytes(),
            effective=effective.astype("<f8").tobytes(),
            commanded=self._commanded.astype("<f8").tobytes(),
            source_index=np.where(np.isnan(self._commanded), 0, 1).astype("<u2").tobytes(),
            sources=["", self.name],
        )
        self._latest = SampleView(wire, self.manifest, self._names, self)
        return self._latest
