"""A controller's values as the arrays of a command message."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from zenostat.topics import codec
from zenostat.topics.errors import InvalidAction
from zenostat.topics.messages import CommandOp, Manifest
from zenostat.topics.points import actuator_index

# Plain integers: an exception that a signal handler raises inside NumPy's access to an enum member is lost, such as the
# KeyboardInterrupt of Ctrl-C.
_KEEP, _SET, _RELINQUISH = int(CommandOp.KEEP), int(CommandOp.SET), int(CommandOp.RELINQUISH)


class CommandEncoder:
    """Encodes values for the actuators of one node."""

    def __init__(self, manifest: Manifest) -> None:
        self._slots = manifest.slots
        self._index = actuator_index(manifest.actuators, InvalidAction)
        count = len(manifest.actuators)
        self._shape = (manifest.slots, count) if manifest.slots > 1 else (count,)

    def encode(
        self, values: Mapping[str, float | None] | NDArray[np.float64] | None, operations: bytes | None
    ) -> tuple[bytes, bytes | None]:
        """Return raw values and operations; arguments and errors as of `ControllerLink.send`."""
        if isinstance(values, np.ndarray):
            if values.shape != self._shape:
                raise InvalidAction(f"values of shape {values.shape}; {self._shape} expected: one for each actuator")
            return values.astype(codec.FLOAT, copy=False).tobytes(), operations
        row, codes = np.zeros(len(self._index)), np.full(len(self._index), _KEEP, np.uint8)
        for name, value in (values or {}).items():
            index = self._index[name]
            if value is not None and not np.isfinite(value):
                raise InvalidAction(f"{name} = {value}; a finite number or None (relinquish) expected")
            row[index], codes[index] = (0.0, _RELINQUISH) if value is None else (value, _SET)
        return row.tobytes() * self._slots, codes.tobytes() * self._slots
