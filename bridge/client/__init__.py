"""The client of the bus: nodes, controller links, samples and snapshots."""
