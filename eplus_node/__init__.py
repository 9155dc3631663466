"""The building's side: engines (EnergyPlus in processes of their own) and the node that puts them on the bus."""
