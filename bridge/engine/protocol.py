"""The protocol between a node and its engine: one frame per timestep each way, over two sockets.

Orders arrive on one socket and frames leave on the other. On a shared socket, the thread that waits for the next order
would be woken each time the node reads a frame. Each frame is an array of native doubles of a fixed length:

    to the node:    [kind, step, sensors…, meters…, feedback…]      kind is one of `FrameKind`
    from the node:  [order, step, actuators…]                       order is one of `OrderKind`; NaN relinquishes

First of all, the node sends the length of a JSON text (a 32-bit little-endian integer) and the text: the fields of an
`EngineSpec`.

A `FORK` order contains the length of a JSON text in place of the step. The text follows, together with the child's
sockets. The engine replies with the child's process id (a native 64-bit integer), or with the negative error number if
the system cannot fork, and keeps waiting at its sample. The child sends its process id on its own socket as well, in
case the engine ends before it can reply, and then continues as any other engine.

A `RESET` order contains the length of a JSON text in place of the step, `{"seed": number}`, and the text follows. The
engine begins another episode and replies with sample 0.

A `SAVE` order likewise contains `{"path": text}`. The engine writes its state to that file and replies with 0 (a native
64-bit integer), or writes the reason to it and replies with -1; it keeps waiting at its sample. EnergyPlus has none
of these orders.

A `RESTORE` order likewise contains the path of such a file. The engine continues from the state and replies with its
sample.

A `REPEAT` order makes the engine send its present sample again. Its reply proves that it is alive: the frame of one
that has died may still wait in the socket, and the system reports a killed process as running for some milliseconds.

A `WARNING` frame contains the length of a UTF-8 text in place of the step, and the text follows; then comes the sample
to which the warning belongs. EnergyPlus sends its severe errors, each distinct text once.

A `FAILED` frame contains the length of a UTF-8 text in place of the step, and the text follows.

Sample 0 is the state after warm-up. EnergyPlus's last sample is sent once it has ended the run without an error.
"""

from __future__ import annotations

import struct
from enum import IntEnum

PROCESS_ID = struct.Struct("=q")
"""Reply to a `FORK` order; of a `SAVE` order, the result."""


class FrameKind(IntEnum):
    """Kinds of frames to the node."""

    SAMPLE = 1
    LAST = 2
    FAILED = 3
    WARNING = 4


class OrderKind(IntEnum):
    """Kinds of frames from the node."""

    STEP = 1
    FINISH = 2
    FORK = 3
    RESET = 4
    SAVE = 5
    REPEAT = 6
    RESTORE = 7
