"""Scenarios from configurations of Sinergym. No code of theirs is run."""
