"""What a report is made of: controllers, their episodes and where they come from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

from agent_sdk.evaluation.metrics import EpisodeMetrics
from agent_sdk.evaluation.trace import EpisodeTrace, WeatherTrace
from agent_sdk.report.figures.base import Curve
from agent_sdk.report.quantities import Quantities
from topics.errors import InvalidConfig

if TYPE_CHECKING:
    from agent_sdk.report.sections import Section


@dataclass(frozen=True)
class Run:
    """The episodes of one controller.

    Attributes:
        name: name of the controller.
        results: metrics of each episode.
        trace: samples of the first episode.
        seeds: seed of each episode; None where it is not known.
        weather_names: name of the weather of each episode.
        weathers: weather of each episode; None where it is not known.
        reward: reward with the comfort band; None: that of the scenario.
    """

    name: str
    results: tuple[EpisodeMetrics, ...]
    trace: EpisodeTrace
    seeds: tuple[int | None, ...] = ()
    weather_names: tuple[str, ...] = ()
    weathers: tuple[WeatherTrace | None, ...] = ()
    reward: Any = None

    @cached_property
    def quantities(self) -> Quantities:
        """Quantities of the first episode."""
        return Quantities(self.trace, self.reward, self.weathers[0] if self.weathers else None)


@dataclass(frozen=True)
class Comparison:
    """Controllers in one scenario.

    Attributes:
        runs: the controllers; differences are those to the first one, usually the baseline control.
        scenario: the scenario as text (YAML).
        command: the command line that repeats the runs; "" if there is none.
        unfit: by controller that was skipped, the reason.
        sources: by metric, the point or reward that it is derived from.
    """

    runs: tuple[Run, ...]
    scenario: str = ""
    command: str = ""
    unfit: Mapping[str, str] = field(default_factory=dict)
    sources: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.runs:
            raise InvalidConfig("a report needs at least one run")

    @property
    def reference(self) -> Run:
        """The run to which the others are compared."""
        return self.runs[0]

    @property
    def episodes(self) -> int:
        """Number of episodes of each controller."""
        return len(self.reference.results)

    @cached_property
    def curves(self) -> tuple[Curve, ...]:
        """The runs as they are drawn."""
        return tuple(Curve(run.name, place, run.quantities) for place, run in enumerate(self.runs))

    @cached_property
    def sections(self) -> list[Section]:
        """The sections with their figures, drawn once for page and files."""
        from agent_sdk.report.sections import sections

        return sections(self)
