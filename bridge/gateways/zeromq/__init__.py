"""The ZeroMQ gateway: programs that speak only ZeroMQ and msgpack join a bus. It needs pyzmq (the extra `zeromq`)."""

from bridge.gateways.zeromq.gateway import Gateway

__all__ = ["Gateway"]
