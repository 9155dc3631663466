"""The disturbances of a running building and their schedule, drawn from a seed."""

import random
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

LONG_S = 12.0
"""Longer than Zenoh's lease of 10 s: who is frozen so long is taken for dead."""


class Disturbance(StrEnum):
    """One kind of disturbance; its text is its row in the table."""

    KILL = "controller killed (SIGKILL), started again later"
    FREEZE = "controller frozen (SIGSTOP) for up to 1.5 s"
    FREEZE_LONG = "controller frozen for 12 s, longer than the bus waits for it"
    RESTART = "controller ended and started again at once"
    REPEAT = "controller repeats one command 300 times"
    KILL_MONITOR = "monitor killed, started again later"
    FREEZE_MONITOR = "monitor frozen for up to 3 s"
    FREEZE_NODE = "node frozen for up to 0.8 s"
    FREEZE_ENGINE = "EnergyPlus frozen for up to 0.8 s"
    KILL_ENGINE = "EnergyPlus killed; the next episode begins"
    RESET = "reset in the midst of an episode"
    PAUSE = "paused for up to 0.5 s, then resumed"
    GARBAGE = "malformed commands: no msgpack, bombs of nested arrays, wrong fields, wrong version"
    UNKNOWN = "commands by controllers that have claimed nothing"
    STALE = "commands for steps that are over, in a controller's name"
    FUTURE = "commands for steps and episodes to come, in a controller's name"
    OVERSIZED = "commands of more than 8 MB"
    LARGE = "messages of 8 MB to a key that all controllers subscribe to"
    WRITES = "writes of single points by persons, for a time or until released"
    BAD_WRITES = "writes that cannot be: unknown points, out of bounds, malformed"
    BAD_REQUESTS = "requests that cannot be: claims of what is not there or is taken, malformed ones"


FLOODS = (
    Disturbance.GARBAGE, Disturbance.UNKNOWN, Disturbance.STALE, Disturbance.FUTURE, Disturbance.OVERSIZED,
    Disturbance.LARGE, Disturbance.WRITES, Disturbance.BAD_WRITES, Disturbance.BAD_REQUESTS,
)  # fmt: skip
"""Those that the flooder sends, which has a session of its own."""

SIZES = {
    Disturbance.OVERSIZED: (1, 2),
    Disturbance.LARGE: (1, 6),
    Disturbance.WRITES: (1, 6),
    Disturbance.BAD_REQUESTS: (1, 6),
}
"""Messages of a flood; else 1 to 400."""

_RARE = (Disturbance.FREEZE_LONG, Disturbance.KILL_ENGINE, Disturbance.OVERSIZED, Disturbance.LARGE)
_OFTEN = (Disturbance.KILL, Disturbance.FREEZE, Disturbance.RESTART, Disturbance.WRITES)
_MEAN_PAUSE_S = 0.5


@dataclass(frozen=True, slots=True)
class Step:
    """A disturbance `pause_s` after the previous one; `draw` (0 to 1) selects its target, `amount` its extent."""

    pause_s: float
    disturbance: Disturbance
    draw: float
    amount: float


def script(seed: int, seconds: float) -> Iterator[Step]:
    """Yield disturbances without end, in rounds of every kind, some often; short runs have no long freeze."""
    rng = random.Random(seed)
    first = True
    while True:
        rare = first or rng.random() < 0.5
        bag = [kind for kind in Disturbance if rare or kind not in _RARE] + [*_OFTEN, *_OFTEN]
        if seconds < 3 * LONG_S:
            bag = [kind for kind in bag if kind is not Disturbance.FREEZE_LONG]
        rng.shuffle(bag)
        for disturbance in bag:
            yield Step(rng.expovariate(1 / _MEAN_PAUSE_S), disturbance, rng.random(), rng.random())
        first = False
