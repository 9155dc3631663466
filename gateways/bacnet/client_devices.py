"""Device instances of BACnet clients: a request has its sender's address only, so the device there is asked.

An I-Am is believed as it is: nothing in BACnet/IP proves an instance or an address.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection
from typing import Any

from bacpypes3.apdu import WhoIsRequest
from bacpypes3.pdu import Address, LocalBroadcast

ANSWER_S = 1.0
"""Time that a device has to answer a Who-Is before its write is carried out as that of a client without a name."""

ASK_AGAIN_S = 30.0
"""Time for which an address that has not answered is not asked again."""

_MAX_ADDRESSES = 1000


class ClientDevices:
    """The instances of the devices at the addresses from which requests come.

    Args:
        instances: those that are looked for; all others are of no interest.
        send: sends a request without a reply.
    """

    def __init__(self, instances: Collection[int], send: Callable[[Any], Any]) -> None:
        self._wanted, self._send = frozenset(instances), send
        self._instances: dict[str, int] = {}
        self._asked_s: dict[str, float] = {}
        self._changed = asyncio.Event()

    def ask_all(self) -> None:
        """Broadcast a Who-Is for each instance."""
        for instance in sorted(self._wanted):
            self._ask(LocalBroadcast(), instance, instance)

    def add(self, address: Address, instance: int) -> None:
        """Note the instance of the device at an address, from its I-Am."""
        if instance not in self._wanted:
            return
        self._instances = {known: number for known, number in self._instances.items() if number != instance}
        self._instances[str(address)] = instance
        self._changed.set()
        self._changed = asyncio.Event()

    async def instance_at(self, address: Address) -> int | None:
        """Return the instance of the device at an address, which is asked if it is unknown; None without an answer."""
        key = str(address)
        if not self._wanted or key in self._instances:
            return self._instances.get(key)
        now_s = asyncio.get_running_loop().time()
        if now_s - self._asked_s.get(key, -ASK_AGAIN_S) >= ASK_AGAIN_S:
            if len(self._asked_s) >= _MAX_ADDRESSES:
                self._asked_s.clear()
            self._asked_s[key] = now_s
            self._ask(address, min(self._wanted), max(self._wanted))
        waits_until_s = self._asked_s[key] + ANSWER_S
        while key not in self._instances and (left_s := waits_until_s - asyncio.get_running_loop().time()) > 0:
            try:
                async with asyncio.timeout(left_s):
                    await self._changed.wait()
            except TimeoutError:
                break
        return self._instances.get(key)

    def _ask(self, address: Address, low: int, high: int) -> None:
        request = WhoIsRequest(destination=address, deviceInstanceRangeLowLimit=low, deviceInstanceRangeHighLimit=high)
        self._send(request)
