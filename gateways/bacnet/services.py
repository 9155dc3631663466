"""BACnet services on a node's objects: reading, writing with BACnet's errors, COV subscriptions."""

from __future__ import annotations

import asyncio
from typing import Any

from bacpypes3.apdu import (
    ErrorRejectAbortNack,
    SimpleAckPDU,
    WritePropertyMultipleError,
    WritePropertyMultipleRequest,
    WritePropertyRequest,
)
from bacpypes3.app import Application
from bacpypes3.basetypes import (
    COVSubscription,
    DeviceAddress,
    ErrorType,
    ListOfCOVSubscription,
    ObjectPropertyReference,
    Recipient,
    RecipientProcess,
    ServicesSupported,
)
from bacpypes3.comm import bind
from bacpypes3.constructeddata import Array
from bacpypes3.errors import (
    ExecutionError,
    InconsistentParameters,
    ObjectError,
    ParameterOutOfRange,
    PropertyError,
    UnrecognizedService,
)
from bacpypes3.netservice import NetworkServiceAccessPoint, NetworkServiceElement
from bacpypes3.pdu import Address
from bacpypes3.primitivedata import Null, ObjectType, TagClass, TagNumber, Unsigned

from zenostat.gateways.bacnet.client_devices import ClientDevices
from zenostat.gateways.bacnet.counts import BacnetCounts
from zenostat.gateways.bacnet.device import NodeDevice, NodePort
from zenostat.gateways.bacnet.network import Interface, NodeLink, host_and_port
from zenostat.gateways.bacnet.node_state import BacnetRequest, current_request
from zenostat.gateways.bacnet.point_objects import NodeObject
from zenostat.gateways.bacnet.transactions import TransactionServer
from zenostat.gateways.clients import Clients
from zenostat.gateways.notices import Notices
from zenostat.topics import keys
from zenostat.topics.errors import (
    InvalidAction,
    NodeLost,
    NodeNotFound,
    PeerError,
    RequestRejected,
    UnknownName,
    ZenostatError,
)

MAX_SUBSCRIPTIONS = 1000
"""Largest number of COV subscriptions of all clients together."""

_WILDCARD_INSTANCE = 4_194_303
_SERVICES = (
    "subscribeCOV", "readProperty", "readPropertyMultiple", "writeProperty", "writePropertyMultiple",
    "whoHas", "whoIs",
)  # fmt: skip


class NodeApplication(Application):
    """A BACnet application with a node's objects.

    Args:
        device: the device object.
        port: the network port object.
        interface: the network interface.
        source: beginning of the writers' names on the bus; the client's address follows.
        clients: names of clients, and what they may write.
        counts: counts of messages.
        rejections: notices of writes that the node rejected or that their client may not make, and of notifications
            that cannot be sent.
    """

    def __init__(
        self,
        device: NodeDevice,
        port: NodePort,
        interface: Interface,
        *,
        source: str,
        clients: Clients,
        counts: BacnetCounts,
        rejections: Notices,
    ) -> None:
        super().__init__()
        self._source, self._clients, self._counts, self._rejections = source, clients, counts, rejections
        self._devices = ClientDevices(clients.bacnet_instances, self.request)
        self._notifying: dict[Any, bool] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self.link = NodeLink(interface, counts)
        self.asap = TransactionServer(device, self.device_info_cache, counts)
        self.nsap, self.nse = NetworkServiceAccessPoint(), NetworkServiceElement()
        bind(self.nse, self.nsap)
        bind(self, self.asap, self.nsap)
        self.nsap.bind(self.link, address=interface.bacnet_address)
        self.add_object(device)
        # Not `add_object`, which would open bacpypes3's own sockets.
        self.objectName[port.objectName] = self.objectIdentifier[port.objectIdentifier] = port
        port._app = self  # noqa: SLF001

    def close(self) -> None:
        """Close the sockets and end what is in progress."""
        self.link.server.close()
        self.asap.close()
        for task in [*self._tasks]:
            task.cancel()
        for criteria in [*self._cov_detections.values()]:
            for subscription in [*criteria.cov_subscriptions]:
                self.cancel_subscription(subscription)

    async def indication(self, apdu: Any) -> None:
        """Process a request; what it does on the bus has the client's address as its source."""
        now, address = asyncio.get_running_loop().time(), address_text(apdu.pduSource)
        current_request.set(BacnetRequest(f"{self._source}.{keys.safe_name(address)}", now))
        if isinstance(apdu, WritePropertyRequest | WritePropertyMultipleRequest):
            instance = await self._devices.instance_at(apdu.pduSource)
            if name := self._clients.of_bacnet(_host(address), instance):
                current_request.set(BacnetRequest(f"{self._source}.{name}", now, name))
        await super().indication(apdu)

    def ask_for_clients(self) -> None:
        """Ask the devices that the file of clients names for their addresses."""
        self._devices.ask_all()

    async def do_IAmRequest(self, apdu: Any) -> None:
        """Note the address of a device that the file of clients names."""
        self._devices.add(apdu.pduSource, int(apdu.iAmDeviceIdentifier[1]))
        await super().do_IAmRequest(apdu)

    # Reading

    def get_object_id(self, objid: Any) -> Any:
        """Return an object by its identifier, also the device by its wildcard number; bacpypes3 compares it wrongly."""
        return self.device_object if _is_wildcard(objid) else super().get_object_id(objid)

    async def do_ReadPropertyRequest(self, apdu: Any) -> None:
        """Read one property; the reply has the device's own number in place of a wildcard."""
        if _is_wildcard(apdu.objectIdentifier):
            apdu.objectIdentifier = self.device_object.objectIdentifier
        await super().do_ReadPropertyRequest(apdu)

    async def do_ReadPropertyMultipleRequest(self, apdu: Any) -> None:
        """Read several properties; the reply has the device's own number in place of a wildcard."""
        for specification in apdu.listOfReadAccessSpecs:
            if _is_wildcard(specification.objectIdentifier):
                specification.objectIdentifier = self.device_object.objectIdentifier
        await super().do_ReadPropertyMultipleRequest(apdu)

    async def do_ReadRangeRequest(self, apdu: Any) -> None:  # noqa: ARG002
        """Reject a request for a range, which bacpypes3 does not execute."""
        raise UnrecognizedService

    # Writing

    async def do_WritePropertyRequest(self, apdu: Any) -> None:
        """Write one property."""
        obj = self.get_object_id(apdu.objectIdentifier)
        if obj is None:
            raise ObjectError("unknownObject")
        await self._write(obj, apdu.propertyIdentifier, apdu.propertyArrayIndex, apdu.propertyValue, apdu.priority)
        await self.response(SimpleAckPDU(context=apdu))

    async def do_WritePropertyMultipleRequest(self, apdu: Any) -> None:
        """Write several properties in their order, until one cannot be written."""
        for specification in apdu.listOfWriteAccessSpecs:
            obj = self.get_object_id(specification.objectIdentifier)
            for item in specification.listOfProperties:
                try:
                    if obj is None:
                        raise ObjectError("unknownObject")
                    await self._write(obj, item.propertyIdentifier, item.propertyArrayIndex, item.value, item.priority)
                except ExecutionError as error:
                    failed = ObjectPropertyReference(
                        objectIdentifier=specification.objectIdentifier, propertyIdentifier=item.propertyIdentifier
                    )
                    if item.propertyArrayIndex is not None:
                        failed.propertyArrayIndex = item.propertyArrayIndex
                    reply = WritePropertyMultipleError(
                        errorType=ErrorType(errorClass=error.errorClass, errorCode=error.errorCode),
                        firstFailedWriteAttempt=failed,
                        context=apdu,
                    )
                    await self.response(reply)
                    return
        await self.response(SimpleAckPDU(context=apdu))

    async def _write(self, obj: Any, identifier: Any, index: int | None, value: Any, priority: int | None) -> None:
        """Write a property; raises BACnet's error of ASHRAE 135, clause 15.9, if it is not possible."""
        attr = identifier.attr
        kind = obj.get_property_type(identifier)
        if kind is None or getattr(obj, attr, None) is None:
            raise PropertyError("unknownProperty")
        is_array = issubclass(kind, Array)
        if index is not None and not is_array:
            raise PropertyError("propertyIsNotAnArray")
        if not obj.is_writable(attr):
            raise PropertyError("writeAccessDenied")
        if priority is not None and not 1 <= priority <= 16:
            raise ParameterOutOfRange("priority")
        self._check_permission(obj)
        try:
            await obj.write_property(attr, _decoded(value, Unsigned if index == 0 else kind), index, priority)
        except ZenostatError as error:
            if isinstance(error, RequestRejected):
                self._rejections.add(f"a write was rejected: {error}")
            raise bacnet_error(error) from None
        self._counts.writes += 1

    def _check_permission(self, obj: NodeObject) -> None:
        """Raise BACnet's error unless the client whose request is being answered may write an object."""
        request = current_request.get()
        if request is not None and (reason := self._clients.denial(request.client, obj.point_name)):
            self._counts.denied += 1
            self._rejections.add(f"a write of {request.source} was denied: {reason}")
            raise PropertyError("writeAccessDenied")

    def get_services_supported(self) -> ServicesSupported:
        """Return the services that the device executes; bacpypes3 lists others in place of the unconfirmed ones."""
        supported = ServicesSupported([])
        for name in _SERVICES:
            supported[getattr(ServicesSupported, name)] = 1
        return supported

    # Changes of value

    async def do_SubscribeCOVRequest(self, apdu: Any) -> None:
        """Subscribe to an object, or cancel a subscription."""
        is_cancellation = apdu.issueConfirmedNotifications is None and apdu.lifetime is None
        if not is_cancellation:
            if apdu.issueConfirmedNotifications is None:
                raise InconsistentParameters("issueConfirmedNotifications")
            apdu.lifetime = apdu.lifetime or 0  # without one: for ever
            if not self._is_renewal(apdu) and self._subscription_count() >= MAX_SUBSCRIPTIONS:
                raise ExecutionError("resources", "noSpaceToAddListElement")
        await super().do_SubscribeCOVRequest(apdu)

    def _subscription_count(self) -> int:
        return sum(len(criteria.cov_subscriptions) for criteria in self._cov_detections.values())

    def _is_renewal(self, apdu: Any) -> bool:
        """Return whether a request is for a subscription that exists; see ASHRAE 135, clause 13.14.1."""
        criteria = self._cov_detections.get(apdu.monitoredObjectIdentifier)
        return criteria is not None and any(
            (cov.client_addr, cov.proc_id) == (apdu.pduSource, apdu.subscriberProcessIdentifier)
            for cov in criteria.cov_subscriptions
        )

    def cov_notification(self, cov: Any, apdu: Any) -> None:
        """Send a notification; of confirmed ones, the next is sent when the subscriber has confirmed the previous."""
        if not cov.confirmed:
            self._counts.notifications += 1
            self.request(apdu)
        elif cov in self._notifying:
            self._notifying[cov] = True
        else:
            self._notifying[cov] = False
            task = asyncio.get_running_loop().create_task(self._notify(cov, apdu))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _notify(self, cov: Any, apdu: Any) -> None:
        is_confirmed = False
        self._counts.notifications += 1
        try:
            await self.request(apdu)
            is_confirmed = True
        except ErrorRejectAbortNack:  # it has no such subscription (any more), or does not answer
            pass
        finally:
            is_outdated = self._notifying.pop(cov)
        if cov.obj_ref is None:
            return
        if not is_confirmed and not cov.lifetime:
            self.cancel_subscription(cov)  # it would never end
        elif is_outdated:  # the last state always follows
            self._cov_detections[cov.obj_id].send_cov_notifications(cov)

    def is_subscribed(self, kind: type) -> bool:
        """Whether somebody has subscribed to an object of a class."""
        return any(
            criteria.cov_subscriptions and isinstance(criteria.obj, kind) for criteria in self._cov_detections.values()
        )

    def notify_subscribers(self) -> None:
        """Send notifications of all objects that have changed enough."""
        for criteria in [*self._cov_detections.values()]:
            try:
                if criteria.cov_subscriptions and criteria.is_due():
                    criteria.send_cov_notifications()
            except Exception as error:
                self._rejections.add(f"no notification of {criteria.obj.objectName}: {type(error).__name__}: {error}")

    def remove_object(self, obj: Any) -> None:
        """Remove an object and cancel its subscriptions."""
        criteria = self._cov_detections.get(obj.objectIdentifier)
        for subscription in [*criteria.cov_subscriptions] if criteria else []:
            self.cancel_subscription(subscription)
        self._cov_detections.pop(obj.objectIdentifier, None)
        self.delete_object(obj)

    def get_active_cov_subscriptions(self) -> Any:
        """Return the device's property of that name; bacpypes3 calls it."""
        now = asyncio.get_running_loop().time()
        return ListOfCOVSubscription(
            [
                COVSubscription(
                    recipient=RecipientProcess(
                        recipient=Recipient(
                            address=DeviceAddress(networkNumber=0, macAddress=cov.client_addr.addrAddr)
                        ),
                        processIdentifier=cov.proc_id,
                    ),
                    monitoredPropertyReference=ObjectPropertyReference(
                        objectIdentifier=cov.obj_id, propertyIdentifier="presentValue"
                    ),
                    issueConfirmedNotifications=cov.confirmed,
                    timeRemaining=max(1, int(cov.cancel_handle.when() - now)) if cov.cancel_handle else 0,
                )
                for criteria in self._cov_detections.values()
                for cov in criteria.cov_subscriptions
            ]
        )


def address_text(address: Address) -> str:
    """Return a client's address: `127.0.0.1:50312`, or network and address of one behind a router."""
    if address.addrNet is None and address.addrAddr is not None and len(address.addrAddr) == 6:
        host, port = host_and_port(address)
        return f"{host}:{port}"
    return str(address)


def _host(address: str) -> str:
    """Return the IP address of a client; of one behind a router, its whole address, which is none."""
    return address.rpartition(":")[0] if "." in address else address


def bacnet_error(error: ZenostatError) -> ExecutionError:
    """Return BACnet's error for one of the bus."""
    match error:
        case NodeLost() | NodeNotFound():
            return ExecutionError("device", "operationalProblem")
        case UnknownName():
            return ObjectError("unknownObject")
        case InvalidAction():
            return PropertyError("valueOutOfRange")
        case RequestRejected():
            return PropertyError("writeAccessDenied")
        case PeerError():
            return ExecutionError("device", "operationalProblem")
    return ExecutionError("device", "internalError")


def _is_wildcard(identifier: Any) -> bool:
    return bool(identifier[0] == ObjectType.device and identifier[1] == _WILDCARD_INSTANCE)


def _decoded(value: Any, kind: type) -> Any:
    """Return a value as the property's type, or Null; `PropertyError` if it is of another type."""
    tags = [tag for tag in value.tagList if tag.tag_class not in (TagClass.opening, TagClass.closing)]
    if len(tags) == 1 and tags[0].tag_class == TagClass.application and tags[0].tag_number == TagNumber.null:
        return Null(())
    try:
        decoded = value.cast_out(kind)
        if len(tags) != 1:  # all writable properties have one value
            raise ValueError("more than one value")
    except Exception:  # whatever its decoders raise at malformed data
        raise PropertyError("invalidDataType") from None
    return decoded
