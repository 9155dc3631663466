"""Recordings of a node: written inside the node, read, verified against a fresh plant, and replayed."""
