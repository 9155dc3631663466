"""Modbus TCP: the points of one node as registers and coils."""
