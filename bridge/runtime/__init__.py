"""Timers, signals, polling, scratch folders and CPU affinity."""
