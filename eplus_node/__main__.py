"""Run a node that simulates a building, for another program: `python -m eplus_node`; see `bridge.node.program`."""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is imported: it needs no threads here

from bridge.node.program import main
from eplus_node.config import read_config
from eplus_node.node import energyplus_node

if __name__ == "__main__":
    main(lambda settings: energyplus_node(read_config(settings), program=True))
