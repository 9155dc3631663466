"""The BACnet/IP gateway: a node as a BACnet device. It requires bacpypes3 (the extra `bacnet`)."""

from zenostat.gateways.bacnet.gateway import BacnetGateway

__all__ = ["BacnetGateway"]
