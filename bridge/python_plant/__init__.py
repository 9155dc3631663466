"""Plants that are Python classes, each instance in a process of its own.

A class becomes a plant by its attributes and two methods; `Plant` describes them, and `zenostat node --plant
tank.py:Tank` runs it.
"""

from zenostat.bridge.python_plant.api import Plant

__all__ = ["Plant"]
