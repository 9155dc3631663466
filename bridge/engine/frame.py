"""The latest frame that an engine has sent: its kind, a number, values and feedback."""

from __future__ import annotations

import numpy as np

from zenostat.bridge.engine.spec import EngineSpec


class Frame:
    """A buffer for the frames of an engine.

    Args:
        spec: what the engine simulates.

    Attributes:
        buffer: the bytes of a whole frame.
    """

    __slots__ = ("_feedback", "_numbers", "_values", "_with_feedback", "buffer")

    def __init__(self, spec: EngineSpec) -> None:
        self._with_feedback = [*spec.feedback]
        self.buffer = memoryview(bytearray(8 * (2 + spec.values + len(self._with_feedback))))
        self._numbers = self.buffer.cast("d")
        self._values = self.buffer[16 : 16 + 8 * spec.values]
        self._feedback = self.buffer[16 + 8 * spec.values :]

    @property
    def kind(self) -> float:
        """The `FrameKind`."""
        return self._numbers[0]

    @property
    def number(self) -> int:
        """Number of the sample; after a failure, the length of the text that follows in bytes."""
        return int(self._numbers[1])

    def values(self) -> bytes:
        """Return sensors and meters as raw float64."""
        return bytes(self._values)

    def effective(self, commanded: bytes) -> bytes:
        """Return the effective value of each actuator as raw float64: the engine's feedback, else `commanded`."""
        if len(self._with_feedback) * 8 == len(commanded):
            return bytes(self._feedback)
        effective = np.frombuffer(commanded).copy()
        effective[self._with_feedback] = np.frombuffer(self._feedback)
        return effective.tobytes()
