"""Changes that a page requests: each is checked, sent to the node as this operator, and answered by the node."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Annotated, Any

from pydantic import Field
from typing_extensions import override

from zenostat.bridge.client.bus import Bus
from zenostat.topics import codec
from zenostat.topics.errors import InvalidConfig, NodeNotFound, did_you_mean
from zenostat.topics.fault_plan import FaultPlan
from zenostat.topics.messages import Mode, Reset
from zenostat.topics.messages.base import Seed
from zenostat.topics.plurals import counted
from zenostat.views.room.requests import RoomRequest, Speed, read_body

Alarm = Annotated[str, Field(min_length=1, max_length=300)]
Comment = Annotated[str, Field(max_length=500)]


class Operation(RoomRequest):
    """A change of a node, as a page sends it."""

    def run(self, bus: Bus, node: str, operator: str) -> str:
        """Send it, and return the node's answer in words; `ZenostatError` if the node rejects it."""
        raise NotImplementedError


class Write(Operation):
    """Command an actuator at a priority, for a time; `value` None relinquishes it."""

    point: str
    value: float | None
    priority: Annotated[int, Field(ge=1, le=16)] = 8
    duration_s: Annotated[float, Field(gt=0)] | None = None

    @override
    def run(self, bus: Bus, node: str, operator: str) -> str:
        duration_s = None if self.value is None else self.duration_s
        ack = bus.write(node, self.point, self.value, priority=self.priority, duration_s=duration_s, source=operator)
        return ack.text


class Pause(Operation):
    """Pause the node."""

    @override
    def run(self, bus: Bus, node: str, operator: str) -> str:
        bus.pause(node, source=operator)
        return "paused"


class Resume(Operation):
    """Resume the node."""

    @override
    def run(self, bus: Bus, node: str, operator: str) -> str:
        bus.resume(node, source=operator)
        return "resumed"


class Step(Operation):
    """Simulate some timesteps of a paused node."""

    steps: Annotated[int, Field(ge=1, le=10_000)] = 1

    @override
    def run(self, bus: Bus, node: str, operator: str) -> str:
        bus.step(node, self.steps, source=operator)
        return counted(self.steps, "timestep")


class Pace(Operation):
    """Change the mode, or the speed in paced mode."""

    mode: str = "paced"
    speed: Speed | None = None

    @override
    def run(self, bus: Bus, node: str, operator: str) -> str:
        bus.pace(node, self.speed, mode=self.mode, source=operator)
        return f"{self.speed:g} times the wall clock" if self.speed is not None else Mode(self.mode).value


class ResetNode(Operation):
    """Begin a new episode in all slots."""

    seed: Seed | None = None

    @override
    def run(self, bus: Bus, node: str, operator: str) -> str:
        ack = bus.reset(node, Reset(controller=operator, seed=self.seed))
        return f"episode {ack.episode[0]} begins"


class Acknowledge(Operation):
    """Acknowledge alarms of slot 0, which the page shows."""

    alarm: Alarm
    comment: Comment = ""

    @override
    def run(self, bus: Bus, node: str, operator: str) -> str:
        return bus.acknowledge(node, self.alarm, slot=0, source=operator, comment=self.comment).text


class Shelve(Operation):
    """Shelve alarms of slot 0 for some simulated seconds."""

    alarm: Alarm
    duration_s: Annotated[float, Field(gt=0)]
    comment: Comment = ""

    @override
    def run(self, bus: Bus, node: str, operator: str) -> str:
        return bus.shelve(node, self.alarm, self.duration_s, slot=0, source=operator, comment=self.comment).text


class Unshelve(Operation):
    """End the shelving of alarms of slot 0."""

    alarm: Alarm
    comment: Comment = ""

    @override
    def run(self, bus: Bus, node: str, operator: str) -> str:
        return bus.unshelve(node, self.alarm, slot=0, source=operator, comment=self.comment).text


class Faults(Operation):
    """Replace the injected faults; an empty list ends all of them.

    `replaces`: the plan that the page shows, unless it does not matter; the node's present one has to be equal.
    """

    plan: dict[str, Any]
    replaces: dict[str, Any] | None = None

    @override
    def run(self, bus: Bus, node: str, operator: str) -> str:
        plan = codec.validated(FaultPlan, self.plan)
        if self.replaces is not None:
            shown, present = codec.validated(FaultPlan, self.replaces), bus.fault_plan(node)
            if (shown.seed, shown.faults) != (present.seed, present.faults):
                raise InvalidConfig("the faults have changed in the meantime: look at the list, and try again")
        bus.faults(node, plan, source=operator)
        names = ", ".join(plan.names)
        return f"injected from the next sample on: {names}" if names else "no fault is injected any more"


class Record(Operation):
    """Record to a new file on the node's machine, at once or from the next reset."""

    path: Annotated[str, Field(min_length=1, max_length=4096)]
    now: bool = True

    @override
    def run(self, bus: Bus, node: str, operator: str) -> str:
        if not PurePosixPath(self.path).is_absolute():
            raise InvalidConfig(f"{self.path}: an absolute path on the node's machine expected, such as /tmp/run.mcap")
        path = bus.record(node, self.path, now=self.now, source=operator).path
        return f"recording to {path}" if self.now else f"the next reset begins a recording to {path}"


class StopRecording(Operation):
    """End the recording."""

    @override
    def run(self, bus: Bus, node: str, operator: str) -> str:
        return f"recorded to {bus.stop_recording(node, source=operator).path}"


OPERATIONS: Mapping[str, type[Operation]] = {
    "write": Write,
    "pause": Pause,
    "resume": Resume,
    "step": Step,
    "pace": Pace,
    "reset": ResetNode,
    "acknowledge": Acknowledge,
    "shelve": Shelve,
    "unshelve": Unshelve,
    "faults": Faults,
    "record": Record,
    "stop_recording": StopRecording,
}
"""The changes by the last part of their address."""


def read_operation(name: str, body: bytes) -> Operation:
    """Return a checked operation.

    Raises:
        NodeNotFound: there is no operation of that name.
        InvalidConfig: the body has other fields, or values out of range.
    """
    if name not in OPERATIONS:
        raise NodeNotFound(f"no operation {name!r}; {did_you_mean(name, OPERATIONS)}")
    return read_body(OPERATIONS[name], body)
