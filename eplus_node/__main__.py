"""Run a node that simulates a building: `python -m zenostat.eplus_node`; see `zenostat.bridge.node.program`."""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is imported: it needs no threads here

from zenostat.bridge.node.program import main
from zenostat.eplus_node.config import read_config
from zenostat.eplus_node.node import energyplus_node

if __name__ == "__main__":
    main(lambda settings: energyplus_node(read_config(settings), program=True))
