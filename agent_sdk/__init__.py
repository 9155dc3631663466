"""What an agent needs: the client of the bus, environments, rewards, wrappers, controllers, evaluation and training."""
