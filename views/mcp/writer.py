"""Writes of a language model: to named actuators only, within a range, with an expiry, at a low priority, not often.

Each is first tried for a timestep on a copy of the building, since some values end a simulation.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any

from zenostat.bridge.client.bus import Bus
from zenostat.topics.errors import AccessDenied, ForkFailed, InvalidConfig, RequestRejected, SimulatorError
from zenostat.topics.keys import own_name
from zenostat.topics.messages import Actuator, Manifest
from zenostat.topics.points import actuator_index, bounds, describe_bounds
from zenostat.topics.units import with_unit

HIGHEST_PRIORITY, LOWEST_PRIORITY = 9, 16
"""Range of priorities: below those of people (8)."""

_WINDOW_S = 60.0


@dataclass(frozen=True)
class WriteRule:
    """Actuators that may be written, and the range of their values.

    Attributes:
        pattern: of names, with `*` and `?`.
        low, high: the range, in the actuator's unit; None is the actuator's own bound.
    """

    pattern: str
    low: float | None = None
    high: float | None = None

    @classmethod
    def parse(cls, text: str) -> WriteRule:
        """Read `PATTERN` or `PATTERN=LOW:HIGH`; `InvalidConfig` if it has another form."""
        pattern, has_range, limits = text.partition("=")
        if not pattern or len(pattern) > 200:
            raise InvalidConfig(f"--allow-writes {text}: expected PATTERN or PATTERN=LOW:HIGH")
        if not has_range:
            return cls(pattern)
        try:
            low, high = map(float, limits.split(":"))
        except ValueError:
            low, high = math.nan, math.nan
        if not (math.isfinite(low) and math.isfinite(high) and low <= high):
            raise InvalidConfig(
                f"--allow-writes {text}: expected two numbers, the lower one first, as in '*_cooling_setpoint=22:28'"
            )
        return cls(pattern, low, high)

    def limits(self, actuator: Actuator) -> tuple[float, float]:
        """Return the range of an actuator's values, within its own bounds.

        Raises:
            AccessDenied: neither the actuator nor the rule has a bound, or no value is within those of both.
        """
        lows = [low for low in (self.low, actuator.low) if low is not None]
        highs = [high for high in (self.high, actuator.high) if high is not None]
        if not lows or not highs:
            raise AccessDenied(
                f"{actuator.name} has no bounds of its own, and --allow-writes gives no range for it: "
                f"{actuator.name}=LOW:HIGH"
            )
        low, high = max(lows), min(highs)
        if low > high:
            lowest, highest = bounds(self)
            raise AccessDenied(
                f"{actuator.name} may not be written: its bounds are {describe_bounds(actuator)}, and the range of "
                f"--allow-writes is {lowest:g} to {highest:g}"
            )
        return low, high


@dataclass(frozen=True)
class WriteLimits:
    """Limits of all writes.

    Attributes:
        rules: actuators and ranges; the first rule whose pattern matches an actuator applies.
        priority: priority of all writes, 9 to 16.
        max_duration_s: longest time until a value is relinquished, simulated seconds.
        per_minute: largest number of writes in a minute of wall time.
    """

    rules: Sequence[WriteRule]
    priority: int = 14
    max_duration_s: float = 4 * 3600.0
    per_minute: int = 6

    def __post_init__(self) -> None:
        if not self.rules:
            raise InvalidConfig("--allow-writes: at least one pattern expected")
        if not HIGHEST_PRIORITY <= self.priority <= LOWEST_PRIORITY:
            raise InvalidConfig(
                f"--priority {self.priority}: {HIGHEST_PRIORITY} to {LOWEST_PRIORITY} expected, below people's (8)"
            )
        if not 0 < self.max_duration_s < math.inf:
            raise InvalidConfig(f"--max-duration: a time above 0 expected, not {self.max_duration_s:g} s")
        if self.per_minute < 1:
            raise InvalidConfig(f"--writes-per-minute {self.per_minute}: at least 1 expected")


class Writer:
    """Sends the writes that the limits permit; for several threads.

    Args:
        bus: connection to the bus.
        source: name of the writer.
        limits: what is permitted.
        clock: monotonic time in seconds.
    """

    def __init__(
        self, bus: Bus, source: str, limits: WriteLimits, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.limits = limits
        self._bus, self._source, self._clock = bus, source, clock
        self._times: deque[float] = deque()
        self._lock = threading.Lock()

    def write(self, manifest: Manifest, name: str, value: float, duration_s: float) -> dict[str, Any]:
        """Command an actuator for a time; return what is in effect then.

        Raises:
            UnknownName: there is no such actuator.
            AccessDenied: the limits do not permit it, or the simulation fails with it.
            RequestRejected: too many writes, the priority is another writer's, or the node rejected the write.
        """
        actuator_index(manifest).require([name])
        actuator = next(each for each in manifest.actuators if each.name == name)
        self._check(actuator, value, duration_s)
        with self._lock:
            self._check_holder(manifest, name)
            self._count()
            self._try(manifest, name, value)
            ack = self._bus.write(
                manifest.node, name, value,
                priority=self.limits.priority, duration_s=duration_s, source=self._source,
            )  # fmt: skip
        return {"answer": ack.text, **self._effect(manifest, name)}

    def relinquish(self, manifest: Manifest, name: str) -> dict[str, Any]:
        """Relinquish a value that this writer has set; return what is in effect then.

        Raises:
            UnknownName: there is no such actuator.
            RequestRejected: this writer has set no value, or the node rejected the write.
        """
        actuator_index(manifest).require([name])
        with self._lock:
            if not self._check_holder(manifest, name):
                raise RequestRejected(f"{name} has no value of this server at priority {self.limits.priority}")
            ack = self._bus.write(manifest.node, name, None, priority=self.limits.priority, source=self._source)
        return {"answer": ack.text, **self._effect(manifest, name)}

    def describe(self, actuator: Actuator) -> dict[str, Any] | None:
        """Return the range in which an actuator may be written; None if it may not."""
        try:
            low, high = self._rule(actuator).limits(actuator)
        except AccessDenied:
            return None
        return {"low": low, "high": high}

    def _rule(self, actuator: Actuator) -> WriteRule:
        for rule in self.limits.rules:
            if fnmatchcase(actuator.name, rule.pattern):
                return rule
        patterns = ", ".join(rule.pattern for rule in self.limits.rules)
        raise AccessDenied(f"{actuator.name} may not be written, only {patterns}")

    def _check(self, actuator: Actuator, value: float, duration_s: float) -> None:
        low, high = self._rule(actuator).limits(actuator)
        if not low <= value <= high:
            permitted = with_unit(f"{low:g} to {high:g}", actuator.unit)
            raise AccessDenied(f"{actuator.name}: {value!r} is not from {permitted}")
        longest_s = self.limits.max_duration_s
        if not 0 < duration_s <= longest_s:
            raise AccessDenied(f"a write lasts up to {longest_s / 60:g} simulated minutes, not {duration_s / 60:g}")

    def _check_holder(self, manifest: Manifest, name: str) -> bool:
        """Return whether this writer holds its priority of an actuator in a slot.

        Raises:
            RequestRejected: another writer holds it in a slot.
        """
        arrays = [self._bus.priorities(manifest.node, slot=slot)[name] for slot in range(manifest.slots)]
        held = [entry for array in arrays if (entry := array[self.limits.priority - 1]).value is not None]
        for entry in held:
            if entry.source != own_name(self._bus.identity, self._source):
                raise RequestRejected(f"priority {self.limits.priority} of {name} is in use by {entry.source}")
        return bool(held)

    def _try(self, manifest: Manifest, name: str, value: float) -> None:
        """Simulate the next timestep with a value on a copy, where the plant can be copied.

        Raises:
            AccessDenied: the simulation fails.
        """
        try:
            self._bus.try_step(manifest.node, [{name: value}], name=self._source, priority=self.limits.priority)
        except (ForkFailed, RequestRejected):  # what is wrong with the value, the node answers to the write as well
            return
        except SimulatorError as error:
            raise AccessDenied(f"{name} = {value:g}: the simulation fails with it on a copy: {error}") from None

    def _count(self) -> None:
        now_s = self._clock()
        while self._times and now_s - self._times[0] >= _WINDOW_S:
            self._times.popleft()
        if len(self._times) >= self.limits.per_minute:
            wait_s = math.ceil(_WINDOW_S - (now_s - self._times[0]))
            raise RequestRejected(f"at most {self.limits.per_minute} writes a minute; try again in {wait_s} s")
        self._times.append(now_s)

    def _effect(self, manifest: Manifest, name: str) -> dict[str, Any]:
        """Return the entry of the priority array that is in effect from the next timestep on."""
        entries = self._bus.priorities(manifest.node)[name]
        for priority, entry in enumerate(entries, 1):
            if entry.value is not None:
                is_own = priority == self.limits.priority
                return {
                    "in_effect": {"priority": priority, "value": entry.value, "source": entry.source},
                    "is_own": is_own,
                }
        return {"in_effect": "baseline control", "is_own": False}
