"""Random generators of slots, seeded by `reset`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any
from zlib import crc32

import numpy as np

from zenostat.agent_sdk.wrappers.names import layers


class SlotRandomStreams:
    """One random generator per slot, which a seed restarts.

    Two wrappers of a chain draw different numbers from the same seed.

    Args:
        env: the wrapped environment.
        wrapper_name: the wrapper's class.
        slots: number of slots.
    """

    def __init__(self, env: Any, wrapper_name: str, slots: int) -> None:
        before = sum(type(layer).__name__ == wrapper_name for layer in layers(env))
        self._key = (crc32(wrapper_name.encode()), before)
        self._generators = [np.random.Generator(np.random.PCG64()) for _ in range(slots)]

    def seed(self, slots: Sequence[int], seeds: Sequence[int | None] | None) -> None:
        """Restart the generators of the slots that have a seed."""
        for slot, seed in zip(slots, seeds or [None] * len(slots), strict=True):
            if seed is not None:
                sequence = np.random.SeedSequence(seed, spawn_key=self._key)
                self._generators[slot] = np.random.Generator(np.random.PCG64(sequence))

    def __getitem__(self, slot: int) -> np.random.Generator:
        return self._generators[slot]

    def get_state(self) -> list[dict[str, Any]]:
        """Return each generator's state as plain values."""
        return [{"random": dict(generator.bit_generator.state)} for generator in self._generators]

    def set_state(self, slots: Sequence[Mapping[str, Any]]) -> None:
        """Restore a state that `get_state` returned."""
        for generator, state in zip(self._generators, slots, strict=True):
            generator.bit_generator.state = state["random"]
