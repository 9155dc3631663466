"""Requests on the pace of a node: its mode, pause, resume and single steps."""

from __future__ import annotations

from zenostat.bridge.client.requests import Requests, build
from zenostat.topics import keys
from zenostat.topics.messages import Ack, Mode, Pause, Resume, SetPace, StepRequest


class PaceRequests(Requests):
    """Base class of `Bus`: requests on the pace of a node."""

    def pace(self, node: str, speed: float | None = None, *, mode: Mode | str = Mode.PACED, source: str = "") -> None:
        """Set a node's mode: what decides when it simulates the next timestep.

        Args:
            node: The node's name.
            speed: Simulated seconds per second, above 0 and at most 1e9; only with `paced`.
            mode: `lockstep` (required controllers), `paced` (the wall clock) or `free` (nothing; full speed).
            source: Name of the requester, for the event that reports the change.

        Raises:
            InvalidConfig: Unknown mode, or speed out of range.
            RequestRejected: `paced` without a speed, or another mode with one.
        """
        self._ask(keys.PACE, node, build(SetPace, mode=mode, speed=speed, source=source), Ack)

    def pause(self, node: str, *, source: str = "") -> None:
        """Pause a node, in any mode; return once it is paused."""
        self._ask(keys.PAUSE, node, build(Pause, source=source), Ack)

    def resume(self, node: str, *, source: str = "") -> None:
        """Resume a paused node from its current timestep; it does not catch up."""
        self._ask(keys.RESUME, node, build(Resume, source=source), Ack)

    def step(self, node: str, steps: int = 1, *, source: str = "") -> None:
        """Let a paused node simulate some timesteps: in lockstep as soon as they are answered, else at once.

        Raises:
            InvalidConfig: `steps` is not from 1 to 1,000,000.
            RequestRejected: The node is not paused.
        """
        self._ask(keys.STEP, node, build(StepRequest, steps=steps, source=source), Ack)
