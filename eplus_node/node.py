"""A node that simulates a building with EnergyPlus."""

from __future__ import annotations

from functools import partial

from zenostat.bridge.node.node import Node
from zenostat.bridge.node.plant import PlantFactory
from zenostat.bridge.node.server import Observer
from zenostat.eplus_node.config import NodeConfig
from zenostat.eplus_node.plan import plan
from zenostat.eplus_node.plant import EnergyPlusPlant

_FINISH_S = 33.0
"""Time that EnergyPlus may take to finish files that are kept."""


def energyplus_node(config: NodeConfig, observer: Observer | None = None, *, program: bool = False) -> Node:
    """Return a node that is not started yet; see `zenostat.bridge.node.node.Node` for the arguments.

    Raises (on entering the node):
        UsageError, SimulatorError, BusError: see `zenostat.topics.errors`; everything that was started is closed.
    """

    def prepare() -> PlantFactory:
        return partial(EnergyPlusPlant, plan(config))

    finish_s = 0.0 if config.output_dir is None else _FINISH_S
    return Node(config, prepare, observer, program=program, finish_s=finish_s)
