"""Gymnasium, PettingZoo and stable-baselines3 environments."""
