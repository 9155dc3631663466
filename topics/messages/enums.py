"""Enumerations of the messages."""

from __future__ import annotations

from enum import IntEnum, IntFlag, StrEnum


class Aggregation(StrEnum):
    """How a sensor is read over a timestep.

    `MEAN` and `SUM` are what EnergyPlus reports for the timestep: the time-weighted mean, or the sum,
    over its system timesteps. `INSTANT` is the state at the end of the timestep.
    """

    MEAN = "mean"
    SUM = "sum"
    INSTANT = "instant"


class Mode(StrEnum):
    """Who sets the pace of simulated time.

    `LOCKSTEP`: the required controllers. `PACED`: the wall clock, at a multiple of its speed; commands hold. `FREE`:
    nobody; it goes as fast as it can.
    """

    LOCKSTEP = "lockstep"
    PACED = "paced"
    FREE = "free"


class Policy(StrEnum):
    """What the node does when a controller has gone, or gives no valid command in time.

    `WAIT`: waits for it. `HOLD`: goes on with what it commanded last. `RELEASE`: gives what it commanded back, to the
    next priority level or to the building's own control. `ABORT`: ends the episode.
    """

    WAIT = "wait"
    HOLD = "hold"
    RELINQUISH = "relinquish"
    ABORT = "abort"


class State(StrEnum):
    """Where a node stands in an episode."""

    STARTING = "starting"
    WAITING = "waiting"
    RUNNING = "running"
    ENDED = "ended"
    FAILED = "failed"
    STOPPED = "stopped"


class EngineStart(StrEnum):
    """How the engine of an episode came to sample 0.

    `REUSED`: it waited there untouched. `FORKED`: from one that waits there. `PREFETCHED`: it was started while the
    episode before ran. `STARTED`: afresh. `SNAPSHOT`: from a snapshot, at that one's sample.
    """

    NONE = ""
    REUSED = "reused"
    FORKED = "forked"
    PREFETCHED = "prefetched"
    STARTED = "started"
    SNAPSHOT = "snapshot"


class Flag(IntFlag):
    """What a sample says about its episode.

    `FALLBACK`: a required controller gave no command for this timestep; the node's policy went on without it.
    """

    NONE = 0
    FIRST = 1
    TRUNCATED = 2
    FALLBACK = 4


class CommandOp(IntEnum):
    """What a command does to one actuator at the controller's level."""

    KEEP = 0
    SET = 1
    RELINQUISH = 2


class TimeField(StrEnum):
    """A field of the clock that an agent may observe, named as in EnergyPlus's data exchange API.

    They describe the timestep that a sample closes (the episode's begin for sample 0): `hour` is 0 to 23,
    `minutes` 1 to 60 and `current_time` (hours of the day, 0 to 24) its end; `day_of_week` is 1 on Sundays.
    """

    YEAR = "year"
    MONTH = "month"
    DAY_OF_MONTH = "day_of_month"
    DAY_OF_WEEK = "day_of_week"
    DAY_OF_YEAR = "day_of_year"
    HOUR = "hour"
    MINUTES = "minutes"
    CURRENT_TIME = "current_time"
