"""The engines of a node, which step together: one for each slot, and beside them the baseline's, if there is one."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from eplus_node.engine.client import EngineClient, start_all


class EngineGroup:
    """Engines at their samples. Arrays are raw float64, in slot order.

    Args:
        links: an engine for each slot.
        baselines: for each slot one that nobody commands; empty if there are none.

    Attributes:
        links, baselines: those.
    """

    def __init__(self, links: Sequence[EngineClient], baselines: Sequence[EngineClient] = ()) -> None:
        self.links = [*links]
        self.baselines = [*baselines]
        self._width = 8 * len(links[0].run.points.actuators)
        self._ruler_width = self._width // 4  # uint16 beside float64
        self._nobody = np.full(self._width // 8, np.nan).tobytes()
        self.effective = b""
        self.source_index = b""

    def begin(self, slots: Sequence[int]) -> None:
        """What holds at an episode's first sample: nobody rules."""
        rows, who = self._rows(self.effective), self._parts(self.source_index, self._ruler_width)
        for slot in slots:
            rows[slot], who[slot] = self.links[slot].effective_bytes(self._nobody), bytes(self._ruler_width)
        self.effective, self.source_index = b"".join(rows), b"".join(who)

    def step(self, values: bytes, source_index: bytes, moving: Sequence[int]) -> list[bool]:
        """Simulates a timestep in the slots that move.

        Args:
            values: for each actuator, NaN releasing it; shape (slots, actuators).
            source_index: who set them, uint16 of that shape.
            moving: slots.

        Returns:
            For each of `moving`, whether this was its last sample.

        Raises:
            SimulatorError: an engine failed or died.
        """
        links = self.links
        if len(links) == 1 and not self.baselines:
            (link,) = links
            link.send(values)
            link.receive()
            self.effective, self.source_index = link.effective_bytes(values), source_index
            return [link.last]
        return self._step_all(values, source_index, moving)

    def _step_all(self, values: bytes, source_index: bytes, moving: Sequence[int]) -> list[bool]:
        links, wanted = self.links, self._rows(values)
        for slot in moving:
            links[slot].send(wanted[slot])
        beside = [self.baselines[slot] for slot in moving] if self.baselines else []
        for link in beside:
            link.send(self._nobody)
        for link in beside:
            link.receive()
        for slot in moving:
            links[slot].receive()
        if len(moving) == len(links):
            effective = [link.effective_bytes(row) for link, row in zip(links, wanted, strict=True)]
        else:
            effective, source_index = self._of_those(wanted, source_index, moving)
        self.effective, self.source_index = b"".join(effective), source_index
        return [links[slot].last for slot in moving]

    def _of_those(
        self, wanted: Sequence[bytes], source_index: bytes, moving: Sequence[int]
    ) -> tuple[list[bytes], bytes]:
        """What was applied and who rules, by slot, where only some have gone on."""
        width = self._ruler_width
        effective, who, whose = (
            self._rows(self.effective),
            self._parts(self.source_index, width),
            self._parts(source_index, width),
        )
        for slot in moving:
            effective[slot], who[slot] = self.links[slot].effective_bytes(wanted[slot]), whose[slot]
        return effective, b"".join(who)

    def _rows(self, raw: bytes) -> list[bytes]:
        return self._parts(raw, self._width)

    def _parts(self, raw: bytes, width: int) -> list[bytes]:
        return [raw[slot * width : (slot + 1) * width] for slot in range(len(self.links))]

    def values_bytes(self) -> bytes:
        """The latest sensors and meters, shape (slots, points)."""
        if len(self.links) == 1:
            return self.links[0].values_bytes()
        return b"".join([link.values_bytes() for link in self.links])

    def baseline_bytes(self) -> bytes:
        """The baseline's latest sensors and meters, shape (slots, points); empty if there is none."""
        return b"".join([link.values_bytes() for link in self.baselines])

    def baseline_effective(self) -> bytes:
        """What the building's own control set the baseline's actuators to, shape (slots, actuators); NaN: not told."""
        return b"".join([link.effective_bytes(self._nobody) for link in self.baselines])

    @property
    def all(self) -> list[EngineClient]:
        """All of them."""
        return [*self.links, *self.baselines]

    @property
    def alive(self) -> bool:
        """Whether all processes run, but for those that have come to their last sample."""
        return all(link.alive or link.last for link in self.all)

    def raise_if_dead(self) -> None:
        """Raises what a dead one has to say: `SimulatorError`; nothing if all live."""
        for link in self.all:
            if not (link.alive or link.last):
                link.receive()

    @property
    def rss_bytes(self) -> int:
        """Resident memory of all, shared pages counted once for each."""
        return sum(link.rss_bytes for link in self.all)

    @property
    def private_bytes(self) -> int:
        """Memory that is one process's alone, of all."""
        return sum(link.private_bytes for link in self.all)

    def fork(self, child: Callable[[EngineClient], EngineClient]) -> EngineGroup:
        """A copy that stands at the same samples; `child` forks one engine.

        Raises:
            SimulatorError: one cannot be forked; then none is.
        """
        made, slots = start_all(self.all, child), len(self.links)
        copy = EngineGroup(made[:slots], made[slots:])
        copy.effective, copy.source_index = self.effective, self.source_index
        return copy

    def of_slot(self, slot: int, made: Sequence[EngineClient]) -> EngineGroup:
        """Engines forked from those of one slot: each stands where that one does."""
        copy = EngineGroup(made)
        copy.effective = self._rows(self.effective)[slot] * len(made)
        copy.source_index = self._parts(self.source_index, self._ruler_width)[slot] * len(made)
        return copy

    def interrupt(self) -> None:
        """Ends those that are computing, so that whoever waits for them is told; any thread may."""
        for link in self.all:
            link.interrupt()

    def end(self, *, failed: bool = False) -> None:
        """Ends all; where its files are kept, EnergyPlus may finish them. Twice is fine."""
        for link in self.all:
            link.end(failed=failed)
