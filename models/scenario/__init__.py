"""Scenarios: their schema, registry, task and episodes."""
