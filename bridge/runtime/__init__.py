"""Threads, timers, signals, polling and placement on cores."""
