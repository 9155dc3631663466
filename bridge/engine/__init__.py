"""Engines: simulators in processes of their own, which exchange a frame per timestep with their node."""
