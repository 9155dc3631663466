"""Calibration of building models on measured data."""
