"""The bridge: Zenoh sessions, the step exchange, injected faults, gateways, Rerun, threads and timers."""
