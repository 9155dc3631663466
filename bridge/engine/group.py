"""The engines of a plant, which step together: one per slot and, with a baseline, a second one per slot."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from zenostat.bridge.engine.client import EngineClient

MAX_AHEAD = 32
"""Largest number of timesteps of a plan that are ordered before their samples are received."""
ORDER_BYTES = 1 << 16
"""Largest size of these orders: a socket takes them while the engine waits to send a sample."""


class EngineGroup:
    """Engines waiting at their samples: what a plant needs to step in engines; see `zenostat.bridge.node.plant`.

    Args:
        actuators: number of actuators of a slot.
        clients: one engine per slot.
        baselines: one engine per slot that receives no commands; empty without a baseline.

    Attributes:
        clients, baselines: as above.
        effective: effective values of all actuators; shape (slots, actuators).
    """

    def __init__(
        self, actuators: int, clients: Iterable[EngineClient] = (), baselines: Iterable[EngineClient] = ()
    ) -> None:
        self.clients = [*clients]
        self.baselines = [*baselines]
        self._row_bytes = 8 * actuators
        self._relinquished = np.full(actuators, np.nan).tobytes()
        self.effective = b""

    def begin(self, slots: Sequence[int]) -> None:
        """Set effective values at the first sample of an episode, at which nothing is commanded."""
        effective = self._rows(self.effective)
        for slot in slots:
            effective[slot] = self.clients[slot].frame.effective(self._relinquished)
        self.effective = b"".join(effective)

    def step(self, commands: bytes, active_slots: Sequence[int]) -> list[bool]:
        """Simulate a timestep in the active slots.

        Args:
            commands: raw float64; NaN relinquishes an actuator; shape (slots, actuators).
            active_slots: slots that step.

        Returns:
            For each active slot, whether this was its last sample.

        Raises:
            SimulatorError: an engine failed or died.
        """
        clients = self.clients
        if len(clients) == 1 and not self.baselines:
            (client,) = clients
            client.send(commands)
            client.receive()
            self.effective = client.frame.effective(commands)
            return [client.last]
        return self._step_all(self._rows(commands), active_slots)

    def _step_all(self, commands: Sequence[bytes], active_slots: Sequence[int]) -> list[bool]:
        clients = self.clients
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
            effective = [client.frame.effective(row) for client, row in zip(clients, commands, strict=True)]
        else:
            effective = self._rows(self.effective)
            for slot in active_slots:
                effective[slot] = clients[slot].frame.effective(commands[slot])
        self.effective = b"".join(effective)
        return [clients[slot].last for slot in active_slots]

    def run(self, commands: Sequence[bytes], active_slots: Sequence[int]) -> Iterator[list[bool]]:
        """Simulate several timesteps in the active slots, each with its commands; see `PlanningPlant.run`.

        An engine does not wait for the others between timesteps: it has the orders of the next ones already.
        """
        ahead = max(1, min(MAX_AHEAD, ORDER_BYTES // (16 + self._row_bytes)))
        rows, clients = [self._rows(command) for command in commands], self.clients
        baselines = [self.baselines[slot] for slot in active_slots] if self.baselines else []
        for number, row in enumerate(rows):
            if due := rows[:ahead] if number == 0 else rows[number + ahead - 1 : number + ahead]:
                for slot in active_slots:
                    clients[slot].send_several([order[slot] for order in due])
                for baseline in baselines:
                    baseline.send_several([self._relinquished] * len(due))
            effective = self._rows(self.effective)
            for slot in active_slots:
                clients[slot].receive()
                effective[slot] = clients[slot].frame.effective(row[slot])
            for baseline in baselines:
                baseline.receive()
            self.effective = b"".join(effective)
            yield [clients[slot].last for slot in active_slots]

    def _rows(self, raw: bytes) -> list[bytes]:
        width = self._row_bytes
        return [raw[slot * width : (slot + 1) * width] for slot in range(len(self.clients))]

    def values(self) -> bytes:
        """Return the latest sensors and meters; shape (slots, points)."""
        if len(self.clients) == 1:
            return self.clients[0].frame.values()
        return b"".join([client.frame.values() for client in self.clients])

    def drain_step_warnings(self) -> list[str]:
        """Return the warnings of the last timesteps; see `zenostat.bridge.node.plant.WarningPlant`."""
        texts = []
        for slot, client in enumerate(self.clients):
            if client.warnings:
                prefix = f"slot {slot}: " if len(self.clients) > 1 else ""
                texts += [f"{prefix}{text}" for text in dict.fromkeys(client.warnings)]
                client.warnings.clear()
        return texts

    @property
    def has_baseline(self) -> bool:
        """Whether there are engines that receive no commands."""
        return bool(self.baselines)

    def baseline_values(self) -> bytes:
        """Return the baseline's latest sensors and meters; shape (slots, points), empty without a baseline."""
        return b"".join([client.frame.values() for client in self.baselines])

    def baseline_effective(self) -> bytes:
        """Return the baseline's effective values; shape (slots, actuators), NaN where the engine reports none."""
        return b"".join([client.frame.effective(self._relinquished) for client in self.baselines])

    @property
    def all(self) -> list[EngineClient]:
        """All engines, baselines last."""
        return [*self.clients, *self.baselines]

    @property
    def simulators(self) -> int:
        """Number of engines."""
        return len(self.clients) + len(self.baselines)

    def check(self) -> None:
        """Raise the `SimulatorError` of an engine that has died before its last sample, if any."""
        for client in self.all:
            if not (client.alive or client.last):
                client.receive()

    def memory_bytes(self, *, private: bool = False) -> int:
        """Return the resident memory of all engines, or only what belongs to a single process; thread-safe."""
        return sum(client.private_bytes if private else client.rss_bytes for client in self.all)

    def members(self, slots: Sequence[int], *, baseline: bool) -> list[EngineClient]:
        """Return the engines of some slots; with `baseline`, those of their baseline as well, last."""
        engines = [self.clients[slot] for slot in slots]
        return engines + [self.baselines[slot] for slot in slots] if baseline and self.baselines else engines

    def adopt(self, engines: Sequence[EngineClient], source: EngineGroup, slots: Sequence[int]) -> None:
        """Take over copies of the engines that `source.members(slots)` returned, with their effective values."""
        self.clients, self.baselines = [*engines[: len(slots)]], [*engines[len(slots) :]]
        rows = source._rows(source.effective)
        self.effective = b"".join([rows[slot] for slot in slots])

    def interrupt(self) -> None:
        """Kill all engines, so that threads waiting for them continue; thread-safe."""
        for client in self.all:
            client.interrupt()

    def abandon(self, reason: str, *, is_starting: bool) -> None:
        """Kill the engines of a timestep that is to be given up; see `AbandonablePlant`."""
        if not is_starting:
            for client in self.all:
                client.interrupt(reason)

    def order_close(self) -> None:
        """Let all engines end, all at once; see `ClosingPlant`."""
        for client in self.all:
            if not client.order_close():
                client.interrupt("its run is over")

    @property
    def has_ended(self) -> bool:
        """Whether all processes have ended."""
        return not any(client.alive for client in self.all)

    def end(self, *, failed: bool = False) -> None:
        """End all engines; where output is kept, the simulator may finish its files. Idempotent."""
        for client in self.all:
            if not client.order_close() and client.spec.branch:
                client.interrupt()  # all at once: a process takes a while to end
        for client in self.all:
            client.end(failed=failed)

    def close(self) -> None:
        """End all engines; idempotent."""
        self.end()
