"""The balance of a connection: what a plant sent, and what another one received of it."""

from __future__ import annotations

from dataclasses import dataclass


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

    @property
    def value(self) -> float:
        """The sum."""
        return self._sum + self._rest


@dataclass(frozen=True, slots=True)
class Balance:
    """Balance of a connection since sample 0: sent = received + clipped + resampled + residual + stored.

    All terms are integrals over time in the target's unit times seconds (J for W), each summed on its own.

    Attributes:
        name: of the connection.
        unit: of the target.
        sent: what the source had, after the conversion of units.
        received: what was commanded to the target's plant.
        clipped: what the bounds cut off.
        resampled: what `hold` or `interpolate` add or leave out; 0 for `mean` and equal timesteps.
        residual: what the source of a solved connection had above the value that was accepted.
        stored: increase of what a delay holds.
        greatest: sum of the absolute values that were sent, to which the closure is related.
    """

    name: str
    unit: str
    sent: float
    received: float
    clipped: float
    resampled: float
    residual: float
    stored: float
    greatest: float

    @property
    def closure(self) -> float:
        """Part that is missing, relative to the absolute values that were sent; 0 but for rounding."""
        rest = self.sent - self.received - self.clipped - self.resampled - self.residual - self.stored
        return rest / max(self.greatest, 1e-300)


class Ledger:
    """The running balance of a connection."""

    def __init__(self, name: str, unit: str) -> None:
        self._name, self._unit = name, unit
        self.sent, self.received, self.clipped = Total(), Total(), Total()
        self.resampled, self.residual, self.stored, self.greatest = Total(), Total(), Total(), Total()

    def balance(self) -> Balance:
        """Return the balance so far."""
        return Balance(
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
