"""Alarm rules: limits of a node's sensors and meters, as a file.

Numbers without a unit in their name are in the unit of the point. `docs/alarms.md` describes their effect.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, field_validator, model_validator

from zenostat.topics.calendar import Weekday
from zenostat.topics.errors import did_you_mean
from zenostat.topics.file_fields import FilePart, Hours, Names, check_unique
from zenostat.topics.keys import is_name
from zenostat.topics.messages import AlarmPriority, Finite, Lines, NotifyType, SafeName
from zenostat.topics.messages.alarms import MAX_DURATION_S
from zenostat.topics.points import check_order

NotNegative = Annotated[float, Field(ge=0, strict=True)]

MAX_RULES = 1000
"""Largest number of rules of a node."""


class _Fields(FilePart):
    """A map of fields whose unknown names are errors with similar names."""

    @model_validator(mode="before")
    @classmethod
    def _check_fields(cls, value: Any) -> Any:
        if not isinstance(value, dict):
            return value
        unknown = [name for name in value if name not in cls.model_fields]
        if unknown:
            raise ValueError(
                "; ".join(
                    f"there is no field {name[:64]!r}; {did_you_mean(name[:64], cls.model_fields)}"
                    for name in map(str, unknown[:8])
                )
            )
        return value


class SuppressionCondition(_Fields):
    """A condition that suppresses alarms while it holds: a value above or below a limit, or between two.

    Attributes:
        point: name of a sensor or meter.
        above, below: limits, in its unit; a value that is missing, or is a limit itself, does not suppress.
        unit: unit of the limits; it must be that of the point. None: not checked.
    """

    point: SafeName
    above: Finite | None = None
    below: Finite | None = None
    unit: Annotated[str, Field(max_length=64)] | None = None

    @model_validator(mode="after")
    def _check_limits(self) -> SuppressionCondition:
        if self.above is None and self.below is None:
            raise ValueError("a condition needs a limit: above, below or both")
        if self.above is not None and self.below is not None and self.above >= self.below:
            raise ValueError(f"above {self.above:g} and below {self.below:g} at once: no value is both")
        return self


class AlarmRule(_Fields):
    """Limits of one or several points; each point has an alarm of its own.

    Attributes:
        name: its name, without spaces.
        points: names of sensors and meters.
        high, low: limits, in the unit of the points; a value beyond them is off-normal.
        unit: unit of the limits; it must be that of the points. None: not checked.
        deadband: how far a value must be within the limit again to be normal.
        delay_s: simulated time for which a value must be beyond the limit without interruption.
        return_delay_s: simulated time for which it must be normal again; None: as `delay_s`.
        occupied: whether the rule applies only while the point's zone is occupied; a name is that of the sensor that
            counts occupants.
        hours: start and end as hours of the day in which it applies; (22, 6) spans midnight.
        weekdays: days of the week on which it applies.
        suppress_when: a condition under which the alarms of the rule are suppressed.
        max_shelve_s: longest simulated time for which they can be shelved; 0: not at all.
        priority: for operators.
        notify: whether its alarms have to be acknowledged.
        text: for operators.
    """

    name: SafeName
    points: Annotated[Names, Field(min_length=1)]
    high: Finite | None = None
    low: Finite | None = None
    unit: Annotated[str, Field(max_length=64)] | None = None
    deadband: NotNegative = 0.0
    delay_s: NotNegative = 0.0
    return_delay_s: NotNegative | None = None
    occupied: Annotated[bool, Field(strict=True)] | SafeName = False
    hours: Hours | None = None
    weekdays: Annotated[tuple[Weekday, ...], Field(min_length=1)] | None = None
    suppress_when: SuppressionCondition | None = None
    max_shelve_s: Annotated[float, Field(ge=0, le=MAX_DURATION_S, strict=True)] = 86400.0
    priority: AlarmPriority = AlarmPriority.MEDIUM
    notify: NotifyType = NotifyType.ALARM
    text: Annotated[Lines, Field(max_length=500)] = ""

    @field_validator("name", mode="before")
    @classmethod
    def _check_name(cls, name: Any) -> Any:
        if isinstance(name, str) and not is_name(name):
            raise ValueError("a name has up to 128 letters, digits, '_', '.' and '-', such as zone_too_warm")
        return name

    @model_validator(mode="after")
    def _check_limits(self) -> AlarmRule:
        if self.low is None and self.high is None:
            raise ValueError("a rule needs a limit: high, low or both")
        check_order(self)
        if self.low is not None and self.high is not None and self.deadband >= self.high - self.low:
            raise ValueError(
                f"deadband {self.deadband:g} leaves no normal values between low {self.low:g} and high {self.high:g}"
            )
        return self


class AlarmRules(FilePart):
    """The alarm rules of a node.

    Attributes:
        alarms: the rules.
    """

    alarms: tuple[AlarmRule, ...]

    @field_validator("alarms")
    @classmethod
    def _check_names(cls, alarms: tuple[AlarmRule, ...]) -> tuple[AlarmRule, ...]:
        if not 1 <= len(alarms) <= MAX_RULES:
            raise ValueError(f"expected 1 to {MAX_RULES} rules, got {len(alarms)}")
        check_unique((rule.name for rule in alarms), "rule")
        return alarms
