"""The step exchange: which controllers answer which sample, and what the actuators are commanded. No I/O."""
