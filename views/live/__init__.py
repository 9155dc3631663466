"""The Rerun monitor: a stream of samples and events, and the viewer program."""
