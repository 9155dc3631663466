"""Device and network port objects of a BACnet device."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from typing import Any

from bacpypes3.basetypes import DeviceStatus, ObjectTypesSupported, Segmentation
from bacpypes3.errors import PropertyError
from bacpypes3.local.device import DeviceObject
from bacpypes3.local.networkport import NetworkPortObject
from bacpypes3.pdu import IPv4Address

from zenostat.gateways.bacnet.fixed_objects import NETWORK_PORT, device_description
from zenostat.gateways.bacnet.node_state import NodeState
from zenostat.topics.messages import Manifest

VENDOR_ID = 999
"""Vendor identifier of programs without a registered one, as in bacpypes3."""

MAX_APDU = 1476
"""Longest APDU of BACnet/IP in octets (ASHRAE 135, annex J)."""

_OBJECT_TYPES = (
    "analogInput", "analogOutput", "analogValue", "binaryValue", "device", "datetimeValue", "networkPort",
)  # fmt: skip


class _ReadOnly:
    """Rejects all writes of clients."""

    def is_writable(self, _attr: str) -> bool:
        """Whether clients can write a property: none."""
        return False

    async def write_property(self, *_: Any, **__: Any) -> None:
        """Reject a write."""
        raise PropertyError("writeAccessDenied")


class NodeDevice(_ReadOnly, DeviceObject):
    """The device object: the node.

    Args:
        state: the node's state.
        instance: the device's instance number.
    """

    def __init__(self, state: NodeState, instance: int) -> None:
        self._state = state
        super().__init__(
            objectIdentifier=("device", instance),
            objectName=state.node.name,
            vendorIdentifier=VENDOR_ID,
            vendorName="Zenostat",
            maxApduLengthAccepted=MAX_APDU,
            segmentationSupported=Segmentation.segmentedBoth,
            maxSegmentsAccepted=64,
        )
        self.describe(state.node.manifest, ())

    def describe(self, manifest: Manifest, objects: Iterable[tuple[str, int, str]]) -> None:
        """Set the properties that depend on the manifest; `objects` are types, numbers and names of all objects."""
        self.modelName = manifest.building or "simulated building"
        self.description = device_description(manifest)
        self.location = manifest.location or "unknown"
        self.firmwareRevision = manifest.versions.energyplus or "none"
        self.applicationSoftwareVersion = manifest.versions.zenostat
        # It must change when the list of objects does, also over restarts, which a count would not survive.
        self.databaseRevision = zlib.crc32(repr(sorted(objects)).encode())

    @property
    def systemStatus(self) -> DeviceStatus:
        """Operational while the node is on the bus and its simulation has not failed."""
        is_up = self._state.is_reachable and not self._state.has_failed
        return DeviceStatus("operational" if is_up else "non-operational")

    @systemStatus.setter
    def systemStatus(self, value: Any) -> None:
        pass  # bacpypes3 sets an initial value

    @property
    def protocolObjectTypesSupported(self) -> ObjectTypesSupported:
        """Types of the gateway's objects."""
        supported = ObjectTypesSupported([])
        for name in _OBJECT_TYPES:
            supported[getattr(ObjectTypesSupported, name)] = 1
        return supported


class NodePort(_ReadOnly, NetworkPortObject):
    """The network port object: the gateway's address.

    Args:
        address: the address with its netmask.
    """

    def __init__(self, address: IPv4Address, interface: str) -> None:
        super().__init__(
            address,
            objectIdentifier=(NETWORK_PORT.kind, NETWORK_PORT.instance),
            objectName=NETWORK_PORT.object_name,
            description=NETWORK_PORT.description,
            networkInterfaceName=interface,
            apduLength=MAX_APDU,
        )
