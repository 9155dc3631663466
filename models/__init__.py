"""What can be simulated: find, check and prepare buildings, weather files, points and run periods.

Nothing in this package uses the bus.
"""
