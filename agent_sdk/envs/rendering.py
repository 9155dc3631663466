"""A picture of an environment's last day."""

from __future__ import annotations

from collections import deque
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topics.extras import import_extra
from topics.messages import Manifest

_DAY = timedelta(days=1)
_SIZE_IN, _DPI = (9.6, 6.4), 100
_MAX_LINES = 12


class RollingHistory:
    """The samples of the last day, and a picture of them."""

    def __init__(self, manifest: Manifest) -> None:
        import_extra("matplotlib.figure", "plots", "render_mode='rgb_array'")
        self._manifest = manifest
        units = [sensor.unit for sensor in manifest.sensors]
        self._panels = {
            "degC": [i for i, unit in enumerate(units) if unit == "degC"],
            "W": [i for i, unit in enumerate(units) if unit == "W"],
        }
        self._rows: deque[tuple[datetime, NDArray[np.float64]]] = deque()

    def clear(self) -> None:
        """Remove all samples."""
        self._rows.clear()

    def add(self, time: datetime, values: NDArray[np.float64]) -> None:
        """Add a sample and remove those older than a day."""
        self._rows.append((time, values))
        while time - self._rows[0][0] > _DAY:
            self._rows.popleft()

    def picture(self) -> NDArray[np.uint8]:
        """Draw temperatures and powers of the last day, shape (640, 960, 3), 0 to 255."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        figure = Figure(_SIZE_IN, _DPI, layout="constrained")
        canvas: Any = FigureCanvasAgg(figure)
        shown = {unit: columns for unit, columns in self._panels.items() if columns}
        axes: Any = figure.subplots(max(len(shown), 1), 1, sharex=True, squeeze=False)
        times = [time for time, _ in self._rows]
        table = np.array([values for _, values in self._rows]).reshape(len(times), -1)
        for (unit, columns), axis in zip(shown.items(), axes[:, 0], strict=False):
            for column in columns[:_MAX_LINES]:
                axis.plot(times, table[:, column], label=self._manifest.sensors[column].name, linewidth=1.2)
            axis.set_ylabel(unit)
            axis.grid(visible=True, alpha=0.3)
            axis.legend(fontsize="x-small", loc="upper left", bbox_to_anchor=(1.0, 1.0))
        title = f"{self._manifest.building}, {self._manifest.location}"
        figure.suptitle(f"{title}: {times[-1]:%Y-%m-%d %H:%M}" if times else title, fontsize="medium")
        figure.autofmt_xdate()
        canvas.draw()
        return np.asarray(canvas.buffer_rgba())[..., :3].copy()
