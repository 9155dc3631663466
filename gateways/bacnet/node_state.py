"""State of a node as a BACnet device shows it: values, priority arrays, reliability, stepping on command."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from zenostat.bridge.client.priorities import PriorityValue
from zenostat.bridge.client.sample import SampleView
from zenostat.gateways.node_client import NodeClient
from zenostat.topics import keys
from zenostat.topics.errors import NodeLost, PeerError, RequestRejected, ZenostatError
from zenostat.topics.messages import Ack, Manifest, Message, Pause, Query, Resume, Status, StepRequest

T = TypeVar("T")

ANSWER_S = 2.0
"""Time after which a request to the node counts as failed; BACnet clients usually wait three seconds for a reply."""

NULL = PriorityValue(None, None)


@dataclass(frozen=True, slots=True)
class BacnetRequest:
    """A request of a BACnet client.

    Attributes:
        source: name of the source on the bus.
        arrived: time of arrival on the loop's clock.
        client: name of the client; empty if it has none.
    """

    source: str
    arrived: float
    client: str = ""


current_request: ContextVar[BacnetRequest | None] = ContextVar("current_request", default=None)
"""The request that the running task answers."""


class LatestReply(Generic[T]):
    """The node's reply to a query that is repeated: one at a time, shared by all requests that wait for it."""

    def __init__(self, ask: Callable[[], Awaitable[T]], initial: T) -> None:
        self.value, self.failed = initial, False
        self._ask = ask
        self._asked = float("-inf")
        self._running: asyncio.Task[None] | None = None

    async def get(self, since: float | None = None) -> T:
        """Return the reply to a query that was sent after the current request arrived; the last one if that fails.

        Args:
            since: earliest time of the query on the loop's clock, in place of the arrival.
        """
        if since is None:
            request = current_request.get()
            since = request.arrived if request else asyncio.get_running_loop().time()
        while self._asked < since:
            if self._running is None:
                self._running = asyncio.create_task(self._refresh())
            await asyncio.shield(self._running)
        return self.value

    async def _refresh(self) -> None:
        asked = asyncio.get_running_loop().time()
        try:
            async with asyncio.timeout(ANSWER_S):
                self.value = await self._ask()
            self.failed = False
        except RequestRejected:  # a recording that is replayed, for example: it is there, but has no such reply
            self.failed = False
        except (ZenostatError, TimeoutError):
            self.failed = True
        finally:
            self._asked, self._running = asked, None


class NodeState:
    """Values and commands of one node, in slot 0.

    Args:
        node: the node.
        changed: called when values, commands or presence may have changed.
    """

    def __init__(self, node: NodeClient, changed: Callable[[], None]) -> None:
        self.node, self._changed = node, changed
        self.arrays: LatestReply[dict[str, list[PriorityValue]] | None] = LatestReply(node.priorities, None)
        self.status: LatestReply[Status | None] = LatestReply(self._ask_status, None)
        self.set_manifest(node.manifest)
        node.listeners.samples.append(self._on_sample)
        node.listeners.events.append(lambda _: changed())
        node.listeners.presence.append(lambda _: changed())

    def set_manifest(self, manifest: Manifest) -> None:
        """Forget the values of the previous manifest's points."""
        self._values = np.full(len(manifest.points), np.nan)
        self._effective = self._commanded = np.full(len(manifest.actuators), np.nan)
        self._baseline = np.array(
            [np.nan if actuator.default is None else actuator.default for actuator in manifest.actuators]
        )
        self._knows_baseline = ~np.isnan(self._baseline)
        self.arrays.value = None
        if self.sample is not None and self.sample.manifest is manifest:
            self._on_sample(self.sample)

    # Values

    @property
    def sample(self) -> SampleView | None:
        """The latest sample."""
        return self.node.sample

    @property
    def is_reachable(self) -> bool:
        """Whether the node is on the bus and answers."""
        return self.node.is_online and not self.arrays.failed

    @property
    def has_failed(self) -> bool:
        """Whether its simulation has failed."""
        return self.node.has_failed

    def value(self, index: int) -> float:
        """Return the latest value of a sensor or meter, in its unit on the bus."""
        return float(self._values[index])

    def effective(self, index: int) -> float:
        """Return the effective value of an actuator in the latest timestep; NaN if it is not reported."""
        return float(self._effective[index])

    def baseline(self, index: int) -> float:
        """Return the value that baseline control sets: the latest known; NaN if there was none yet."""
        return float(self._baseline[index])

    def commanded(self, index: int) -> float:
        """Return the value that commands have set in the latest timestep; NaN under the baseline control."""
        return float(self._commanded[index])

    @property
    def has_arrays(self) -> bool:
        """Whether the node has reported its priority arrays; a replay does not."""
        return self.arrays.value is not None

    def priority_array(self, name: str) -> list[PriorityValue]:
        """Return the 16 entries of an actuator's priority array, as of the latest reply."""
        return (self.arrays.value or {}).get(name) or [NULL] * 16

    def _on_sample(self, sample: SampleView) -> None:
        self.arrays.failed = False
        self._values, self._effective, self._commanded = sample.values, sample.effective, sample.commanded
        if sample.baseline_effective is not None:
            baseline, is_baseline = sample.baseline_effective, ~np.isnan(sample.baseline_effective)
        else:
            baseline, is_baseline = self._effective, np.isnan(self._commanded) & ~np.isnan(self._effective)
        np.copyto(self._baseline, baseline, where=is_baseline & ~self._knows_baseline)
        self._changed()

    async def _ask_status(self) -> Status:
        return await self.node.ask(keys.STATUS, Query(), Status)

    # Commands

    def source(self) -> str:
        """Return the name on the bus of the client whose request is being answered."""
        request = current_request.get()
        return request.source if request else self.node.source

    async def write(self, actuator: str, value: float | None, priority: int) -> None:
        """Write an actuator or relinquish it; errors as `NodeClient.write`, and `NodeLost` without a timely reply."""
        await _in_time(self.node.write(actuator, value, priority=priority, source=self.source()))
        self._changed()

    async def set_paused(self, *, paused: bool) -> None:
        """Pause or resume the node."""
        if paused:
            await self._command(keys.PAUSE, Pause(source=self.source()))
        else:
            await self._command(keys.RESUME, Resume(source=self.source()))

    @property
    def steps_left(self) -> int:
        """Timesteps that the paused node still has to simulate before its sample, by its latest status."""
        status, sample = self.status.value, self.sample
        if status is None or not status.paused or not self.node.is_online:
            return 0
        simulated = sample.step - status.step[0] if sample and sample.episode == status.episode[0] else 0
        return max(0, status.steps_left - simulated)

    async def advance(self, steps: int) -> None:
        """Let the paused node simulate some timesteps; return when it has, or after one second.

        Raises:
            RequestRejected: it is not paused, or its episode is over.
            NodeLost: it is gone, or does not reply.
        """
        await self._command(keys.STEP, StepRequest(steps=steps, source=self.source()))
        await self.status.get(since=asyncio.get_running_loop().time())
        try:
            await self.node.wait_for(lambda: not self.steps_left, timeout_s=ANSWER_S / 2, what="the last timestep")
        except (RequestRejected, NodeLost):
            return  # `steps_left` and the reliability tell the client

    async def _command(self, topic: keys.Topic, message: Message) -> None:
        await _in_time(self.node.ask(topic, message, Ack))
        self._changed()


async def _in_time(reply: Awaitable[T]) -> T:
    try:
        async with asyncio.timeout(ANSWER_S):
            return await reply
    except TimeoutError:
        raise NodeLost("the node does not reply") from None
    except PeerError as error:
        if isinstance(error, RequestRejected):
            raise
        raise NodeLost(str(error)) from None
