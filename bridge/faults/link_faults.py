"""Link faults: delayed, duplicated, reordered and lost messages.

The samples and each controller's commands are separate flows: the random numbers of one do not depend on the number of
messages in another. Messages of a flow stay in order, except for reordered ones.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from zenostat.bridge.faults.random_streams import Distribution, EpisodeKeys, RandomStream, flow_key
from zenostat.bridge.faults.schedule import FaultSchedule, FaultTransition, StepGrid
from zenostat.topics.fault_plan import Duplicate, FaultPlan, Jitter, Latency, LinkFault, Loss, Reorder

_SAMPLES = ""  # no controller has this name


@dataclass(slots=True)
class _Flow:
    """A flow: its faults with their rows and random numbers, its message count, and when its last message is due."""

    faults: list[tuple[int, Any, RandomStream]]
    number: int = 0
    last_due_s: float = field(default=-np.inf)


class LinkFaults:
    """The link faults of a node.

    Args:
        plan: the fault plan.
        step_s: length of a timestep in seconds.
        begin: simulated time of sample 0.
        end: simulated time of the last sample; if it is given, faults that could only be active after it are errors.

    Attributes:
        counts: of each fault, the number of messages that it affected.

    Raises:
        InvalidConfig: faults that are active at no sample; the text names all of them.
    """

    def __init__(self, plan: FaultPlan, *, step_s: float, begin: datetime, end: datetime | None = None) -> None:
        self.plan = plan
        self._episodes = EpisodeKeys(1)
        self._schedule = FaultSchedule(plan, LinkFault, StepGrid(step_s, begin, end), self._episodes)
        self._flows: dict[str, _Flow] = {}
        self.counts: Counter[str] = Counter(dict.fromkeys(self._schedule.names, 0))
        self.disturbs_samples = any(fault.samples for fault in self._schedule.faults)
        self.disturbs_commands = any(fault.commands for fault in self._schedule.faults)

    def reset(self, seed: int | None = None) -> None:
        """Begin a new episode; equal seeds give equal sequences of episodes. Delayed messages are still delivered."""
        self._schedule.reset([0])
        self._episodes.advance([0], [seed])
        for flow in self._flows.values():
            flow.number = 0

    def move(self, step: int) -> None:
        """Set the current step of slot 0, on which the activity of faults depends.

        No fault is active before the first call and after a reset.
        """
        self._schedule.move([step])

    def drain_transitions(self) -> list[FaultTransition]:
        """Return the faults that became active or inactive since the last call."""
        return self._schedule.drain_transitions()

    def outgoing(self, now_s: float) -> list[float]:
        """Return the delay in seconds of each copy of a sample that is sent now.

        Args:
            now_s: time of any monotonic clock.

        Returns:
            Usually `[0.0]`; `[]` for a lost sample, two delays for a duplicate.
        """
        return self._delays(_SAMPLES, now_s) if self.disturbs_samples else [0.0]

    def incoming(self, controller: str, now_s: float) -> list[float]:
        """Return the delays of the copies of a command from a controller with a claim; like `outgoing`."""
        return self._delays(controller, now_s) if self.disturbs_commands else [0.0]

    def _flow(self, name: str) -> _Flow:
        flow = self._flows.get(name)
        if flow is None:
            key = flow_key(name)
            flow = self._flows[name] = _Flow(
                [
                    (
                        row,
                        fault,
                        RandomStream(
                            self.plan.seed, (*self._schedule.keys[row], *key), Distribution.UNIFORM, 1, self._episodes
                        ),
                    )
                    for row, fault in enumerate(self._schedule.faults)
                    if (fault.samples if name == _SAMPLES else any(fnmatchcase(name, p) for p in fault.commands))
                ]
            )
        return flow

    def _hits(self, flow: _Flow) -> Iterator[tuple[Any, float]]:
        """Yield the faults that affect the next message of a flow, each with its random number from 0 to 1."""
        message = np.array([flow.number], np.int64)
        flow.number += 1
        for row, fault, stream in flow.faults:
            if self._schedule.on[row, 0]:
                number = float(stream.at(message)[0, 0])
                if number < getattr(fault, "probability", 1.0):
                    self.counts[self._schedule.names[row]] += 1
                    yield fault, number

    def _delays(self, name: str, now_s: float) -> list[float]:
        flow = self._flow(name)
        delay_s, held_s, copies, lost = 0.0, 0.0, 1, False
        for fault, number in self._hits(flow):
            match fault:
                case Latency():
                    delay_s += fault.delay_ms / 1000.0
                case Jitter():
                    delay_s += number * fault.jitter_ms / 1000.0
                case Reorder():
                    held_s += fault.hold_ms / 1000.0
                case Duplicate():
                    copies += 1
                case Loss():
                    lost = True
        if lost:
            return []
        delay_s = max(delay_s, flow.last_due_s - now_s)
        if held_s:
            return [delay_s + held_s] * copies
        flow.last_due_s = now_s + delay_s
        return [delay_s] * copies

    def adopt(self, other: LinkFaults) -> bool:
        """Take over the state of the faults that are equal to one of another plan; return whether there are any."""
        rows = self._schedule.adopt(other._schedule)
        for own, theirs in rows.items():
            self.counts[self._schedule.names[own]] = other.counts[other._schedule.names[theirs]]
        if rows:
            for name, flow in other._flows.items():
                self._flow(name).number, self._flow(name).last_due_s = flow.number, flow.last_due_s
        return bool(rows)

    def state(self) -> dict[str, Any]:
        """Return the state of the faults as built-in types, without delayed messages."""
        flows = {name: flow.number for name, flow in self._flows.items()}
        return {"episode": self._episodes.keys[0], "windows": self._schedule.state(0), "flows": flows}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore a state of the same plan; `counts` continue."""
        self._episodes.put(0, state["episode"])
        self._schedule.restore(0, state["windows"])
        for flow in self._flows.values():
            flow.number = 0
        for name, number in state["flows"].items():
            self._flow(name).number = number
