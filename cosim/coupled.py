"""A coupled plant, as the orchestrator steps it, and what happens when its node is lost."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import monotonic
from typing import Protocol

import numpy as np

from zenostat.cosim.file import OnLost
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import BusError, EngineDied, ForkFailed, PeerError, SimulatorError
from zenostat.topics.messages import Manifest

LOST = (BusError, PeerError, SimulatorError)
"""Errors after which a plant's episode cannot go on."""

_RETRY_S = 0.5
_MAX_FAILURES = 3
"""Number of times that a simulator may fail in a trial, or while its plant is brought back to the present step."""


@dataclass(frozen=True, slots=True)
class Rows:
    """The samples of the timesteps of a step of the district.

    Attributes:
        values: of sensors, then meters, shape (timesteps, points).
        effective: of the actuators, shape (timesteps, actuators); NaN: unknown.
    """

    values: Floats
    effective: Floats


@dataclass(frozen=True, slots=True)
class PlantState:
    """State of a coupled plant's guard in its episode.

    Attributes:
        history: commands of each step so far.
        seed: of the episode.
        last: the latest samples.
    """

    history: tuple[Floats, ...]
    seed: int
    last: Rows


class CoupledPlant(Protocol):
    """A plant of a district: it steps, and tries a step.

    Commands have the shape (timesteps, actuators); NaN relinquishes an actuator. All methods are for one thread, unless
    noted. They raise one of `LOST` if the episode cannot go on.
    """

    @property
    def manifest(self) -> Manifest:
        """Manifest of its node."""

    def reset(self, seed: int) -> Rows:
        """Begin an episode, in a new process if the previous one has ended; return sample 0 as one timestep."""

    def begin(self, commands: Floats) -> None:
        """Begin timesteps; `finish` returns their samples."""

    def finish(self) -> Rows:
        """Wait for the timesteps that `begin` began."""

    def begin_trial(self, commands: Sequence[Floats]) -> None:
        """Begin to simulate timesteps on a copy for each of several alternatives; a trial that is not finished is lost.

        Args:
            commands: of each alternative, all equally long.
        """

    def finish_trial(self) -> list[Rows]:
        """Wait for the trial that `begin_trial` began, and return the samples of each alternative.

        Raises:
            ForkFailed: the plant cannot be copied; its episode can go on.
        """

    def cancel_trial(self) -> None:
        """Make `finish_trial` raise soon, although the copies may still be simulated; thread-safe."""

    def is_reachable(self) -> bool:
        """Return whether its node is there, perhaps as a new one; does not wait for the answer."""

    def drain_warnings(self) -> list[str]:
        """Return texts about the plant since the last call."""

    def interrupt(self) -> None:
        """Make a running call raise soon; thread-safe."""

    def close(self) -> None:
        """End it; idempotent."""


class GuardedPlant:
    """A coupled plant with a reaction to its loss.

    A plant that comes back is brought to the present step: an episode with the same seed gets the same commands. It
    then continues as if it had not been lost, to the bit.

    Args:
        name: in the district.
        plant: the plant.
        on_lost: the reaction.
        timeout_s: longest wait for a plant to come back, in wall time.
        stop: set when the district is to end.
        retry: called between two attempts; waits.

    Attributes:
        is_available: whether the latest values are the plant's own, not held ones.
        is_tried: the same for its latest trials.
        waiting: why the district waits for it; empty if it does not, or just because the plant computes.
        on_waiting: called with each new reason, in the thread that waits.
    """

    def __init__(
        self,
        name: str,
        plant: CoupledPlant,
        on_lost: OnLost,
        *,
        timeout_s: float,
        stop: threading.Event,
        retry: Callable[[threading.Event], object] = lambda stop: stop.wait(_RETRY_S),
    ) -> None:
        self.name, self.plant = name, plant
        self._on_lost, self._timeout_s, self._stop, self._retry = on_lost, timeout_s, stop, retry
        self.is_available = self.is_tried = True
        self._history: list[Floats] = []
        self._seed = 0
        self._last: Rows
        self._last_step = 0  # of the district, with the latest samples
        self._error: Exception | None = None
        self._tried: Sequence[Floats] = ()
        self._trial_error: Exception | None = None
        self._warnings: list[str] = []
        self._latest_warning = ""
        self.waiting = self._reported = ""
        self.on_waiting: Callable[[str], None] = lambda _: None

    def reset(self, seed: int) -> Rows:
        """Begin an episode; `EngineDied` if the plant cannot."""
        self._history, self._seed, self._error, self._last_step = [], seed, None, 0
        self.is_available = self.is_tried = True
        self.waiting = self._reported = ""
        try:
            self._last = self.plant.reset(seed)
        except LOST as error:
            raise self._failure(error) from None
        return self._last

    def capture(self) -> PlantState:
        """Return what is remembered of the episode."""
        return PlantState(tuple(self._history), self._seed, self._last)

    def adopt(self, state: PlantState) -> None:
        """Continue from a state that `capture` returned, to which the plant has returned."""
        self._history, self._seed = [*state.history], state.seed
        self._keep(state.last)
        self._error = None
        self.is_available = self.is_tried = True

    def begin(self, commands: Floats) -> None:
        """Begin the timesteps of a step, unless the plant is lost."""
        self._history.append(commands)
        if not self.is_available:
            return
        try:
            self.plant.begin(commands)
        except LOST as error:
            self._error = error

    def finish(self) -> Rows:
        """Wait for these timesteps; of a plant that is lost, wait for it, hold its last values, or raise.

        Raises:
            EngineDied: the plant is lost and the district stops.
        """
        if not self.is_available:
            return self._look_for()
        error, self._error = self._error, None
        if error is None:
            try:
                return self._keep(self.plant.finish())
            except LOST as lost:
                error = lost
        return self._react(error)

    def begin_trial(self, commands: Sequence[Floats]) -> None:
        """Begin to try timesteps for each of several alternatives, unless the plant is lost."""
        self._tried, self._trial_error, self.is_tried = commands, None, self.is_available
        if not self.is_available:
            return
        try:
            self.plant.begin_trial(commands)
        except LOST as error:
            self._trial_error = error

    def finish_trial(self) -> list[Rows]:
        """Wait for this trial; a plant that is lost returns its last values, one whose copies fail NaN.

        Raises:
            ForkFailed: the plant cannot be copied.
            EngineDied: the plant is lost and the district stops, or is lost again whenever it is back.
        """
        for _ in range(_MAX_FAILURES):
            if not self.is_available:
                return self._held_trial()
            error, self._trial_error = self._trial_error, None
            if error is None:
                try:
                    return self.plant.finish_trial()
                except ForkFailed as failed:
                    raise ForkFailed(f"plant {self.name!r} cannot try a step: {failed}") from None
                except SimulatorError as failed:  # of a copy; if the plant itself failed, its step will say so
                    self._warn_once(f"plant {self.name!r} has no values in a trial: {failed}")
                    return [_undefined(rows) for rows in self._held_trial()]
                except LOST as lost:
                    error = lost
            self._react(error)
            self.begin_trial(self._tried)
        if self._on_lost is OnLost.GO_ON:
            self.is_available = self.is_tried = False
            return self._held_trial()
        raise EngineDied(f"plant {self.name!r} failed {_MAX_FAILURES} times in the same trial: {error}")

    def _held_trial(self) -> list[Rows]:
        return [self._held(len(rows)) for rows in self._tried]

    def drain_warnings(self) -> list[str]:
        """Return texts about the plant since the last call."""
        warnings, self._warnings = [*self._warnings, *self.plant.drain_warnings()], []
        return warnings

    def report_obstacle(self, obstacle: str) -> None:
        """Report what keeps the plant's node from a timestep for which the district waits; empty: nothing known."""
        self._report_waiting(obstacle and f"plant {self.name!r} does not go on: {obstacle}")

    def _report_waiting(self, reason: str) -> None:
        """Keep why the district waits; report a reason that is neither the present one nor that of the last step."""
        is_new = reason not in ("", self.waiting, self._reported)
        self.waiting = reason
        if is_new:
            self.on_waiting(reason)

    def _failure(self, error: Exception) -> SimulatorError:
        return EngineDied(f"plant {self.name!r}: {error}")

    def _held(self, timesteps: int) -> Rows:
        last = self._last
        return Rows(np.tile(last.values[-1], (timesteps, 1)), np.tile(last.effective[-1], (timesteps, 1)))

    def _react(self, error: Exception) -> Rows:
        if self._stop.is_set() or self._on_lost is OnLost.STOP:
            raise self._failure(error) from None
        if self._on_lost is OnLost.GO_ON:
            self.is_available = False
            self._warnings.append(f"plant {self.name!r} is lost, and its last values hold: {error}")
            return self._look_for()
        return self._wait_for(error)

    def _wait_for(self, error: Exception) -> Rows:
        """Bring the plant back; raise after the timeout, or where its simulator fails again and again."""
        until_s, latest, failures = monotonic() + self._timeout_s, error, 0
        while not self._stop.is_set():
            try:
                return self._come_back(f"was lost, and is back at step {len(self._history)}: {error}")
            except LOST as again:
                latest = again
                failures += isinstance(again, SimulatorError)
            if failures >= _MAX_FAILURES or monotonic() >= until_s:
                raise EngineDied(
                    f"plant {self.name!r} is lost ({error}), and did not come back within {self._timeout_s:g} s or "
                    f"{_MAX_FAILURES} attempts: {latest}"
                ) from None
            self._report_waiting(f"plant {self.name!r} is lost, and the district waits for it: {error}")
            self._retry(self._stop)
        raise self._failure(latest) from None

    def _look_for(self) -> Rows:
        """Return the last values of a plant that is lost, or its own if it is back."""
        timesteps = len(self._history[-1]) if self._history else 1
        if self.plant.is_reachable():
            try:
                return self._come_back(f"is back at step {len(self._history)}")
            except LOST as error:
                self._warn_once(f"plant {self.name!r} cannot come back, and its last values hold: {error}")
        return self._held(timesteps)

    def _warn_once(self, text: str) -> None:
        """Add a warning that is not that of the step before."""
        if text != self._latest_warning:
            self._warnings.append(text)
        self._latest_warning = text

    def _come_back(self, text: str) -> Rows:
        """Begin the episode again, with the same seed and commands up to the present step.

        Args:
            text: of the event, after the plant's name.
        """
        rows = repeated = self.plant.reset(self._seed)
        for step, commands in enumerate(self._history, 1):
            if self._stop.is_set():
                raise EngineDied("the district ends")
            self.plant.begin(commands)
            rows = self.plant.finish()
            if step == self._last_step:
                repeated = rows
        self._warnings.append(f"plant {self.name!r} {text}")
        if not _is_equal(repeated, self._last):
            self._warnings.append(
                f"plant {self.name!r} has other values in step {self._last_step} than before it was lost: the district "
                "repeats only its own commands, and not those of others on the plant's bus"
            )
        self.is_available, self._latest_warning = True, ""
        return self._keep(rows)

    def _keep(self, rows: Rows) -> Rows:
        """Keep the samples of the present step, and return them."""
        self._last, self._last_step = rows, len(self._history)
        self._reported, self.waiting = self.waiting, ""
        return rows


def _is_equal(rows: Rows, others: Rows) -> bool:
    """Return whether the last samples are equal."""
    pairs = ((rows.values, others.values), (rows.effective, others.effective))
    return all(np.array_equal(one[-1], other[-1], equal_nan=True) for one, other in pairs)


def _undefined(rows: Rows) -> Rows:
    return Rows(np.full_like(rows.values, np.nan), np.full_like(rows.effective, np.nan))


class RepeatedPlant(GuardedPlant):
    """A plant whose last values hold in the steps in which they did in a recording, since it was lost.

    It ends the verification if it is lost itself.

    Args:
        name, plant, stop: see `GuardedPlant`.
    """

    def __init__(self, name: str, plant: CoupledPlant, stop: threading.Event) -> None:
        super().__init__(name, plant, OnLost.STOP, timeout_s=0.0, stop=stop)
        self._is_expected = self._is_tried_expected = True

    def expect(self, *, available: bool, tried: bool) -> None:
        """Set whether the values of the next step are the plant's own, and those of its trials."""
        self._is_expected, self._is_tried_expected = available, tried

    def begin(self, commands: Floats) -> None:
        """Begin the timesteps of a step, unless its values are held or the plant has to be brought back first."""
        if self.is_available and self._is_expected:
            super().begin(commands)
        else:
            self._history.append(commands)

    def finish(self) -> Rows:
        """Return the samples of these timesteps, or the last values."""
        if not self._is_expected:
            self.is_available = False
            return self._held(len(self._history[-1]))
        if self.is_available:
            return super().finish()
        try:
            return self._come_back(f"is back at step {len(self._history)}")
        except LOST as error:
            raise self._failure(error) from None

    def begin_trial(self, commands: Sequence[Floats]) -> None:
        """Begin to try timesteps, unless the last values are to hold."""
        if self.is_available and self._is_tried_expected:
            super().begin_trial(commands)
        else:
            self._tried, self.is_tried = commands, False

    def finish_trial(self) -> list[Rows]:
        """Return the samples of the trial, or the last values for each alternative."""
        if self.is_available and self._is_tried_expected:
            return super().finish_trial()
        return self._held_trial()
