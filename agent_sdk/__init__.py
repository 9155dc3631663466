"""Tools for agents: the client of the bus, environments, rewards, wrappers, controllers, evaluation and training."""
