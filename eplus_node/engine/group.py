"""The engines of a node, which step together: one per slot and, with a baseline, a second one per slot."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from eplus_node.engine.client import EngineClient, start_all


class EngineGroup:
    """Engines waiting at their samples. Arrays are raw float64 in slot order.

    Args:
        clients: one engine per slot.
        baselines: one engine per slot that receives no commands; empty without a baseline.

    Attributes:
        clients, baselines: as above.
        effective: effective values of all actuators; shape (slots, actuators).
        source_index: sources of these values, uint16 of the same shape.
    """

    def __init__(self, clients: Sequence[EngineClient], baselines: Sequence[EngineClient] = ()) -> None:
        self.clients = [*clients]
        self.baselines = [*baselines]
        self._row_bytes = 8 * len(clients[0].spec.points.actuators)
        self._source_bytes = self._row_bytes // 4  # uint16 beside float64
        self._relinquished = np.full(self._row_bytes // 8, np.nan).tobytes()
        self.effective = b""
        self.source_index = b""

    def begin(self, slots: Sequence[int]) -> None:
        """Set effective values and sources at the first sample of an episode, under baseline control."""
        effective, sources = self._rows(self.effective), self._split(self.source_index, self._source_bytes)
        for slot in slots:
            effective[slot] = self.clients[slot].effective_bytes(self._relinquished)
            sources[slot] = bytes(self._source_bytes)
        self.effective, self.source_index = b"".join(effective), b"".join(sources)

    def step(self, values: bytes, source_index: bytes, active_slots: Sequence[int]) -> list[bool]:
        """Simulate a timestep in the active slots.

        Args:
            values: commands; NaN relinquishes an actuator; shape (slots, actuators).
            source_index: sources of these commands, uint16 of the same shape.
            active_slots: slots that step.

        Returns:
            For each active slot, whether this was its last sample.

        Raises:
            SimulatorError: an engine failed or died.
        """
        clients = self.clients
        if len(clients) == 1 and not self.baselines:
            (client,) = clients
            client.send(values)
            client.receive()
            self.effective, self.source_index = client.effective_bytes(values), source_index
            return [client.last]
        return self._step_all(values, source_index, active_slots)

    def _step_all(self, values: bytes, source_index: bytes, active_slots: Sequence[int]) -> list[bool]:
        clients, commands = self.clients, self._rows(values)
        for slot in active_slots:
            clients[slot].send(commands[slot])
        baselines = [self.baselines[slot] for slot in active_slots] if self.baselines else []
        for baseline in baselines:
            baseline.send(self._relinquished)
        for baseline in baselines:
            baseline.receive()
        for slot in active_slots:
            clients[slot].receive()
        if len(active_slots) == len(clients):
            effective = [client.effective_bytes(row) for client, row in zip(clients, commands, strict=True)]
        else:
            effective, source_index = self._merge(commands, source_index, active_slots)
        self.effective, self.source_index = b"".join(effective), source_index
        return [clients[slot].last for slot in active_slots]

    def _merge(
        self, commands: Sequence[bytes], source_index: bytes, active_slots: Sequence[int]
    ) -> tuple[list[bytes], bytes]:
        """Return effective values and sources of all slots when only some of them have stepped."""
        width = self._source_bytes
        effective, sources = self._rows(self.effective), self._split(self.source_index, width)
        stepped = self._split(source_index, width)
        for slot in active_slots:
            effective[slot], sources[slot] = self.clients[slot].effective_bytes(commands[slot]), stepped[slot]
        return effective, b"".join(sources)

    def _rows(self, raw: bytes) -> list[bytes]:
        return self._split(raw, self._row_bytes)

    def _split(self, raw: bytes, width: int) -> list[bytes]:
        return [raw[slot * width : (slot + 1) * width] for slot in range(len(self.clients))]

    def values_bytes(self) -> bytes:
        """Return the latest sensors and meters; shape (slots, points)."""
        if len(self.clients) == 1:
            return self.clients[0].values_bytes()
        return b"".join([client.values_bytes() for client in self.clients])

    def baseline_bytes(self) -> bytes:
        """Return the baseline's latest sensors and meters; shape (slots, points), empty without a baseline."""
        return b"".join([client.values_bytes() for client in self.baselines])

    def baseline_effective(self) -> bytes:
        """Return the baseline's effective values; shape (slots, actuators), NaN where EnergyPlus has no feedback."""
        return b"".join([client.effective_bytes(self._relinquished) for client in self.baselines])

    @property
    def all(self) -> list[EngineClient]:
        """All engines, baselines last."""
        return [*self.clients, *self.baselines]

    @property
    def alive(self) -> bool:
        """Whether all processes are running, except those that have sent their last sample."""
        return all(client.alive or client.last for client in self.all)

    def raise_if_dead(self) -> None:
        """Raise the `SimulatorError` of an engine that has died, if any."""
        for client in self.all:
            if not (client.alive or client.last):
                client.receive()

    @property
    def rss_bytes(self) -> int:
        """Resident memory of all engines; shared pages count once per engine."""
        return sum(client.rss_bytes for client in self.all)

    @property
    def private_bytes(self) -> int:
        """Memory of all engines that belongs to a single process."""
        return sum(client.private_bytes for client in self.all)

    def fork(self, fork_engine: Callable[[EngineClient], EngineClient]) -> EngineGroup:
        """Return a copy at the same samples; `fork_engine` forks one engine.

        Raises:
            SimulatorError: an engine cannot be forked; no forks remain.
        """
        forks, slots = start_all(self.all, fork_engine), len(self.clients)
        copy = EngineGroup(forks[:slots], forks[slots:])
        copy.effective, copy.source_index = self.effective, self.source_index
        return copy

    def of_slot(self, slot: int, forks: Sequence[EngineClient]) -> EngineGroup:
        """Return a group of forks of one slot's engine, all with the state of that slot."""
        copy = EngineGroup(forks)
        copy.effective = self._rows(self.effective)[slot] * len(forks)
        copy.source_index = self._split(self.source_index, self._source_bytes)[slot] * len(forks)
        return copy

    def interrupt(self) -> None:
        """Kill all engines, so that threads waiting for them continue; thread-safe."""
        for client in self.all:
            client.interrupt()

    def end(self, *, failed: bool = False) -> None:
        """End all engines; where output is kept, EnergyPlus may finish its files. Idempotent."""
        for client in self.all:
            client.end(failed=failed)
