"""Run an engine: `python -m eplus_node.engine ORDERS FRAMES PARENT`.

The arguments are the descriptors of two sockets and the node's process id.
"""

from __future__ import annotations

import gc
import json
import signal
import socket
import struct
import sys
from typing import NoReturn

from bridge.engine.system_calls import die_with_parent, leave, set_up_process
from eplus_node.engine.process import Engine


def main(orders_descriptor: int, frames_descriptor: int, parent: int) -> NoReturn:
    """Read the run's specification from the socket and simulate."""
    die_with_parent(parent)
    orders = socket.socket(fileno=orders_descriptor)
    length = struct.unpack("<I", orders.recv(4, socket.MSG_WAITALL))[0]
    spec = json.loads(orders.recv(length, socket.MSG_WAITALL))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the node handles Ctrl-C
    signal.signal(signal.SIGTERM, lambda *_: leave(0))
    set_up_process(spec)
    gc.disable()  # an engine creates no reference cycles
    Engine(orders, socket.socket(fileno=frames_descriptor), spec).run()


if __name__ == "__main__":
    main(*map(int, sys.argv[1:4]))
