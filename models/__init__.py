"""What can be simulated: buildings, weather, points, run periods; finding, checking, preparing them.

No bus in here.
"""
