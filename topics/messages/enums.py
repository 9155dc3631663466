"""Enumerations used in messages."""

from __future__ import annotations

from enum import IntEnum, IntFlag, StrEnum


class Aggregation(StrEnum):
    """Relation of a sensor's value to its timestep.

    `MEAN` and `SUM` are the values that EnergyPlus reports for the timestep: the time-weighted mean, or the sum, over
    its system timesteps. `INSTANT` is the state at the end of the timestep.
    """

    MEAN = "mean"
    SUM = "sum"
    INSTANT = "instant"


class Mode(StrEnum):
    """Pacing of simulated time.

    `LOCKSTEP`: each timestep waits for the required controllers. `PACED`: simulated time follows the wall clock at a
    multiple of its speed; the last commands stay in effect. `FREE`: the simulation runs as fast as it can.
    """

    LOCKSTEP = "lockstep"
    PACED = "paced"
    FREE = "free"


class Policy(StrEnum):
    """Fallback policy for a controller that is disconnected or sends no valid command in time.

    `WAIT`: wait for it. `HOLD`: continue with its last command. `RELINQUISH`: relinquish what it commanded, to the next
    lower priority or to baseline control. `ABORT`: end the episode.
    """

    WAIT = "wait"
    HOLD = "hold"
    RELINQUISH = "relinquish"
    ABORT = "abort"


class State(StrEnum):
    """State of a node's episode."""

    STARTING = "starting"
    WAITING = "waiting"
    RUNNING = "running"
    ENDED = "ended"
    FAILED = "failed"
    STOPPED = "stopped"


class ControllerState(StrEnum):
    """State of a controller that has a claim.

    `CONNECTED`: present on the bus. `UNRESPONSIVE`: present, but it missed the deadline and has not answered since.
    `DISCONNECTED`: its process or its connection has ended; it keeps its claim. `ABSENT`: disconnected, and it missed
    the deadline and has not answered since. `BYPASSED`: disconnected for longer than the grace period; the fallback
    policy applies, and the node does not wait for it. Under the policy `WAIT`, a controller is not bypassed.
    """

    CONNECTED = "connected"
    UNRESPONSIVE = "unresponsive"
    DISCONNECTED = "disconnected"
    ABSENT = "absent"
    BYPASSED = "bypassed"

    @property
    def is_connected(self) -> bool:
        """Whether the controller is present on the bus."""
        return self in (ControllerState.CONNECTED, ControllerState.UNRESPONSIVE)


class EngineStart(StrEnum):
    """Way in which an episode's engine reached its first sample.

    `REUSED`: it was already waiting at sample 0, unused. `FORKED`: it was forked from an engine that waits at sample 0.
    `PREFETCHED`: it was started while the previous episode ran. `STARTED`: it was newly started. `SNAPSHOT`: it was
    forked from a snapshot, at the snapshot's sample. `RESET`: it was reset, which EnergyPlus cannot be.
    """

    NONE = ""
    REUSED = "reused"
    FORKED = "forked"
    PREFETCHED = "prefetched"
    STARTED = "started"
    SNAPSHOT = "snapshot"
    RESET = "reset"


class Flag(IntFlag):
    """Flags of a sample.

    `FIRST`: sample 0 of an episode. `TRUNCATED`: the last sample of an episode. `FALLBACK`: a required controller sent
    no command for this timestep, and the fallback policy applied.
    """

    NONE = 0
    FIRST = 1
    TRUNCATED = 2
    FALLBACK = 4


class CommandOp(IntEnum):
    """Operation of a command on one actuator at the controller's priority."""

    KEEP = 0
    SET = 1
    RELINQUISH = 2


class TimeField(StrEnum):
    """Field of the simulated clock that an agent can observe, named as in EnergyPlus's data exchange API.

    The fields describe the timestep that ends with a sample (for sample 0, the start of the episode): `hour` is 0 to
    23; `minutes` (1 to 60) and `current_time` (hours of the day, 0 to 24) are the end of the timestep; `day_of_week` is
    1 on Sundays.
    """

    YEAR = "year"
    MONTH = "month"
    DAY_OF_MONTH = "day_of_month"
    DAY_OF_WEEK = "day_of_week"
    DAY_OF_YEAR = "day_of_year"
    HOUR = "hour"
    MINUTES = "minutes"
    CURRENT_TIME = "current_time"
