"""The ZeroMQ gateway: access to a bus with ZeroMQ and msgpack only. It requires pyzmq (the extra `zeromq`)."""

from zenostat.gateways.zeromq.gateway import Gateway

__all__ = ["Gateway"]
