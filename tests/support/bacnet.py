"""A BACnet client on bacpypes3's own application, and the gateway in the test's loop."""

import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import numpy as np
from bacpypes3.apdu import AbortPDU, ErrorPDU, RejectPDU, WritePropertyRequest
from bacpypes3.app import Application
from bacpypes3.basetypes import PropertyIdentifier
from bacpypes3.constructeddata import Any as AnyValue
from bacpypes3.local.device import DeviceObject
from bacpypes3.local.networkport import NetworkPortObject
from bacpypes3.pdu import Address
from bacpypes3.primitivedata import Enumerated, Null, ObjectIdentifier, Real

from zenostat.bridge.transport.session import open_session
from zenostat.gateways.bacnet import BacnetGateway
from zenostat.gateways.bacnet.network import find_interface
from zenostat.gateways.clients import UNRESTRICTED, Clients
from zenostat.gateways.node_client import NodeClient

INSTANCE = 4711
DEVICE = ("device", INSTANCE)
ADVANCE, STEP, EPISODE = (("analog-value", number) for number in (1, 2, 3))
PAUSED, TIME = ("binary-value", 1), ("datetime-value", 1)


def free_udp_port() -> int:
    """A port of the loopback that nobody used a moment ago."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Client:
    """Reads and writes properties of one device; an error, reject or abort is returned as text."""

    def __init__(self, app: Application, port: int) -> None:
        self.app, self.device = app, Address(f"127.0.0.1:{port}")
        self.objects: dict[str, Any] = {}

    async def learn(self) -> None:
        """Learn the identifiers of all objects by their names, in requests for many at once."""
        listed = [tuple(identifier) for identifier in await self.read(("device", 4194303), "object-list")]
        for begin in range(0, len(listed), 20):
            chosen = listed[begin : begin + 20]
            query = [part for identifier in chosen for part in (ObjectIdentifier(identifier), ["object-name"])]
            for identifier, _, _, name in await self.app.read_property_multiple(self.device, query):
                self.objects[str(name)] = (str(identifier[0]), identifier[1])

    def identifier(self, obj: Any) -> ObjectIdentifier:
        return ObjectIdentifier(self.objects[obj] if isinstance(obj, str) else obj)

    async def read(self, obj: Any, prop: str = "present-value", index: int | None = None) -> Any:
        try:
            value = await self.app.read_property(self.device, self.identifier(obj), prop, index)
        except (ErrorPDU, RejectPDU, AbortPDU) as error:
            return error_text(error)
        if hasattr(value, "_choice"):
            value = getattr(value, value._choice)
        if isinstance(value, Enumerated):
            return str(value)
        return None if isinstance(value, (Null, tuple)) and not value else value

    async def priorities(self, obj: Any) -> dict[int, float]:
        array = await self.read(obj, "priority-array")
        return {number: entry.real for number, entry in enumerate(array, 1) if entry.null is None}

    async def write(
        self,
        obj: Any,
        value: Any,
        prop: str = "present-value",
        *,
        index: int | None = None,
        priority: int | None = None,
    ) -> str:
        """Write a value of any type: None is Null, a float a Real, all else as it is."""
        if value is None:
            value = Null(())
        elif isinstance(value, float):
            value = Real(value)
        request = WritePropertyRequest(
            objectIdentifier=self.identifier(obj),
            propertyIdentifier=PropertyIdentifier(prop),
            propertyValue=AnyValue(value),
            destination=self.device,
        )
        if index is not None:
            request.propertyArrayIndex = index
        if priority is not None:
            request.priority = priority
        return await self.request(request)

    async def request(self, request: Any) -> str:
        """Send a request; "ok", or the text of an error, reject or abort."""
        try:
            await self.app.request(request)
        except (ErrorPDU, RejectPDU, AbortPDU) as error:
            return error_text(error)
        return "ok"


def error_text(error: Any) -> str:
    if isinstance(error, RejectPDU):
        return f"reject {error.apduAbortRejectReason}"
    if isinstance(error, AbortPDU):
        return f"abort {error.apduAbortRejectReason}"
    if getattr(error, "errorType", None) is not None:
        return f"{error.errorType.errorClass} {error.errorType.errorCode}"
    return f"{error.errorClass} {error.errorCode}"


@asynccontextmanager
async def served(
    endpoint: str, name: str = "office", clients: Clients = UNRESTRICTED
) -> AsyncIterator[tuple[BacnetGateway, Client, int]]:
    """The gateway of a node, a client that knows its objects, and the gateway's port."""
    port = free_udp_port()
    with open_session(connect=[endpoint]) as session:
        async with (
            NodeClient(session, name, source="bacnet") as node,
            BacnetGateway(node, find_interface("127.0.0.1", port), instance=INSTANCE, clients=clients) as gateway,
            client(port) as reader,
        ):
            await reader.learn()
            yield gateway, reader, port


@asynccontextmanager
async def client(port: int, instance: int = 1) -> AsyncIterator[Client]:
    """A client of a device; `instance` is that of its own device."""
    own = NetworkPortObject(f"127.0.0.1/32:{free_udp_port()}", objectIdentifier=("network-port", 1), objectName="port")
    device = DeviceObject(
        objectIdentifier=("device", instance), objectName="client", vendorIdentifier=999, maxApduLengthAccepted=1476
    )
    app = Application.from_object_list([device, own])
    try:
        yield Client(app, port)
    finally:
        app.close()


def single(value: float) -> float:
    """A value in single precision, as BACnet's Real transports it."""
    return float(np.float32(value))
