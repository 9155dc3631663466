"""Scenarios from configurations of Sinergym, read without running its code."""
