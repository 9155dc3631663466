"""Gateways: clients of other protocols on the same node."""
