"""Run an engine: `python -m eplus_node.engine ORDERS FRAMES PARENT`."""

from __future__ import annotations

import gc
import json
import signal
import socket
import struct
import sys
from typing import NoReturn

from eplus_node.engine.fork import begin, die_with_parent, leave
from eplus_node.engine.process import Engine


def main(descriptor: int, frames: int, parent: int) -> NoReturn:
    """Reads the run's description from the socket and simulates."""
    die_with_parent(parent)
    link = socket.socket(fileno=descriptor)
    length = struct.unpack("<I", link.recv(4, socket.MSG_WAITALL))[0]
    spec = json.loads(link.recv(length, socket.MSG_WAITALL))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the node's to answer
    signal.signal(signal.SIGTERM, lambda *_: leave(0))
    begin(spec)
    gc.disable()  # nothing here makes cycles
    Engine(link, socket.socket(fileno=frames), spec).run()


if __name__ == "__main__":
    main(*map(int, sys.argv[1:4]))
