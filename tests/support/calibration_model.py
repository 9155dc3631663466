"""A model of three parameters that takes no time, for tests of calibrations."""

import signal
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date, datetime, timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

TRUTH = {"day": 1.4, "night": 0.7, "offset": 1.5}
WINTER, SUMMER, HELD_OUT = (
    (date(2017, 1, 9), date(2017, 1, 11)),
    (date(2017, 7, 10), date(2017, 7, 12)),
    (date(2017, 4, 3), date(2017, 4, 4)),
)


@dataclass(frozen=True)
class Series:
    """Simulated series that a column is compared with."""

    name: str
    unit: str
    summed: bool


SERIES = (Series("electricity", "J", True), Series("room", "degC", False))


class Interrupted(KeyboardInterrupt):
    """Ctrl-C in the middle of a simulation."""


@dataclass
class LinearModel:
    """Electricity in J, with a part by day and one by night, and a temperature with an offset.

    Attributes:
        left: number of simulations before one is interrupted; negative: none is.
        kill: whether the process is killed instead.
    """

    left: int = -1
    kill: bool = False

    def simulate(self, values: Mapping[str, float], days: tuple[date, date]) -> NDArray[np.float64]:
        """Return the hours of a period; what is not in `values` leaves the model as it is."""
        if self.left == 0:
            if self.kill:
                signal.raise_signal(signal.SIGKILL)
            raise Interrupted
        self.left -= 1
        hour = np.arange(24 * ((days[1] - days[0]).days + 1)) % 24
        is_day = (hour >= 8) & (hour < 18)
        electricity = 3.6e6 * np.where(is_day, 5.0 * values.get("day", 1.0), 2.0 * values.get("night", 1.0))
        room = 20.0 + np.sin(hour / 24 * 2 * np.pi) + values.get("offset", 0.0)
        return np.stack([electricity, room], axis=1)


def write_measured(path: Path, *, noise: float = 0.0) -> Path:
    """Write what the true model gives, in kWh and degC, with relative noise."""
    rng = np.random.Generator(np.random.PCG64(0))
    lines = ["time,electricity [kWh],room [degC]"]
    for days in sorted((WINTER, SUMMER, HELD_OUT)):
        begin = datetime(days[0].year, days[0].month, days[0].day)
        for hour, (energy, room) in enumerate(LinearModel().simulate(TRUTH, days).tolist()):
            factor = 1.0 + noise * rng.standard_normal()
            lines.append(f"{begin + timedelta(hours=hour + 1)},{energy / 3.6e6 * factor!r},{room!r}")
    path.write_text("\n".join(lines) + "\n")
    return path
