"""The schedule of simulated time against the wall clock. Rules without a clock: whoever asks says what time it is."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class StepSchedule:
    """Which timestep is due when: on an absolute schedule, so that no drift grows.

    The timestep after sample k ends one step's length after sample k did: that is when it is simulated, with what is
    commanded by then, and when sample k + 1 is due.

    Args:
        step_s: length of a timestep, in simulated seconds.
        speed: simulated seconds in a second.

    Attributes:
        overruns: timesteps whose sample came when the next one was due already.
        max_lag_s: by how much at worst.
    """

    step_s: float
    speed: float = 1.0
    overruns: int = 0
    max_lag_s: float = 0.0
    _origin_s: float = 0.0
    _origin_step: int = 0

    def rebase(self, now_s: float, step: int, into_s: float = 0.0) -> None:
        """The schedule begins anew: at `now_s`, `into_s` simulated seconds have gone by since the sample `step`."""
        self._origin_s, self._origin_step = now_s - into_s / self.speed, step

    def elapsed_in_step_s(self, now_s: float, step: int) -> float:
        """How many simulated seconds have gone by since the sample `step`: a timestep at most."""
        return min(max((now_s - self.due_s(step)) * self.speed, 0.0), self.step_s)

    def due_s(self, step: int) -> float:
        """When the sample `step` is due."""
        return self._origin_s + (step - self._origin_step) * self.step_s / self.speed

    def record_sample(self, now_s: float, step: int) -> bool:
        """Notes when a sample came; whether the next one was due by then."""
        late_s = now_s - self.due_s(step + 1)
        if late_s <= 0.0:
            return False
        self.overruns += 1
        self.max_lag_s = max(self.max_lag_s, now_s - self.due_s(step))
        return True
