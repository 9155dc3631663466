"""Data sets for offline reinforcement learning: episodes of controllers, in the format of Minari."""

from zenostat.lab.datasets.minari_writer import datasets_folder
from zenostat.lab.datasets.write import write_dataset

__all__ = ["datasets_folder", "write_dataset"]
