"""The schedule of simulated time against the wall clock, in paced mode. No clock: callers pass the wall time."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class StepSchedule:
    """Due times of timesteps on an absolute schedule, so that delays do not accumulate.

    Sample k + 1 is due one timestep after sample k. Its timestep is simulated then, with the values that are commanded
    by then.

    Args:
        step_s: length of a timestep, in simulated seconds.
        speed: simulated seconds per second of wall time.

    Attributes:
        overruns: timesteps whose sample was published after the next one was due.
        max_lag_s: the largest delay of such a sample.
    """

    step_s: float
    speed: float = 1.0
    overruns: int = 0
    max_lag_s: float = 0.0
    _origin_s: float = 0.0
    _origin_step: int = 0

    def rebase(self, now_s: float, step: int, into_s: float = 0.0) -> None:
        """Restart the schedule: at `now_s`, `into_s` simulated seconds have passed since the sample `step`."""
        self._origin_s, self._origin_step = now_s - into_s / self.speed, step

    def elapsed_in_step_s(self, now_s: float, step: int) -> float:
        """Return the simulated seconds since the sample `step`: at most a timestep."""
        return min(max((now_s - self.due_s(step)) * self.speed, 0.0), self.step_s)

    def due_s(self, step: int) -> float:
        """Return the wall time at which the sample `step` is due."""
        return self._origin_s + (step - self._origin_step) * self.step_s / self.speed

    def record_sample(self, now_s: float, step: int) -> bool:
        """Record the time of a sample; return whether the next one was already due."""
        late_s = now_s - self.due_s(step + 1)
        if late_s <= 0.0:
            return False
        self.overruns += 1
        self.max_lag_s = max(self.max_lag_s, now_s - self.due_s(step))
        return True
