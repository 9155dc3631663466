"""Districts: several plants coupled in lockstep, as one plant on the bus.

A district is the plant of a node, the orchestrator. Each coupled plant is a node of its own.
"""
