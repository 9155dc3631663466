"""The process in which EnergyPlus runs; the node's side of it is in the folder above."""
