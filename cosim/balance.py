"""The running balance of a connection: what a plant sent, and what another one received of it."""

from __future__ import annotations

from collections.abc import Sequence

from zenostat.topics.arrays import Floats
from zenostat.topics.connection_balance import ConnectionBalance


class Total:
    """A sum of many terms whose rounding error does not grow: Neumaier's method (ZAMM 54, 39-51, 1974)."""

    __slots__ = ("_rest", "_sum")

    def __init__(self) -> None:
        self._sum = self._rest = 0.0

    def add(self, term: float) -> None:
        """Add a term."""
        total = self._sum + term
        larger, smaller = (self._sum, term) if abs(self._sum) >= abs(term) else (term, self._sum)
        self._rest += (larger - total) + smaller
        self._sum = total

    def copy(self) -> Total:
        """Return an equal sum that changes on its own."""
        other = Total()
        other._sum, other._rest = self._sum, self._rest
        return other

    @property
    def value(self) -> float:
        """The sum."""
        return self._sum + self._rest


_TOTALS = ("sent", "received", "clipped", "resampled", "residual", "stored", "greatest")


class Ledger:
    """The running balance of a connection."""

    def __init__(self, name: str, unit: str) -> None:
        self._name, self._unit, self.missing_steps = name, unit, 0
        self.sent, self.received, self.clipped = Total(), Total(), Total()
        self.resampled, self.residual, self.stored, self.greatest = Total(), Total(), Total(), Total()

    def copy(self) -> Ledger:
        """Return an equal balance that changes on its own."""
        other = Ledger(self._name, self._unit)
        other.missing_steps = self.missing_steps
        for name in _TOTALS:
            setattr(other, name, getattr(self, name).copy())
        return other

    def enter(self, values: Sequence[Floats], source_step_s: float, target_step_s: float) -> None:
        """Enter the exchange of a step.

        Args:
            values: what was sent, what a delay has left of it, this resampled and then limited, and what was received.
            source_step_s: timestep of the first two.
            target_step_s: timestep of the others.
        """
        is_delayed = values[0] is not values[1]
        sent, current, resampled, limited, received = (each.tolist() for each in values)
        for new, old in zip(sent, current, strict=True):
            self.sent.add(new * source_step_s)
            self.greatest.add(abs(new) * source_step_s)
            if is_delayed:
                self.stored.add(new * source_step_s)
                self.stored.add(-old * source_step_s)
            self.resampled.add(old * source_step_s)
        for before, after, got in zip(resampled, limited, received, strict=True):
            self.resampled.add(-before * target_step_s)
            self.clipped.add(before * target_step_s)
            self.clipped.add(-after * target_step_s)
            self.residual.add(after * target_step_s)
            self.residual.add(-got * target_step_s)
            self.received.add(got * target_step_s)

    def balance(self) -> ConnectionBalance:
        """Return the balance so far."""
        return ConnectionBalance(
            self._name,
            self._unit,
            self.sent.value,
            self.received.value,
            self.clipped.value,
            self.resampled.value,
            self.residual.value,
            self.stored.value,
            self.greatest.value,
            self.missing_steps,
        )
