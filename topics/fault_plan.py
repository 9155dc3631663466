"""Fault plans: faults injected into a node's points and into its link, as a file and as a request.

Numbers without a unit in their name are in the unit of the affected point. `docs/faults.md` has each kind's formula.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeAlias, get_args

from pydantic import AfterValidator, BaseModel, BeforeValidator, Field, field_validator, model_validator

from zenostat.topics.calendar import Weekday, parse_moment
from zenostat.topics.errors import did_you_mean
from zenostat.topics.file_fields import FilePart, Hours, Names, check_unique
from zenostat.topics.messages import Count, Finite
from zenostat.topics.messages.base import SourceName
from zenostat.topics.points import check_order


def _check_moment(text: str) -> str:
    parse_moment(text)
    return text


Moment = Annotated[str, AfterValidator(_check_moment)]
Probability = Annotated[float, Field(gt=0, le=1, strict=True)]
Positive = Annotated[float, Field(gt=0, strict=True)]
Steps = Annotated[int, Field(ge=1, lt=2**31, strict=True)]


class When(FilePart):
    """Conditions under which a fault is active: at the samples that meet all of them; always, if there are none.

    Starts are inclusive, ends exclusive. A command is affected at the sample that it answers.

    Attributes:
        from_s, to_s: seconds since the start of the episode.
        from_step, to_step: steps of the episode.
        from_time, to_time: simulated time, `2017-07-03T08:00`; without a year, the first such time in the run period,
            and the first one after the start of the window.
        hours: start and end as hours of the day; (22, 6) spans midnight.
        weekdays: days of the week.
        probability: of the fault's onset, at each sample that meets all other conditions while it is not active.
        lasts_steps: how many steps it is active after such an onset; 1 by default.
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
    def _check_conditions(self) -> When:
        errors = []
        for unit in ("s", "step"):
            start, end = getattr(self, f"from_{unit}"), getattr(self, f"to_{unit}")
            if start is not None and end is not None and start >= end:
                errors.append(f"from_{unit} {start:g} is not before to_{unit} {end:g}")
        if self.lasts_steps is not None and self.probability is None:
            errors.append("lasts_steps requires a probability; without one, use to_step or to_s")
        if errors:
            raise ValueError("; ".join(errors))
        return self


class AnyFault(FilePart):
    """Base class of all faults.

    Attributes:
        name: its name in events; by default its kind and its position in the plan, such as `bias 1`.
        when: conditions under which it is active.
    """

    name: Annotated[str, Field(max_length=128)] = ""
    when: When = When()


class PointFault(AnyFault):
    """A fault of some points.

    Attributes:
        points: names of sensors and meters whose values in samples are affected.
        actuators: names of actuators whose commanded values are affected before they reach the building.
    """

    points: Names = ()
    actuators: Names = ()

    @model_validator(mode="after")
    def _check_targets(self) -> PointFault:
        if not (self.points or self.actuators):
            raise ValueError("name points (sensors and meters) or actuators; '*' matches all of them")
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
    """Adds `rate_per_h` for each hour since its onset."""

    kind: Literal["drift"]
    rate_per_h: Finite


class Noise(PointFault):
    """Adds Gaussian noise with standard deviation `sigma`, drawn for each sample and point."""

    kind: Literal["noise"]
    sigma: Positive


class Freeze(PointFault):
    """Keeps the value from its onset."""

    kind: Literal["freeze"]


class Stuck(PointFault):
    """Replaces the value by `value`."""

    kind: Literal["stuck"]
    value: Finite


class Drop(PointFault):
    """Drops the value: a sensor or meter has none (NaN); an actuator keeps the last commanded value."""

    kind: Literal["drop"]


class Delay(PointFault):
    """Replaces the value by that of `steps` steps ago; NaN if there is none yet."""

    kind: Literal["delay"]
    steps: Annotated[int, Field(ge=1, le=10_000, strict=True)]


class Quantize(PointFault):
    """Rounds to the nearest multiple of `resolution`."""

    kind: Literal["quantize"]
    resolution: Positive


class Spike(PointFault):
    """Shifts the value by `amplitude` with a probability, drawn for each sample and point.

    Attributes:
        two_sided: add or subtract `amplitude` with equal probability; otherwise add it.
    """

    kind: Literal["spike"]
    amplitude: Finite
    probability: Probability
    two_sided: Annotated[bool, Field(strict=True)] = True


class Clip(PointFault):
    """Clips to the range from `low` to `high`."""

    kind: Literal["clip"]
    low: Finite | None = None
    high: Finite | None = None

    @model_validator(mode="after")
    def _check_range(self) -> Clip:
        if self.low is None and self.high is None:
            raise ValueError("give low, high or both")
        check_order(self)
        return self


class LinkFault(AnyFault):
    """A fault of the link between a node and its bus; times are wall time.

    Attributes:
        samples: whether the node's samples are affected.
        commands: names of controllers whose commands are affected.
    """

    samples: Annotated[bool, Field(strict=True)] = False
    commands: Names = ()

    @model_validator(mode="after")
    def _check_targets(self) -> LinkFault:
        if not (self.samples or self.commands):
            raise ValueError("give samples: true, or commands with names of controllers ('*' matches all of them)")
        return self


class Latency(LinkFault):
    """Delays each message by `delay_ms`."""

    kind: Literal["latency"]
    delay_ms: Annotated[float, Field(gt=0, le=3_600_000, strict=True)]


class Jitter(LinkFault):
    """Delays each message by up to `jitter_ms`, uniformly distributed; messages stay in order."""

    kind: Literal["jitter"]
    jitter_ms: Annotated[float, Field(gt=0, le=3_600_000, strict=True)]


class Loss(LinkFault):
    """Drops a message with a probability."""

    kind: Literal["loss"]
    probability: Probability


class Duplicate(LinkFault):
    """Delivers a message twice, with a probability."""

    kind: Literal["duplicate"]
    probability: Probability


class Reorder(LinkFault):
    """Delays a message by `hold_ms` with a probability; later messages overtake it."""

    kind: Literal["reorder"]
    probability: Probability
    hold_ms: Annotated[float, Field(gt=0, le=3_600_000, strict=True)]


AnyPointFault: TypeAlias = Bias | Gain | Drift | Noise | Freeze | Stuck | Drop | Delay | Quantize | Spike | Clip
AnyLinkFault: TypeAlias = Latency | Jitter | Loss | Duplicate | Reorder
KINDS: dict[str, type[AnyFault]] = {
    get_args(form.model_fields["kind"].annotation)[0]: form
    for form in (*get_args(AnyPointFault), *get_args(AnyLinkFault))
}
"""The classes of faults by kind."""


def _check_kind(value: Any) -> Any:
    if isinstance(value, BaseModel):
        return value
    if not isinstance(value, dict):
        raise ValueError("a fault is a map with a kind, such as {kind: bias, points: NAME, offset: 1.5}")
    if "kind" not in value:
        raise ValueError(f"the kind is missing: one of {', '.join(KINDS)}")
    kind = value["kind"]
    if not isinstance(kind, str) or kind not in KINDS:
        raise ValueError(f"no kind {kind!r}; {did_you_mean(str(kind), KINDS, limit=len(KINDS))}")
    return value


Fault = Annotated[AnyPointFault | AnyLinkFault, Field(discriminator="kind"), BeforeValidator(_check_kind)]


class FaultPlan(FilePart):
    """Faults to inject into a node. Faults of the same point are applied in this order, each to the previous result.

    Attributes:
        seed: seed of all random numbers of the faults.
        faults: the faults; none restores normal operation.
        source: name of who injects them, as in the request's key; files need none.
    """

    seed: Annotated[int, Field(ge=0, lt=2**63, strict=True)] = 0
    faults: tuple[Fault, ...] = ()
    source: SourceName = ""

    @property
    def names(self) -> tuple[str, ...]:
        """The unique name of each fault."""
        return _names(self.faults)

    @field_validator("faults")
    @classmethod
    def _check_names(cls, faults: tuple[Fault, ...]) -> tuple[Fault, ...]:
        check_unique(_names(faults), "fault")
        return faults


def _names(faults: tuple[AnyPointFault | AnyLinkFault, ...]) -> tuple[str, ...]:
    return tuple(fault.name or f"{fault.kind} {number}" for number, fault in enumerate(faults, 1))
