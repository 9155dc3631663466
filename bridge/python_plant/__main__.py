"""Run a node with a plant that is a Python class, for another program; see `zenostat.bridge.node.program`."""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is imported: it needs no threads here

from zenostat.bridge.node.program import main
from zenostat.bridge.python_plant.node import plant_node, read_settings

if __name__ == "__main__":
    main(lambda settings: plant_node(read_settings(settings), program=True))
