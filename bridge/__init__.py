"""What moves messages: the Zenoh session, the step exchange, priorities, placement on cores, Rerun."""
