"""Content of a report: controllers, their episodes and the origin of these."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from zenostat.metrics.episode_metrics import EpisodeMetrics
from zenostat.metrics.episode_weather import EpisodeWeather
from zenostat.metrics.trajectory import Trajectory
from zenostat.topics.errors import InvalidConfig
from zenostat.views.report.figures.base import Curve
from zenostat.views.report.quantities import Quantities

_MAX_NAME = 28
"""Letters of a name that fit beside bars and into legends."""


@dataclass(frozen=True)
class Run:
    """The episodes of one controller.

    Attributes:
        name: name of the controller.
        results: metrics of each episode.
        trajectory: samples of the first episode.
        seeds: seed of each episode; None where it is not known.
        weather_names: name of the weather of each episode.
        weathers: weather of each episode; None where it is not known.
        reward: reward with the comfort band; None: that of the scenario.
        short_name: name in tables and figures; "" is the name itself. `Comparison` chooses it.
    """

    name: str
    results: tuple[EpisodeMetrics, ...]
    trajectory: Trajectory
    seeds: tuple[int | None, ...] = ()
    weather_names: tuple[str, ...] = ()
    weathers: tuple[EpisodeWeather | None, ...] = ()
    reward: Any = None
    short_name: str = ""

    @property
    def label(self) -> str:
        """Name in tables and figures."""
        return self.short_name or self.name

    @cached_property
    def quantities(self) -> Quantities:
        """Quantities of the first episode."""
        return Quantities(self.trajectory, self.reward, self.weathers[0] if self.weathers else None)


@dataclass(frozen=True)
class Comparison:
    """Controllers in one scenario.

    Attributes:
        runs: the controllers; differences are those to the first one, usually the baseline control.
        scenario: the scenario as text (YAML).
        command: the command line that repeats the runs; "" if there is none.
        unfit: by controller that was skipped, the reason.
        sources: by metric, the point or reward that it is derived from.
        derived: what is made of it once, for page and files.
    """

    runs: tuple[Run, ...]
    scenario: str = ""
    command: str = ""
    unfit: Mapping[str, str] = field(default_factory=dict)
    sources: Mapping[str, str] = field(default_factory=dict)
    derived: dict[str, Any] = field(default_factory=dict, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not self.runs:
            raise InvalidConfig("a report needs at least one run")
        short = short_names([run.name for run in self.runs])
        runs = tuple(replace(run, short_name=name) for run, name in zip(self.runs, short, strict=True))
        object.__setattr__(self, "runs", runs)

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
        return tuple(Curve(run.label, place, run.quantities, run.name) for place, run in enumerate(self.runs))


def short_names(names: Sequence[str]) -> list[str]:
    """Return names that fit into figures: the class of `path/to/file.py:Class`, the file of `ppo:path/to/model.zip`."""
    short = []
    for name in names:
        text = name.rpartition(":")[2]
        text = text.rpartition("/")[2] or name
        short.append(text if len(text) <= _MAX_NAME else f"{text[: _MAX_NAME - 1]}\N{HORIZONTAL ELLIPSIS}")
    unique = [
        f"{text} {short[: place + 1].count(text)}" if short.count(text) > 1 else text
        for place, text in enumerate(short)
    ]
    return [
        name if len(name) <= _MAX_NAME and names.count(name) == 1 and ":" not in name else text
        for name, text in zip(names, unique, strict=True)
    ]
