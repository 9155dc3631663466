"""Gateways: access to nodes for clients of other protocols."""
