"""Encoding of samples, of which the step exchange determines one part and the plant the other."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

from zenostat.bridge.exchange.step_exchange import StepExchange
from zenostat.bridge.node.plant import SampleSource
from zenostat.topics import codec
from zenostat.topics.messages import Flag

_NO_FLAG, _FIRST, _TRUNCATED = int(Flag.NONE), int(Flag.FIRST), int(Flag.TRUNCATED)
_FALLBACK = int(Flag.FALLBACK)


@dataclass(frozen=True, slots=True)
class SampleHead:
    """The part of a sample that the exchange determines, with the names that `StepExchange` has for it."""

    episode: list[int]
    step: list[int]
    done: list[bool]
    fallback_active: bool
    commanded: bytes
    source_index: bytes
    source_names: list[str]

    @classmethod
    def of(cls, exchange: StepExchange) -> SampleHead:
        """Return the present one."""
        return cls(
            exchange.episode, exchange.step, exchange.done, exchange.fallback_active, exchange.commanded,
            exchange.source_index, [*exchange.source_names],
        )  # fmt: skip


class SampleEncoder:
    """Encodes the samples of one node.

    Args:
        plant: waiting at its samples.
        exchange: at the plant's samples.
    """

    def __init__(self, plant: SampleSource, exchange: StepExchange) -> None:
        self._plant, self._counts = plant, exchange.counts
        run_period = plant.description.run_period
        self._begin_time, self._timestep = run_period.begin, timedelta(seconds=run_period.step_s)

    def time(self, step: int) -> datetime:
        """Return the simulated time of a sample."""
        return self._begin_time + step * self._timestep

    def encode(self, head: SampleHead | StepExchange, values: bytes, fault_free_values: bytes = b"") -> bytes:
        """Return the payload of a sample of the plant's latest timestep."""
        plant, counts, steps = self._plant, self._counts, head.step
        fallback = _FALLBACK if head.fallback_active else _NO_FLAG
        if True in head.done or 0 in steps:
            flags = [
                (_TRUNCATED if done else _NO_FLAG if step else _FIRST) | fallback
                for done, step in zip(head.done, steps, strict=True)
            ]
        else:
            flags = [fallback] * len(steps)
        times, elapsed_s = self._clock(steps)
        return codec.pack(
            episode=head.episode,
            step=steps,
            time=times,
            elapsed_s=elapsed_s,
            flags=flags,
            values=values,
            effective=plant.effective,
            commanded=head.commanded,
            source_index=head.source_index,
            sources=head.source_names,
            late=counts.late,
            rejected=counts.rejected,
            baseline=plant.baseline_values() if plant.has_baseline else b"",
            baseline_effective=plant.baseline_effective() if plant.has_baseline else b"",
            fault_free_values=fault_free_values,
        )

    def _clock(self, steps: list[int]) -> tuple[list[str], list[float]]:
        """Return the simulated time of each slot as an ISO text, and in seconds since its episode's begin."""
        first, slots = steps[0], len(steps)
        if steps.count(first) == slots:
            elapsed = first * self._timestep
            return [(self._begin_time + elapsed).isoformat()] * slots, [elapsed.total_seconds()] * slots
        by_slot = [step * self._timestep for step in steps]
        return [(self._begin_time + e).isoformat() for e in by_slot], [e.total_seconds() for e in by_slot]
