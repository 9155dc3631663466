"""The part of a sample that the step exchange determines."""

from __future__ import annotations

from dataclasses import dataclass

from zenostat.bridge.exchange.step_exchange import StepExchange


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
