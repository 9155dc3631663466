"""Random numbers of faults, as a function of the plan's seed, the fault, the episode and the step.

Numbers are not drawn sequentially. So faults do not affect each other's numbers, a fault's conditions do not affect the
numbers of a step, and a return to an earlier step repeats the same numbers. NumPy's `SeedSequence` makes streams with
different keys independent.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from zenostat.topics.arrays import Floats

BLOCK = 64
"""Number of steps that are drawn at once: creating a generator takes as long as drawing some hundred numbers."""

Key = tuple[int, ...]


class Distribution(IntEnum):
    """Distribution and use of random numbers; different uses in a fault share no numbers."""

    NORMAL = 0
    UNIFORM = 1
    BEGIN = 2


def fault_key(name: str, position: int) -> Key:
    """Return a fault's key, from its name or else its position in the plan."""
    return (1, *_words(name)) if name else (0, position, 0)


def flow_key(name: str) -> Key:
    """Return the key of a controller's commands."""
    return (1, *_words(name))


def _words(text: str) -> tuple[int, int]:
    digest = hashlib.sha256(text.encode()).digest()
    return int.from_bytes(digest[:4], "little"), int.from_bytes(digest[4:8], "little")


class EpisodeKeys:
    """Keys of the slots' episodes.

    Attributes:
        keys: of each slot. After a seed: the seed and the number of episodes since, independent of the slot. Before
            any seed: the slot and its number of episodes.
        version: changes whenever a key changes.
    """

    def __init__(self, slots: int) -> None:
        self.keys: list[Key] = [(0, slot, 0) for slot in range(slots)]
        self.version = 0

    def advance(self, slots: Sequence[int], seeds: Sequence[int | None]) -> None:
        """Begin new episodes in some slots; a seed of None continues the previous one."""
        for slot, seed in zip(slots, seeds, strict=True):
            seeded, root, number = self.keys[slot]
            self.put(slot, (seeded, root, number + 1) if seed is None else (1, seed, 0))

    def put(self, slot: int, key: Key) -> None:
        """Set the episode of a slot."""
        self.keys[slot] = key
        self.version += 1


class RandomStream:
    """The random numbers of one fault: `width` numbers at each step of each slot."""

    def __init__(self, seed: int, key: Key, distribution: Distribution, width: int, episodes: EpisodeKeys) -> None:
        self._seed, self._key, self._episodes = seed, (*key, int(distribution)), episodes
        self._distribution = distribution
        slots = len(episodes.keys)
        self._numbers = np.empty((slots, BLOCK, width))
        self._block = np.full(slots, -1, np.int64)
        self._rows = np.arange(slots)
        self._version = episodes.version

    def at(self, steps: NDArray[np.int64]) -> Floats:
        """Return the numbers of each slot at its step, of shape (slots, width); `steps` has the shape (slots,)."""
        if self._version != self._episodes.version:
            self._block[:] = -1
            self._version = self._episodes.version
        blocks, within = np.divmod(steps, BLOCK)
        if (blocks != self._block).any():
            for slot in np.flatnonzero(blocks != self._block).tolist():
                self._numbers[slot] = self._draw(self._episodes.keys[slot], int(blocks[slot]))
            self._block = blocks
        numbers: Floats = self._numbers[self._rows, within]
        return numbers

    def _draw(self, episode: Key, block: int) -> Floats:
        source = np.random.SeedSequence(self._seed, spawn_key=(*self._key, *episode, block))
        generator = np.random.Generator(np.random.PCG64(source))
        shape = self._numbers.shape[1:]
        is_normal = self._distribution is Distribution.NORMAL
        return generator.standard_normal(shape) if is_normal else generator.random(shape)
