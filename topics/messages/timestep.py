"""Messages of each timestep: samples, commands and writes."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from zenostat.topics.messages.base import Count, Finite, Message, Priority, Raw, SourceName


class Sample(Message):
    """The values of all points at one step. Lists have one entry per slot; most nodes have one slot only.

    `values`: the sensors, then the meters. `effective`: the effective value of each actuator during the timestep that
    ends with this sample; NaN where EnergyPlus has no variable that reports it. `commanded`: the value of the command
    that was in effect for each actuator in that timestep, before injected faults; NaN where it was relinquished.
    `source_index`: the value source of
    each actuator, an index into `sources`; `sources[0]` is baseline control. `baseline`: the values, in the order of
    `values`, of the same building under baseline control since sample 0; `baseline_effective`: the effective values of
    its actuators; both are empty unless the manifest's `baseline` is true. `fault_free_values`: the plant's own values,
    in the order of `values`, where faults are injected into `values`.
    """

    episode: list[Count]
    step: list[Count]
    time: list[str]
    elapsed_s: list[float]
    flags: list[int]
    values: bytes
    effective: bytes
    commanded: bytes = b""
    source_index: bytes
    sources: list[str]
    late: Count = 0
    rejected: Count = 0
    baseline: bytes = b""
    baseline_effective: bytes = b""
    fault_free_values: bytes = b""


class Command(Message):
    """A controller's answer to sample `step` of `episode`; it takes effect in timestep `step + 1`.

    A slot whose step is None is not answered: it does not step while the others do.

    `values` has all actuators of all slots. `operations` (one `CommandOp` byte per value) selects which of them are
    set, kept or relinquished; without it, all are set. `values` is the last field, so that a command's bytes are a
    predictable head followed by the values, and the node need not decode it (`codec.CommandHead`).
    """

    episode: list[Count]
    step: list[Count | None]
    operations: Raw | None = None
    values: Raw


class Write(Message):
    """One actuator's value, written by a device or a person; a `value` of None relinquishes it.

    `priority`: as in BACnet, 1 is the highest, 16 the lowest and 8 that of manual operators. `duration_s`: seconds of
    simulated time after which the value is relinquished automatically.
    """

    value: Finite | None
    priority: Priority = 8
    duration_s: Annotated[float, Field(gt=0, strict=True)] | None = None
    source: SourceName = ""


class PointValue(Message):
    """The value of one point at one step, for dashboards and devices that need no full sample."""

    value: float
    unit: str
    episode: Count
    step: Count
    time: str


class StreamedMessage(Message):
    """A message as it was sent: its topic below the node's root (`sample`, `event` or `manifest`) and its payload."""

    topic: str
    payload: Raw


class Batch(Message):
    """The messages that a node has streamed since its last batch, in the order sent; for recorders and monitors."""

    messages: list[StreamedMessage]
