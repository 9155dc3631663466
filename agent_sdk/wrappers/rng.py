"""A random generator for each slot, ruled by the seeds of `reset`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any
from zlib import crc32

import numpy as np

from agent_sdk.wrappers.names import layers


class SlotRandomStreams:
    """Generators that begin anew with a seed and go on without one.

    Two wrappers of a chain draw differently from the same seed.
    """

    def __init__(self, env: Any, who: str, slots: int) -> None:
        before = sum(type(layer).__name__ == who for layer in layers(env))
        self._key = (crc32(who.encode()), before)
        self._all = [np.random.Generator(np.random.PCG64()) for _ in range(slots)]

    def seed(self, slots: Sequence[int], seeds: Sequence[int | None] | None) -> None:
        """Begins anew where a seed was given."""
        for slot, seed in zip(slots, seeds or [None] * len(slots), strict=True):
            if seed is not None:
                sequence = np.random.SeedSequence(seed, spawn_key=self._key)
                self._all[slot] = np.random.Generator(np.random.PCG64(sequence))

    def __getitem__(self, slot: int) -> np.random.Generator:
        return self._all[slot]

    def get_state(self) -> list[dict[str, Any]]:
        """For each slot, as plain values."""
        return [{"random": dict(generator.bit_generator.state)} for generator in self._all]

    def set_state(self, slots: Sequence[Mapping[str, Any]]) -> None:
        """Goes on from `get_state`."""
        for generator, state in zip(self._all, slots, strict=True):
            generator.bit_generator.state = state["random"]
