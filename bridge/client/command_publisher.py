"""The commands of a controller: encoding and publisher."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
import zenoh
from zenoh import CongestionControl

from zenostat.bridge.client.presence import undeclare
from zenostat.topics import codec, keys
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidAction
from zenostat.topics.messages import Command, CommandOp, Manifest, Sample
from zenostat.topics.points import actuator_index, check_command

# Plain integers: an exception that a signal handler raises inside NumPy's access to an enum member is lost, such as the
# KeyboardInterrupt of Ctrl-C.
_KEEP, _SET, _RELINQUISH = int(CommandOp.KEEP), int(CommandOp.SET), int(CommandOp.RELINQUISH)


class CommandArrays:
    """Converts the values of commands to a node to raw arrays.

    Args:
        manifest: The node's manifest.
    """

    def __init__(self, manifest: Manifest) -> None:
        self._slots = manifest.slots
        self._index = actuator_index(manifest, InvalidAction)
        count = len(manifest.actuators)
        self._shape = (manifest.slots, count) if manifest.slots > 1 else (count,)

    def of(
        self, values: Mapping[str, float | None] | Floats | None, operations: bytes | None
    ) -> tuple[bytes, bytes | None]:
        """Return raw values and operations; arguments and errors as of `ControllerLink.send`."""
        if isinstance(values, np.ndarray):
            if values.shape != self._shape:
                raise InvalidAction(f"values of shape {values.shape}; {self._shape} expected: one for each actuator")
            return values.astype(codec.FLOAT, copy=False).tobytes(), operations
        if not isinstance(values, Mapping | None):
            raise InvalidAction(f"a mapping of actuators to values, or an array expected, got {values!r}")
        row, codes = np.zeros(len(self._index)), np.full(len(self._index), _KEEP, np.uint8)
        for name, value in (values or {}).items():
            index = self._index[name]
            check_command(name, value)
            row[index], codes[index] = (0.0, _RELINQUISH) if value is None else (value, _SET)
        return row.tobytes() * self._slots, codes.tobytes() * self._slots


class CommandPublisher:
    """Encodes and publishes the commands of one controller to one node.

    Args:
        session: An open Zenoh session.
        manifest: The node's manifest.
        controller: The controller's name on the bus.

    Attributes:
        put: Publishes an encoded command.
    """

    def __init__(self, session: zenoh.Session, manifest: Manifest, controller: str) -> None:
        self._publisher = session.declare_publisher(
            keys.COMMAND.at(manifest.node, sender=controller),
            encoding=zenoh.Encoding(codec.encoding(Command)),
            congestion_control=CongestionControl.BLOCK,
        )
        self.put = self._publisher.put
        self._arrays = CommandArrays(manifest)

    def close(self) -> None:
        """Undeclare the publisher."""
        undeclare(self._publisher)

    def encode(
        self,
        sample: Sample,
        values: Mapping[str, float | None] | Floats | None,
        operations: bytes | None,
        still: Collection[int],
    ) -> bytes:
        """Return the command that answers a sample; other arguments and errors as of `ControllerLink.send`."""
        raw, operations = self._arrays.of(values, operations)
        steps = [None if slot in still else step for slot, step in enumerate(sample.step)] if still else sample.step
        return codec.pack(episode=sample.episode, step=steps, operations=operations, values=raw)
