"""The step exchange: rules without I/O for who answers which sample, and what the actuators are commanded."""
