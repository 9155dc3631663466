"""The status of a node, and its statistics."""

from __future__ import annotations

from pydantic import Field

from topics.messages.base import Count, Message, Priority, SafeName
from topics.messages.enums import Mode, Policy, State


class LatencySummary(Message):
    """How long something took: `count` times in all; median and 99th percentile of the latest 4,096; the longest."""

    count: Count = 0
    median_ms: float = 0.0
    p99_ms: float = 0.0
    max_ms: float = 0.0


class Statistics(Message):
    """How a node keeps up, in wall time.

    `step`: from the begin of a timestep to its sample. `cycle`: from sample to sample. `overruns`: paced timesteps
    whose sample came after the next one was due, `max_lag_s` by how much at worst. `missed`: timesteps that went on
    without a required controller. `late`, `rejected`, `duplicate`, `rate_limited`: messages that changed nothing.
    `accepted_late`: commands that were taken although the deadline was over.
    """

    step: LatencySummary = LatencySummary()
    cycle: LatencySummary = LatencySummary()
    overruns: Count = 0
    max_lag_s: float = 0.0
    missed: Count = 0
    late: Count = 0
    rejected: Count = 0
    duplicate: Count = 0
    rate_limited: Count = 0
    accepted_late: Count = 0


class ControllerStatus(Message):
    """One controller that has claimed something.

    `accepted_late`: of the accepted commands, those that came after the deadline; `late`: those that were refused
    because their step was over. `missed`: timesteps that went on without its command. `bypassed`: it has gone, and the
    policy goes on without it.
    `unresponsive`: it gave no command by the deadline, and none since. `response`: from a sample to its answer.
    """

    controller: str
    priority: Priority
    actuators: Count
    required: bool
    connected: bool
    accepted: Count
    late: Count = 0
    rejected: Count = 0
    duplicate: Count = 0
    missed: Count = 0
    bypassed: bool = False
    unresponsive: bool = False
    accepted_late: Count = 0
    response: LatencySummary = LatencySummary()


class ForkStatus(Message):
    """A snapshot or branch of a node: at which sample of slot 0, and the memory that is its own alone."""

    name: str
    owner: str
    step: Count
    engines: Count
    private_bytes: Count


class Status(Message):
    """Where a node stands.

    `faults`: the injected faults that are on now. `engine_private_bytes`, and the `private_bytes` of its forks: what
    they share with no other process; 0 unless asked for.
    """

    node: SafeName
    state: State
    building: str
    weather: str
    mode: Mode
    speed: float = 1.0
    paused: bool = False
    policy: Policy = Policy.WAIT
    episode: list[Count]
    step: list[Count]
    steps: Count
    time: list[str]
    controllers: list[ControllerStatus]
    accepted: Count
    rejected: Count
    late: Count
    duplicate: Count
    failure: str = ""
    failure_error: str = ""
    node_rss_bytes: Count = 0
    engine_rss_bytes: Count = 0
    engine_private_bytes: Count = 0
    statistics: Statistics = Statistics()
    faults: list[str] = Field(default_factory=list)
    snapshots: list[ForkStatus] = Field(default_factory=list)
    branches: list[ForkStatus] = Field(default_factory=list)
