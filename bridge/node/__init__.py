"""A node: a plant on the bus."""
