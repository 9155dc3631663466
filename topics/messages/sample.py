"""Samples, commands and writes: the messages of each timestep."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from topics.messages.base import ANONYMOUS, Count, Finite, Message, Priority, Raw, SourceName


class Sample(Message):
    """One frame a step. Lists have an entry a slot; slot 0 is the only one of a plain node.

    `values` are the sensors, then the meters. `effective` says what each actuator really was in the
    timestep that this sample closes; NaN where EnergyPlus has no variable that tells. `source_index` is an
    index into `sources`: who set it, with `sources[0]` the building's own control. `baseline`, like `values`, is the
    same building under its baseline control since sample 0, and `baseline_effective`, like `effective`, what that
    control set its actuators to; empty unless the manifest says so. `fault_free_values`, like `values`, are the
    plant's own where faults are injected into `values`.
    """

    episode: list[Count]
    step: list[Count]
    time: list[str]
    elapsed_s: list[float]
    flags: list[int]
    values: bytes
    effective: bytes
    source_index: bytes
    sources: list[str]
    late: Count = 0
    rejected: Count = 0
    baseline: bytes = b""
    baseline_effective: bytes = b""
    fault_free_values: bytes = b""


class Command(Message):
    """A controller's answer to sample `step` of `episode`; it rules timestep `step + 1`.

    A slot whose step is None is not answered: it stands still while the others go on.

    `values` has all actuators of all slots. `operations` (one `CommandOp` byte each) says which of them are
    set, kept as they are, or released; without it all are set. `values` stands last, so that a command's
    bytes are a head that the node can foresee and the values: it needs no decoding (`codec.command_head`).
    """

    episode: list[Count]
    step: list[Count | None]
    operations: Raw | None = None
    values: Raw


class Write(Message):
    """One actuator, written by a device or a person; `value` None releases it.

    `priority` as in BACnet: 1 the highest, 16 the lowest, 8 a person's.
    `duration_s`: seconds of simulated time after which it is released by itself.
    """

    value: Finite | None
    priority: Priority = 8
    duration_s: Annotated[float, Field(gt=0, strict=True)] | None = None
    source: SourceName = ANONYMOUS


class PointValue(Message):
    """One point at one step, for dashboards and devices that want just that."""

    value: float
    unit: str
    episode: Count
    step: Count
    time: str


class StreamedMessage(Message):
    """A message as it was sent: its topic below the root (`sample`, `event` or `manifest`), and its bytes."""

    topic: str
    payload: Raw


class Batch(Message):
    """What a node has streamed since its last batch, in the order sent: for whoever need not know it at once."""

    messages: list[StreamedMessage]
