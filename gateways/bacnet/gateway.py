"""A node as a BACnet/IP device."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import Any

from zenostat.gateways.bacnet.counts import BacnetCounts
from zenostat.gateways.bacnet.cov import COV_INTERVAL_S
from zenostat.gateways.bacnet.device import NodeDevice, NodePort
from zenostat.gateways.bacnet.network import Interface
from zenostat.gateways.bacnet.node_state import NodeState
from zenostat.gateways.bacnet.point_objects import AnalogInput, AnalogOutput, NodeObject
from zenostat.gateways.bacnet.points import PointSpec, point_specs
from zenostat.gateways.bacnet.services import NodeApplication
from zenostat.gateways.bacnet.simulation_objects import StatusObject, control_objects
from zenostat.gateways.clients import UNRESTRICTED, Clients
from zenostat.gateways.node_client import NodeClient
from zenostat.gateways.notices import Notices
from zenostat.topics.device_addresses import ObjectKind
from zenostat.topics.messages import Manifest


class BacnetGateway:
    """One node as a BACnet device: `async with BacnetGateway(node, interface, instance=7) as gateway:`.

    Args:
        node: the node, already connected.
        interface: the network interface to listen on.
        instance: instance number of the device, 0 to 4,194,302.
        clients: names of clients, and what they may write.
        notify: called with the reasons of writes that were rejected, for which BACnet has only a class and a code.

    Raises:
        AddressInUse: on entering the context, another program uses the address.

    Attributes:
        counts: counts of messages of BACnet clients.
    """

    def __init__(
        self,
        node: NodeClient,
        interface: Interface,
        *,
        instance: int,
        clients: Clients = UNRESTRICTED,
        notify: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.counts = BacnetCounts()
        self._clients, self._rejections = clients, Notices(notify)
        self._node, self._interface, self._instance = node, interface, instance
        self._changed = asyncio.Event()
        self._specs: list[PointSpec] = []
        self._points: list[NodeObject] = []
        self._described = ""  # the instance of the node

    async def __aenter__(self) -> BacnetGateway:
        # bacpypes3 logs each malformed message with a traceback; they are counted here.
        logging.getLogger("bacpypes3").addHandler(logging.NullHandler())
        logging.getLogger("bacpypes3").propagate = False
        self._state = NodeState(self._node, self._changed.set)
        self._device = NodeDevice(self._state, self._instance)
        port = NodePort(self._interface.bacnet_address, self._interface.name)
        self._application = NodeApplication(
            self._device,
            port,
            self._interface,
            source=self._node.source,
            clients=self._clients,
            counts=self.counts,
            rejections=self._rejections,
        )
        await self._application.link.server.open()
        for control in control_objects(self._state):
            self._application.add_object(control)
        self._set_manifest(self._node.manifest)
        self._node.listeners.manifests.append(self._set_manifest)
        await asyncio.gather(self._state.arrays.get(), self._state.status.get())
        self._application.i_am()
        self._application.ask_for_clients()
        return self

    async def __aexit__(self, *_: object) -> None:
        self._application.close()

    @property
    def description(self) -> str:
        """Node, device and address."""
        interface = self._interface
        return (
            f"node {self._node.name} is BACnet device {self._instance} on {interface.address.ip}:{interface.port}, "
            f"{sum(spec.kind is ObjectKind.INPUT for spec in self._specs)} inputs, "
            f"{sum(spec.kind is ObjectKind.OUTPUT for spec in self._specs)} outputs; {self._clients.description}"
        )

    async def run(self) -> None:
        """Notify subscribers of changes, until cancelled."""
        while True:
            await self._changed.wait()
            self._changed.clear()
            if self._application.is_subscribed(AnalogOutput):
                await self._state.arrays.get()
            if self._application.is_subscribed(StatusObject):
                await self._state.status.get()
            self._application.notify_subscribers()
            await asyncio.sleep(COV_INTERVAL_S)

    def summary(self) -> str:
        """Return counts for the last line."""
        counts = self.counts
        return (
            f"{counts.datagrams} datagrams, {counts.requests} requests, {counts.rejected} of them rejected, "
            f"{counts.malformed} malformed, {counts.writes} writes, {counts.denied} denied, "
            f"{counts.notifications} notifications"
        )

    def _set_manifest(self, manifest: Manifest) -> None:
        """Describe the node of a manifest, and replace the objects if the points have changed."""
        specs = point_specs(manifest)
        self._device.describe(manifest, [(spec.kind, spec.instance, spec.object_name) for spec in specs])
        is_same = specs == self._specs
        if not is_same or manifest.instance != self._described:
            self._state.set_manifest(manifest)
        self._described = manifest.instance
        if is_same:
            return
        former = {s._replace(position=0): point for s, point in zip(self._specs, self._points, strict=True)}
        kept = {spec: former.pop(key) for spec in specs if (key := spec._replace(position=0)) in former}
        for point in former.values():
            self._application.remove_object(point)
        self._points = [self._point(spec, kept.get(spec)) for spec in specs]
        self._specs = specs

    def _point(self, spec: PointSpec, former: Any) -> Any:
        """Return the object of a point; one that has only another position in the samples keeps its subscribers."""
        if former is not None:
            former.move(spec.position)
            return former
        kinds: dict[ObjectKind, Any] = {ObjectKind.INPUT: AnalogInput, ObjectKind.OUTPUT: AnalogOutput}
        point = kinds[spec.kind](self._state, spec)
        self._application.add_object(point)
        return point
