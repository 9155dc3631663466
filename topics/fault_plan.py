"""Faults on purpose: what may be wrong with a node's points and with its link, as a file and as a request.

A plan says what goes wrong, when, and to whom. Numbers without a unit in their name are in the unit of the point
that they disturb. `docs/faults.md` has each kind's formula.
"""

from __future__ import annotations

import re
from datetime import datetime
from typing import Annotated, Any, Literal, TypeAlias, get_args

from pydantic import AfterValidator, BaseModel, BeforeValidator, Field, field_validator, model_validator

from topics.errors import did_you_mean
from topics.messages import Count, Finite, Message

Weekday = Literal["mon", "tue", "wed", "thu", "fri", "sat", "sun"]
WEEKDAYS: tuple[Weekday, ...] = get_args(Weekday)

_MOMENT = re.compile(r"(?:(\d{4})-)?(\d\d)-(\d\d)(?:[T ](\d\d):(\d\d)(?::(\d\d))?)?")
_LEAP_YEAR = 2016


def moment(text: str, year: int) -> datetime:
    """`2017-07-03T08:00`, or `07-03T08:00` in `year`; without a time of day it is 0:00.

    Raises:
        ValueError: no such form, or no such moment.
    """
    found = _MOMENT.fullmatch(text.strip())
    if not found:
        raise ValueError("a moment is written as 2017-07-03T08:00, or 07-03T08:00 in the simulated year")
    named, month, day, hour, minute, second = (int(part or 0) for part in found.groups())
    try:
        return datetime(named or year, month, day, hour, minute, second)
    except ValueError as error:
        raise ValueError(f"{text!r} is no moment: {error}") from None


def _is_a_moment(text: str) -> str:
    moment(text, _LEAP_YEAR)
    return text


def _is_a_span(hours: tuple[float, float]) -> tuple[float, float]:
    first, end = hours
    if not (0 <= first < 24 and 0 <= end <= 24 and first != end):
        raise ValueError("a begin from 0 up to 24 h and another end are expected, as [8.5, 17] or [22, 6]")
    return hours


def _one_or_more(value: Any) -> Any:
    return (value,) if isinstance(value, str) else value


Moment = Annotated[str, AfterValidator(_is_a_moment)]
Hours = Annotated[tuple[Finite, Finite], AfterValidator(_is_a_span)]
Probability = Annotated[float, Field(gt=0, le=1, strict=True)]
Positive = Annotated[float, Field(gt=0, strict=True)]
Steps = Annotated[int, Field(ge=1, lt=2**31, strict=True)]
Pattern = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.\-*]{1,128}$")]
Names = Annotated[
    tuple[Pattern, ...],
    BeforeValidator(_one_or_more, json_schema_input_type=str | list[str]),
]
"""One name or several; `*` stands for any characters."""


class When(Message):
    """When a fault is on: at the samples for which all that is said holds; always, if nothing is said.

    A begin is in it, an end is not. A command belongs to the sample that it answers.

    Attributes:
        from_s, to_s: seconds since the episode began.
        from_step, to_step: steps of the episode.
        from_time, to_time: simulated time, `2017-07-03T08:00`; without a year it is that of the run period's begin.
        hours: of the day, the first one and the end; (22, 6) spans midnight.
        weekdays: of the day on which the moment lies.
        probability: of beginning, at each sample at which all else holds and it is not on already.
        lasts_steps: how long it is on once it has so begun; 1 if not said.
    """

    from_s: Annotated[float, Field(ge=0, strict=True)] | None = None
    to_s: Positive | None = None
    from_step: Count | None = None
    to_step: Steps | None = None
    from_time: Moment | None = None
    to_time: Moment | None = None
    hours: Hours | None = None
    weekdays: Annotated[tuple[Weekday, ...], Field(min_length=1)] | None = None
    probability: Probability | None = None
    lasts_steps: Steps | None = None

    @model_validator(mode="after")
    def _begins_before_it_ends(self) -> When:
        wrong = []
        for unit in ("s", "step"):
            first, end = getattr(self, f"from_{unit}"), getattr(self, f"to_{unit}")
            if first is not None and end is not None and first >= end:
                wrong.append(f"from_{unit} {first:g} is not before to_{unit} {end:g}")
        if self.lasts_steps is not None and self.probability is None:
            wrong.append("lasts_steps goes with a probability; without one, say to_step or to_s")
        if wrong:
            raise ValueError("; ".join(wrong))
        return self


class AnyFault(Message):
    """What all faults have.

    Attributes:
        name: for events; without one it is the kind and the place in the plan, as `bias 1`.
        when: it is on.
    """

    name: Annotated[str, Field(max_length=128)] = ""
    when: When = When()


class PointFault(AnyFault):
    """A fault of some points.

    Attributes:
        points: names of sensors and meters; the samples on the bus are disturbed.
        actuators: names of actuators; what reaches the building of the commands is disturbed.
    """

    points: Names = ()
    actuators: Names = ()

    @model_validator(mode="after")
    def _somewhere(self) -> PointFault:
        if not (self.points or self.actuators):
            raise ValueError("points (sensors and meters) or actuators should be named; '*' is all of them")
        return self


class Bias(PointFault):
    """Adds `offset`."""

    kind: Literal["bias"]
    offset: Finite


class Gain(PointFault):
    """Multiplies by `factor`."""

    kind: Literal["gain"]
    factor: Finite


class Drift(PointFault):
    """Adds `rate_per_h` for each hour since it began."""

    kind: Literal["drift"]
    rate_per_h: Finite


class Noise(PointFault):
    """Adds Gaussian noise of standard deviation `sigma`, at each sample and for each point anew."""

    kind: Literal["noise"]
    sigma: Positive


class Freeze(PointFault):
    """Holds the value that it had when it began."""

    kind: Literal["freeze"]


class Stuck(PointFault):
    """Has `value`."""

    kind: Literal["stuck"]
    value: Finite


class Drop(PointFault):
    """A point has no value (NaN). An actuator hears nothing: what it was told last goes on."""

    kind: Literal["drop"]


class Delay(PointFault):
    """Has the value of `steps` steps ago; NaN where there was none yet."""

    kind: Literal["delay"]
    steps: Annotated[int, Field(ge=1, le=10_000, strict=True)]


class Quantize(PointFault):
    """Is rounded to the nearest multiple of `resolution`."""

    kind: Literal["quantize"]
    resolution: Positive


class Spike(PointFault):
    """Is `amplitude` off, with a probability, at each sample and for each point anew.

    Attributes:
        two_sided: up or down with equal chances; else `amplitude` is added.
    """

    kind: Literal["spike"]
    amplitude: Finite
    probability: Probability
    two_sided: Annotated[bool, Field(strict=True)] = True


class Clip(PointFault):
    """Goes no lower than `low` and no higher than `high`."""

    kind: Literal["clip"]
    low: Finite | None = None
    high: Finite | None = None

    @model_validator(mode="after")
    def _a_range(self) -> Clip:
        if self.low is None and self.high is None:
            raise ValueError("a low or a high is expected")
        if self.low is not None and self.high is not None and self.low >= self.high:
            raise ValueError(f"low {self.low:g} is not below high {self.high:g}")
        return self


class LinkFault(AnyFault):
    """A fault of the way between a node and its bus; times are wall time.

    Attributes:
        samples: what the node says.
        commands: names of controllers whose commands it hears.
    """

    samples: Annotated[bool, Field(strict=True)] = False
    commands: Names = ()

    @model_validator(mode="after")
    def _somewhere(self) -> LinkFault:
        if not (self.samples or self.commands):
            raise ValueError("samples: true or commands (names of controllers; '*' is all of them) is expected")
        return self


class Latency(LinkFault):
    """Each message comes `delay_ms` later."""

    kind: Literal["latency"]
    delay_ms: Annotated[float, Field(gt=0, le=3_600_000, strict=True)]


class Jitter(LinkFault):
    """Each message comes up to `jitter_ms` later, uniformly; messages do not overtake each other."""

    kind: Literal["jitter"]
    jitter_ms: Annotated[float, Field(gt=0, le=3_600_000, strict=True)]


class Loss(LinkFault):
    """A message does not come, with a probability."""

    kind: Literal["loss"]
    probability: Probability


class Duplicate(LinkFault):
    """A message comes once more, with a probability."""

    kind: Literal["duplicate"]
    probability: Probability


class Reorder(LinkFault):
    """A message is held back for `hold_ms`, with a probability; those that come meanwhile overtake it."""

    kind: Literal["reorder"]
    probability: Probability
    hold_ms: Annotated[float, Field(gt=0, le=3_600_000, strict=True)]


AnyPointFault: TypeAlias = Bias | Gain | Drift | Noise | Freeze | Stuck | Drop | Delay | Quantize | Spike | Clip
AnyLinkFault: TypeAlias = Latency | Jitter | Loss | Duplicate | Reorder
KINDS: dict[str, type[AnyFault]] = {
    get_args(form.model_fields["kind"].annotation)[0]: form
    for form in (*get_args(AnyPointFault), *get_args(AnyLinkFault))
}
"""All kinds of faults, by name."""


def _has_a_kind(value: Any) -> Any:
    if isinstance(value, BaseModel):
        return value
    if not isinstance(value, dict):
        raise ValueError("a fault is a map with a kind, as {kind: bias, points: NAME, offset: 1.5}")
    if "kind" not in value:
        raise ValueError(f"its kind is missing: one of {', '.join(KINDS)}")
    kind = value["kind"]
    if not isinstance(kind, str) or kind not in KINDS:
        raise ValueError(f"no kind {kind!r}; {did_you_mean(str(kind), KINDS, most=len(KINDS))}")
    return value


Fault = Annotated[AnyPointFault | AnyLinkFault, Field(discriminator="kind"), BeforeValidator(_has_a_kind)]


class FaultPlan(Message):
    """What goes wrong on a node, on purpose. Faults of a point act in this order, each on what the former leaves.

    Attributes:
        seed: of all their random numbers.
        faults: none for a node in order.
    """

    seed: Annotated[int, Field(ge=0, lt=2**63, strict=True)] = 0
    faults: tuple[Fault, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The name of each fault; no two are alike."""
        return _names(self.faults)

    @field_validator("faults")
    @classmethod
    def _names_differ(cls, faults: tuple[Fault, ...]) -> tuple[Fault, ...]:
        names = _names(faults)
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"each fault needs a name of its own; twice there: {', '.join(map(repr, twice))}")
        return faults


def _names(faults: tuple[AnyPointFault | AnyLinkFault, ...]) -> tuple[str, ...]:
    return tuple(fault.name or f"{fault.kind} {number}" for number, fault in enumerate(faults, 1))
