"""The building's side: the engine (EnergyPlus in a process of its own) and the node that puts it on the bus."""
