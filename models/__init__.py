"""Buildings, weather files, points and run periods: find, check and prepare them for simulation.

Nothing in this package uses the bus.
"""
