"""Run the node of a district, for another program: `python -m zenostat.cosim`; see `zenostat.bridge.node.program`."""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is imported: it needs no threads here

from zenostat.bridge.node.program import main
from zenostat.cosim.node import district_node, read_settings

if __name__ == "__main__":
    main(lambda settings: district_node(read_settings(settings), program=True))
