"""A node whose plant computes in the node's own process: `bench.empty_plant`, and values at which it fails.

If the environment variable `COPIES` names a folder, the plant can be copied; the folder has a file for each open copy.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Sequence
from pathlib import Path

from bench.empty_plant import EmptyPlant, empty_node
from zenostat.bridge.node.plant import PlantContext, RunningPlant, SlotPlacement, WeatherTable
from zenostat.bridge.node.program import main
from zenostat.topics.errors import PlantFailed
from zenostat.topics.messages import EngineStart, EpisodeStart

FATAL = 1313.0
BUG = 1414
COPIES = "ZENOSTAT_TEST_COPIES"


class FragilePlant(EmptyPlant):
    """Fails at one value of its command, and has an error of its program at one seed and in its weather."""

    def next_episode(
        self, slots: Sequence[int], seeds: Sequence[int | None], episode: Sequence[int], untouched: Sequence[bool]
    ) -> list[EpisodeStart]:
        if BUG in seeds:
            raise KeyError("next_episode")
        return super().next_episode(slots, seeds, episode, untouched)

    def weather(self, slot: int, columns: Sequence[str]) -> WeatherTable:
        if columns == [f"{BUG}"]:
            raise KeyError("weather")
        return super().weather(slot, columns)

    def step(self, commands: bytes, active_slots: Sequence[int]) -> list[bool]:
        last = super().step(commands, active_slots)
        if FATAL in self._effective:
            raise PlantFailed(f"the command {FATAL:g} broke the plant")
        return last


class CopyablePlant(FragilePlant):
    """Plant that is copied by assignment, as one without processes can be."""

    _numbers = itertools.count(1)
    _file: Path | None = None

    def fork(self, slots: Sequence[int], folder: Path, *, baseline: bool = False) -> CopyablePlant:
        copy = CopyablePlant(self.description.run_period.steps, PlantContext(folder, (SlotPlacement(),) * len(slots)))
        copy._file = Path(os.environ[COPIES], str(next(self._numbers)))
        copy._file.touch()
        for target, slot in enumerate(slots):
            copy._copy_slot(target, self, slot)
        return copy

    def restore(self, saved: RunningPlant, episode: Sequence[int]) -> list[EpisodeStart]:
        assert isinstance(saved, EmptyPlant)
        for slot in range(len(self._steps)):
            self._copy_slot(slot, saved, slot)
        return [EpisodeStart(engine_start=EngineStart.SNAPSHOT, weather="") for _ in self._steps]

    def _copy_slot(self, slot: int, other: EmptyPlant, origin: int) -> None:
        self._steps[slot], self._values[slot] = other._steps[origin], other._values[origin]
        self._effective[slot] = other._effective[origin]

    def close(self) -> None:
        if self._file is not None:
            self._file.unlink(missing_ok=True)


if __name__ == "__main__":
    main(lambda settings: empty_node(settings, CopyablePlant if COPIES in os.environ else FragilePlant))
