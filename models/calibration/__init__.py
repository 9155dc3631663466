"""Calibration of building models: parameters as edits, and runs of whole periods for measured points."""
