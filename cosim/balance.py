"""The running balance of a connection: what a plant sent, and what another one received of it."""

from __future__ import annotations

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
        self._name, self._unit = name, unit
        self.sent, self.received, self.clipped = Total(), Total(), Total()
        self.resampled, self.residual, self.stored, self.greatest = Total(), Total(), Total(), Total()

    def copy(self) -> Ledger:
        """Return an equal balance that changes on its own."""
        other = Ledger(self._name, self._unit)
        for name in _TOTALS:
            setattr(other, name, getattr(self, name).copy())
        return other

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
        )
