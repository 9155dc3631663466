"""The status of a node, and its statistics."""

from __future__ import annotations

from pydantic import Field

from zenostat.topics.messages.base import Count, Lines, Message, Priority, SafeName
from zenostat.topics.messages.enums import ControllerState, Mode, Policy, State
from zenostat.topics.messages.recording import RecordingStatus


class LatencySummary(Message):
    """Summary of durations: their count and maximum, and the median and 99th percentile of the latest 4,096."""

    count: Count = 0
    median_ms: float = 0.0
    p99_ms: float = 0.0
    max_ms: float = 0.0


class Statistics(Message):
    """A node's timing, in wall time, and its message counts.

    `step`: from the start of a timestep to its sample. `cycle`: from sample to sample. `overruns`: paced timesteps
    whose sample was published after the next one was due; `max_lag_s`: the largest such delay. `missed`: timesteps
    simulated without a required controller's command. `late`, `rejected`, `duplicate`, `rate_limited`: messages that
    changed nothing. `accepted_late`: commands accepted after the deadline.
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
    """Status of a controller that has a claim.

    `actuators`: number of actuators that it has claimed. `accepted_late`: accepted commands that arrived after the
    deadline. `late`: commands rejected because their step was over. `missed`: timesteps simulated without its command.
    `response`: time from the end of a timestep, just before its sample is published, to the accepted answer.
    """

    controller: str
    priority: Priority
    actuators: Count
    required: bool
    state: ControllerState
    accepted: Count
    late: Count = 0
    rejected: Count = 0
    duplicate: Count = 0
    missed: Count = 0
    accepted_late: Count = 0
    response: LatencySummary = LatencySummary()


class ForkStatus(Message):
    """A snapshot or a branch of a node: its step in slot 0, its number of engines and its private memory."""

    name: str
    owner: str
    step: Count
    engines: Count
    private_bytes: Count


class Status(Message):
    """Status of a node.

    `steps_left`: timesteps that were requested of a paused node and are not simulated yet. `faults`: the injected
    faults that are active now. `engine_private_bytes`, and `private_bytes` of snapshots and branches: memory shared
    with no other process; 0 unless requested. `recording`: the present or the latest recording. `waiting`: why the
    running timestep of a district waits for a plant that does not compute; empty if it does not.
    """

    node: SafeName
    state: State
    building: str
    weather: str
    mode: Mode
    speed: float = 1.0
    paused: bool = False
    steps_left: Count = 0
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
    failure: Lines = ""
    failure_error: str = ""
    node_rss_bytes: Count = 0
    engine_rss_bytes: Count = 0
    engine_private_bytes: Count = 0
    statistics: Statistics = Statistics()
    faults: list[str] = Field(default_factory=list)
    snapshots: list[ForkStatus] = Field(default_factory=list)
    branches: list[ForkStatus] = Field(default_factory=list)
    recording: RecordingStatus | None = None
    waiting: str = ""
