"""Zenoh sessions, access control, certificates and wake-ups."""
