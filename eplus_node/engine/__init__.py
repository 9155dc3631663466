"""EnergyPlus in a process of its own, and the node's side of it."""
