"""Selection of a benchmark's episodes by controller, building, season, weather, seed and training."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, fields
from typing import Any

from zenostat.lab.benchmark.definition import Episode
from zenostat.topics.errors import UnknownName, did_you_mean


@dataclass(frozen=True)
class Selection:
    """Conditions on episodes; None selects all.

    Attributes:
        controller: names of controllers.
        building, season, weather: names in the tasks.
        seed: seeds of the episodes.
        training_seed: numbers of the trainings; episodes of controllers that are not trained meet any.
    """

    controller: Collection[str] | None = None
    building: Collection[str] | None = None
    season: Collection[str] | None = None
    weather: Collection[str] | None = None
    seed: Collection[int] | None = None
    training_seed: Collection[int] | None = None

    def has(self, episode: Episode) -> bool:
        """Return whether an episode is selected."""
        return all(
            wanted is None or value is None or value in wanted
            for (_, wanted), value in zip(self._conditions(), _values(episode), strict=True)
        )

    def check(self, episodes: Iterable[Episode], what: str) -> None:
        """Check that some of the episodes are selected, and that each condition has only values that occur.

        Args:
            episodes: the episodes.
            what: what the episodes are, for the error.

        Raises:
            UnknownName: lists all values that do not occur, or says that no episode meets all conditions together.
        """
        episodes = list(episodes)
        rows = [_values(episode) for episode in episodes]
        errors = []
        for column, (name, wanted) in enumerate(self._conditions()):
            known = sorted({str(row[column]) for row in rows if row[column] is not None})
            errors += [
                f"{what} has no rows of the {name} {value!r}; {did_you_mean(str(value), known, limit=len(known))}"
                for value in wanted or ()
                if str(value) not in known
            ]
        if not errors and not any(map(self.has, episodes)):
            errors = [f"{what} has no row that meets all conditions together"]
        if errors:
            raise UnknownName("\n".join(errors))

    def _conditions(self) -> list[tuple[str, Collection[Any] | None]]:
        return [(field.name.replace("_", " "), getattr(self, field.name)) for field in fields(self)]


def _values(episode: Episode) -> tuple[Any, ...]:
    return (episode.controller, *episode.task.key, episode.seed, episode.training_seed)
