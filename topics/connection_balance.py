"""The balance of a connection of a district, and the names of its terms in points."""

from __future__ import annotations

from dataclasses import dataclass

TERMS = ("sent", "clipped", "resampled", "residual", "stored")
"""Terms besides `received`; `balance.CONNECTION.TERM` is a point of the district."""


@dataclass(frozen=True, slots=True)
class ConnectionBalance:
    """Balance of a connection over some time: sent = received + clipped + resampled + residual + stored.

    All terms are means in the target's unit, or all are integrals over time in that unit times seconds (J for W).

    Attributes:
        name: of the connection.
        unit: of the target.
        sent: what the source had, after the conversion of units.
        received: what was commanded to the target's plant.
        clipped: what the bounds cut off.
        resampled: what `hold` or `interpolate` add or leave out; 0 for `mean` and equal timesteps.
        residual: what the source of a solved connection had above the value that was accepted.
        stored: increase of what a delay holds.
        greatest: that of the absolute values that were sent, to which the closure is related.
        missing_steps: number of steps in which the source had no value, which all terms leave out.
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
    missing_steps: int = 0

    @property
    def label(self) -> str:
        """Name of the connection, with the number of steps that are left out, if any."""
        return f"{self.name} (steps without a value: {self.missing_steps})" if self.missing_steps else self.name

    @property
    def closure(self) -> float:
        """Part that is missing, relative to the absolute values that were sent; 0 but for rounding."""
        rest = self.sent - self.received - self.clipped - self.resampled - self.residual - self.stored
        return rest / max(self.greatest, 1e-300)
