"""Alarms: limits of points, evaluated at each sample in simulated time.

`state_machine` has the states as tables, `rules` applies rules to the points of a plant, `reports` has what operators
learn of an alarm, and `monitor` runs them all.
"""
