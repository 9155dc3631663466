"""Random numbers of faults: a function of the plan's seed, the fault, the episode and the step.

Nothing is drawn one after another, so no fault changes another's numbers, a window that is moved leaves the numbers
of a step as they are, and whoever goes back to a step finds the same ones. NumPy's `SeedSequence` keeps streams with
different keys independent.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

BLOCK = 64
"""Steps that are drawn at once: to begin a stream costs as much as some hundred numbers."""

Key = tuple[int, ...]


class Distribution(IntEnum):
    """What is drawn, and for what; no two uses of a fault share numbers."""

    NORMAL = 0
    UNIFORM = 1
    BEGIN = 2


def fault_key(name: str, position: int) -> Key:
    """A fault's key: its own name, or its place if it has none."""
    return (1, *_words(name)) if name else (0, position, 0)


def flow_key(name: str) -> Key:
    """The key of what one controller says."""
    return (1, *_words(name))


def _words(text: str) -> tuple[int, int]:
    digest = hashlib.sha256(text.encode()).digest()
    return int.from_bytes(digest[:4], "little"), int.from_bytes(digest[4:8], "little")


class EpisodeKeys:
    """Which episode each slot is in.

    Attributes:
        keys: of each slot. After a seed: that and the episodes since, wherever the slot is. Before any: the slot
            and its episodes.
        version: changes whenever a key does.
    """

    def __init__(self, slots: int) -> None:
        self.keys: list[Key] = [(0, slot, 0) for slot in range(slots)]
        self.version = 0

    def turn(self, slots: Sequence[int], seeds: Sequence[int | None]) -> None:
        """New episodes of some slots; with None the next one of the former seed."""
        for slot, seed in zip(slots, seeds, strict=True):
            seeded, root, number = self.keys[slot]
            self.put(slot, (seeded, root, number + 1) if seed is None else (1, seed, 0))

    def put(self, slot: int, key: Key) -> None:
        """Has a slot be in an episode."""
        self.keys[slot] = key
        self.version += 1


class RandomStream:
    """The numbers of one fault, `width` at each step of each slot."""

    def __init__(self, seed: int, key: Key, law: Distribution, width: int, episodes: EpisodeKeys) -> None:
        self._seed, self._key, self._law, self._episodes = seed, (*key, int(law)), law, episodes
        slots = len(episodes.keys)
        self._numbers = np.empty((slots, BLOCK, width))
        self._block = np.full(slots, -1, np.int64)
        self._rows = np.arange(slots)
        self._version = episodes.version

    def at(self, steps: NDArray[np.int64]) -> NDArray[np.float64]:
        """Shape (slots, width), of each slot at its step, `steps` having shape (slots,)."""
        if self._version != self._episodes.version:
            self._block[:] = -1
            self._version = self._episodes.version
        blocks, within = np.divmod(steps, BLOCK)
        if (blocks != self._block).any():
            for slot in np.flatnonzero(blocks != self._block).tolist():
                self._numbers[slot] = self._draw(self._episodes.keys[slot], int(blocks[slot]))
            self._block = blocks
        found: NDArray[np.float64] = self._numbers[self._rows, within]
        return found

    def _draw(self, episode: Key, block: int) -> NDArray[np.float64]:
        source = np.random.SeedSequence(self._seed, spawn_key=(*self._key, *episode, block))
        generator = np.random.Generator(np.random.PCG64(source))
        shape = self._numbers.shape[1:]
        return generator.standard_normal(shape) if self._law is Distribution.NORMAL else generator.random(shape)
