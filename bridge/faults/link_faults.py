"""Faults of the link: how late each message comes, once, twice or never.

Each controller's commands, and the samples, are a flow of their own: the random numbers of one do not depend on how
many messages another has. Messages of a flow do not overtake each other, but for those that are held back.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from bridge.faults.random_streams import Distribution, EpisodeKeys, RandomStream, flow_key
from bridge.faults.schedule import FaultSchedule, FaultTransition, StepGrid
from topics.fault_plan import Duplicate, FaultPlan, Jitter, Latency, LinkFault, Loss, Reorder

_SAMPLES = ""  # no controller has this name


@dataclass(slots=True)
class _Flow:
    """One flow's faults by row, with the numbers of each; how many messages it has had, and when its last is due."""

    faults: list[tuple[int, Any, RandomStream]]
    number: int = 0
    last_due_s: float = field(default=-np.inf)


class LinkFaults:
    """The faults of a node's link.

    Args:
        step_s: length of a timestep.
        begin: simulated time of sample 0.
        end: of the last sample, if windows after it are to be refused.

    Attributes:
        counts: of each fault, the messages that it hit.

    Raises:
        InvalidConfig: windows without a sample; all of them.
    """

    def __init__(self, plan: FaultPlan, *, step_s: float, begin: datetime, end: datetime | None = None) -> None:
        self.plan = plan
        self._episodes = EpisodeKeys(1)
        self._windows = FaultSchedule(plan, LinkFault, StepGrid(step_s, begin, end), self._episodes)
        self._flows: dict[str, _Flow] = {}
        self.counts: Counter[str] = Counter(dict.fromkeys(self._windows.names, 0))
        self.disturbs_samples = any(fault.samples for fault in self._windows.faults)
        self.disturbs_commands = any(fault.commands for fault in self._windows.faults)

    def reset(self, seed: int | None = None) -> None:
        """A new episode; the same seed gives the same sequence of episodes. What is on its way stays so."""
        self._windows.reset([0])
        self._episodes.turn([0], [seed])
        for flow in self._flows.values():
            flow.number = 0

    def move(self, step: int) -> None:
        """The node is at this step (of slot 0) now: windows begin and end with simulated time.

        Before it was told so, also after a reset, no fault is on.
        """
        self._windows.move([step])

    def drain_transitions(self) -> list[FaultTransition]:
        """What began or ended since this was asked last."""
        return self._windows.drain_transitions()

    def outgoing(self, now_s: float) -> list[float]:
        """Of a sample that is sent now, how many seconds later each copy of it comes.

        Args:
            now_s: of any clock that never goes back.

        Returns:
            `[0.0]` as a rule, `[]` if it is lost, two for a duplicate.
        """
        return self._delays(_SAMPLES, now_s) if self.disturbs_samples else [0.0]

    def incoming(self, controller: str, now_s: float) -> list[float]:
        """The same of a command of a controller that has claimed something."""
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
                            self.plan.seed, (*self._windows.keys[row], *key), Distribution.UNIFORM, 1, self._episodes
                        ),
                    )
                    for row, fault in enumerate(self._windows.faults)
                    if (fault.samples if name == _SAMPLES else any(fnmatchcase(name, p) for p in fault.commands))
                ]
            )
        return flow

    def _hits(self, flow: _Flow) -> Iterator[tuple[Any, float]]:
        """The faults that the next message of a flow meets, each with its number from 0 to 1."""
        number = np.array([flow.number], np.int64)
        flow.number += 1
        for row, fault, draws in flow.faults:
            if self._windows.on[row, 0]:
                drawn = float(draws.at(number)[0, 0])
                if drawn < getattr(fault, "probability", 1.0):
                    self.counts[self._windows.names[row]] += 1
                    yield fault, drawn

    def _delays(self, name: str, now_s: float) -> list[float]:
        flow = self._flow(name)
        delay_s, held_s, copies, lost = 0.0, 0.0, 1, False
        for fault, drawn in self._hits(flow):
            match fault:
                case Latency():
                    delay_s += fault.delay_ms / 1000.0
                case Jitter():
                    delay_s += drawn * fault.jitter_ms / 1000.0
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

    def state(self) -> dict[str, Any]:
        """Where the faults stand, as plain data; messages on their way are not in it."""
        flows = {name: flow.number for name, flow in self._flows.items()}
        return {"episode": self._episodes.keys[0], "windows": self._windows.state(0), "flows": flows}

    def restore(self, state: dict[str, Any]) -> None:
        """Goes back to where they stood, with the same plan; `counts` go on."""
        self._episodes.put(0, state["episode"])
        self._windows.restore(0, state["windows"])
        for flow in self._flows.values():
            flow.number = 0
        for name, number in state["flows"].items():
            self._flow(name).number = number
