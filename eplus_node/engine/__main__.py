"""Run an engine: `python -m zenostat.eplus_node.engine ORDERS FRAMES PARENT`.

The arguments are the descriptors of two sockets and the node's process id.
"""

from __future__ import annotations

import gc
import socket
import sys
from typing import NoReturn

from zenostat.bridge.engine.system_calls import receive_spec
from zenostat.eplus_node.engine.timestep_exchange import Engine


def main(orders_descriptor: int, frames_descriptor: int, parent: int) -> NoReturn:
    """Read the run's specification from the socket and simulate."""
    orders = socket.socket(fileno=orders_descriptor)
    spec = receive_spec(orders, parent)
    gc.disable()  # an engine creates no reference cycles
    Engine(orders, socket.socket(fileno=frames_descriptor), spec).run()


if __name__ == "__main__":
    main(*map(int, sys.argv[1:4]))
