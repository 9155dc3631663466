"""The frame protocol between a node and its engines.

Orders come on one socket and frames go on
another: on a shared one, whoever sleeps for the next order would be woken when the node reads a frame. Each frame is
an array of native doubles of one fixed length:

    to the node:    [kind, step, sensors…, meters…, feedback…]      kind is one of `BusMessage`
    from the node:  [order, step, actuators…]                       order is one of `OrderKind`; NaN releases

A `FORK` order has the length of a JSON text in place of the step; the text follows, and with it the child's
sockets. The engine says the child's process id (a native 64-bit integer), or the negative number of the error where
the system cannot fork, and waits on at its sample. The child says its process id on its own as well, should
the engine end before it could, and then goes on as any engine.

A `FAILED` frame has the length of a UTF-8 text in place of the step, and the text follows.
Sample 0 is the state after warm-up. The last sample is sent once EnergyPlus has ended the run by itself,
so that it stands for a run that was good to its end.
"""

from __future__ import annotations

import struct
from enum import IntEnum

PROCESS_ID = struct.Struct("=q")


class FrameKind(IntEnum):
    """Kinds of frames to the node."""

    SAMPLE = 1
    LAST = 2
    FAILED = 3


class OrderKind(IntEnum):
    """Kinds of frames from the node."""

    STEP = 1
    FINISH = 2
    FORK = 3
