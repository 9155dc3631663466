"""One node of a bus in the asyncio program of a gateway."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from contextlib import AsyncExitStack, suppress
from typing import Any, TypeVar

import zenoh

from zenostat.bridge.client.priorities import PriorityValue, decode_priorities
from zenostat.bridge.client.sample import SampleView
from zenostat.gateways.bus_side import BusMessage, BusSide
from zenostat.gateways.exclusive_names import liveliness_tokens
from zenostat.gateways.node_listeners import Counts, Listeners
from zenostat.gateways.written_commands import Relinquished, relinquish
from zenostat.topics import codec, keys
from zenostat.topics.errors import (
    BadMessage,
    InvalidAction,
    NodeLost,
    NodeNotFound,
    RequestRejected,
    ZenostatError,
    did_you_mean,
    from_wire,
)
from zenostat.topics.messages import (
    Ack,
    ErrorReply,
    Event,
    EventKind,
    Manifest,
    Message,
    Pause,
    PriorityArrays,
    Query,
    Resume,
    Sample,
    State,
    Status,
    StepRequest,
    Write,
)
from zenostat.topics.points import PointIndex, actuator_index, value_index

M = TypeVar("M", bound=Message)

REQUEST_TIMEOUT_S = 30.0
"""Time after which a node that is present but does not answer fails a request."""

MAX_PENDING = 256
"""Largest number of requests that wait for replies; further ones are rejected."""

_QUERY_AFTER_S = 1.0
"""Time after which the node is asked for its sample: one that was streamed over a congested link may be lost."""

_STATE_S = 2.0  # a busy node that does not say that it has failed is one that runs

_MAX_WAITING_MESSAGES = 4096
_MESSAGES_PER_TURN = 256  # then other tasks of the loop have their turn


class NodeClient:
    """One node for a gateway: `async with NodeClient(session, "office") as node:`.

    All methods and attributes belong to the running loop's thread. While the node is not on the bus, requests raise
    `NodeLost`; once a node of that name is back, the client has its manifest and its samples again.

    Args:
        session: an open Zenoh session, which the caller closes.
        name: the node's name.
        source: default name of the writer, which samples and events show.
        identity: the name in the gateway's certificate, below which all sources are; empty without keys.
        via: the protocol of its clients, which recordings show as the way in.

    Raises:
        InvalidConfig: the node's name is not valid.
        NodeNotFound: on entering the context, no node of that name is on the bus.

    Attributes:
        name: the node's name.
        source: the default name of the writer, below the identity.
        manifest: the node's latest manifest.
        sample: slot 0 of its latest sample; None before the first one.
        is_online: whether it is on the bus.
        has_failed: whether its simulation has failed; until it has a sample again.
        listeners: functions to call at samples, events, presence and manifests.
        counts: counts of messages.
    """

    manifest: Manifest

    def __init__(
        self, session: zenoh.Session, name: str, *, source: str = "gateway", identity: str = "", via: str = ""
    ) -> None:
        self._identity, self._via = identity, via
        self.name, self.source = keys.check_name(name, "the node's name"), keys.own_name(identity, source)
        self.sample: SampleView | None = None
        self.is_online = self.has_failed = False
        self.listeners, self.counts = Listeners(), Counts()
        self._session = session
        self._index = PointIndex((), "sensor or meter")
        self._instance = ""
        self._pending: set[asyncio.Future[Any]] = set()
        self._tasks: set[asyncio.Task[None]] = set()
        self._changed = asyncio.Event()
        self._messages: deque[BusMessage] = deque(maxlen=_MAX_WAITING_MESSAGES)
        self._is_scheduled = False
        self._close = AsyncExitStack()

    async def __aenter__(self) -> NodeClient:
        self._loop = asyncio.get_running_loop()
        async with AsyncExitStack() as stack:
            self._bus = BusSide(self._session, self._post, self._via)
            stack.callback(self._bus.close)
            self._set_manifest(await self.ask(keys.MANIFEST, None, Manifest))
            self.is_online = True
            self._bus.listen(self.name, self._receive, self._on_presence)
            stack.callback(self._cancel)
            await self._fetch_sample()
            await self._fetch_state()
            self._close = stack.pop_all()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._close.aclose()

    def source_of(self, client: str) -> str:
        """Return the name on the bus of a client of the gateway, below the gateway's own; that one for no name."""
        return f"{self.source}.{client}" if client else self.source

    # Requests

    async def write(
        self,
        actuator: str,
        value: float | None,
        *,
        priority: int = 8,
        duration_s: float | None = None,
        source: str | None = None,
    ) -> Ack:
        """Write one actuator in all slots and return the node's reply; effective from the next timestep.

        Args:
            actuator: the actuator's name.
            value: in the actuator's unit; None relinquishes it at this priority.
            priority: 1 (highest) to 16; 8 is a manual operator's.
            duration_s: simulated seconds after which the value is relinquished.
            source: name of the writer, which is placed below the gateway's own; None for the gateway itself.

        Raises:
            UnknownName: no such actuator; the text lists similar names.
            InvalidAction: value, priority, duration or source out of range.
            RequestRejected: the node rejected the write, with its reason, or too many requests are waiting.
            NodeLost, PeerError: as for `ask`.
        """
        try:
            actuator_index(self.manifest).require([actuator])
            source = keys.own_name(self.source, source or "")
            fields = {"value": value, "priority": priority, "duration_s": duration_s, "source": source}
            message = codec.validated(Write, fields, actuator, InvalidAction)
            ack = await self.ask(keys.WRITE_REQUEST, message, Ack, name=actuator)
        except ZenostatError:
            self.counts.rejected += 1
            raise
        self.counts.writes += 1
        return ack

    async def relinquish_written(self) -> Relinquished:
        """Relinquish the commands in force of this client's source and those below it, whichever process wrote them.

        Raises:
            RequestRejected: the node has no priority arrays, as in a replay, so no command is in force.
            NodeLost, PeerError: as for `ask`.
        """
        return await relinquish(self.ask, self.manifest, self.source)

    async def priorities(self, slot: int = 0) -> dict[str, list[PriorityValue]]:
        """Return each actuator's priority array in a slot by its name: 16 entries, that of priority 1 first."""
        return decode_priorities(await self.ask(keys.PRIORITIES, Query(), PriorityArrays), self.manifest, slot)

    async def pause(self) -> None:
        """Pause the node, so that it steps on command; see `step`."""
        await self.ask(keys.PAUSE, Pause(source=self.source), Ack)

    async def resume(self) -> None:
        """Resume a paused node."""
        await self.ask(keys.RESUME, Resume(source=self.source), Ack)

    async def step(self, steps: int = 1, *, timeout_s: float = REQUEST_TIMEOUT_S) -> SampleView:
        """Let a paused node simulate some timesteps, and return the sample after the last one.

        Raises:
            RequestRejected: the node is not paused, its episode is over, or its mode is lockstep and a controller
                that it requires has not answered within `timeout_s`.
        """
        before = self.sample
        if before is not None and before.truncated:
            raise RequestRejected("the episode is over; reset the node to start another one")
        await self.ask(keys.STEP, StepRequest(steps=steps, source=self.source), Ack)
        target = (before.episode, before.step + steps) if before is not None else (0, steps)

        def is_there() -> bool:
            sample = self.sample
            return sample is not None and ((sample.episode, sample.step) >= target or sample.truncated)

        await self.wait_for(is_there, timeout_s=timeout_s, what=f"sample {target[1]}")
        assert self.sample is not None
        return self.sample

    async def wait_for(self, condition: Callable[[], bool], *, timeout_s: float, what: str) -> None:
        """Wait until a condition on this client holds, which is tested after each sample and change of presence.

        Raises:
            NodeLost: the node left the bus.
            RequestRejected: it did not hold in time.
        """
        try:
            async with asyncio.timeout(timeout_s):
                while not condition():
                    if not self.is_online:
                        raise NodeLost(f"node {self.name!r} is gone")
                    self._changed.clear()
                    try:
                        async with asyncio.timeout(_QUERY_AFTER_S):
                            await self._changed.wait()
                    except TimeoutError:
                        await self._fetch_sample()
        except TimeoutError:
            raise RequestRejected(f"node {self.name!r} did not reach {what} within {timeout_s:g} s") from None

    async def ask(
        self,
        topic: keys.Topic,
        request: Message | None,
        reply_type: type[M],
        *,
        name: str = "",
        timeout_s: float = REQUEST_TIMEOUT_S,
    ) -> M:
        """Send a request to the node and return its reply.

        Raises:
            ZenostatError: the error that the node replied with.
            NodeNotFound: it has never been on the bus.
            NodeLost: it is not on the bus any more.
            PeerError: it did not answer in time.
            RequestRejected: more than 256 requests wait for replies.
        """
        if len(self._pending) >= MAX_PENDING:
            raise RequestRejected(f"{MAX_PENDING} requests to node {self.name!r} wait for replies; try again later")
        future: asyncio.Future[BusMessage | None] = self._loop.create_future()
        self._pending.add(future)
        future.add_done_callback(self._pending.discard)

        def then(message: BusMessage | None) -> None:
            if not future.done():
                future.set_result(message)

        sender = ""
        if topic.has_sender and request is not None:
            field = keys.sender_field(type(request))
            sender = keys.own_name(self._identity, (getattr(request, field) if field else "") or self.source)
            request = request.model_copy(update={field: sender}) if field else request
        payload = None if request is None else codec.encode(request)
        self._bus.ask(topic, self.name, payload, then, name=name, sender=sender, timeout_s=timeout_s)
        reply = await future
        if reply is None:  # nobody answers to this key
            if self._instance:
                raise NodeLost(f"node {self.name!r} is gone")
            tokens = await liveliness_tokens(self._session, keys.NODE_TOKEN.at("*", name="*"))
            names = sorted(set(map(keys.node_of, tokens)))
            raise NodeNotFound(f"no node {self.name!r} on the bus; {did_you_mean(self.name, names)}")
        if reply.denied:
            raise from_wire(codec.decode(ErrorReply, reply.payload, reply.encoding).__dict__)
        return codec.decode(reply_type, reply.payload, reply.encoding)

    # From Zenoh's threads

    def _post(self, task: Callable[[], None]) -> None:
        """Call a function in the loop's thread, unless the loop is closed."""
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(task)

    def _receive(self, message: BusMessage) -> None:
        if len(self._messages) == _MAX_WAITING_MESSAGES:
            self.counts.missed += 1
        self._messages.append(message)
        if not self._is_scheduled:
            self._is_scheduled = True
            self._post(self._deliver)

    # In the loop's thread

    def _deliver(self) -> None:
        self._is_scheduled = False
        for _ in range(min(len(self._messages), _MESSAGES_PER_TURN)):
            message = self._messages.popleft()
            try:
                self._handle(message)
            except BadMessage:
                self.counts.rejected += 1
        if self._messages and not self._is_scheduled:
            self._is_scheduled = True
            self._post(self._deliver)

    def _handle(self, message: BusMessage) -> None:
        key = keys.last_chunk(message.key)
        if key == keys.SAMPLE.key:
            self._set_sample(codec.decode(Sample, message.payload, message.encoding))
        elif key == keys.EVENT.key:
            event = codec.decode(Event, message.payload, message.encoding)
            self.has_failed = event.kind is EventKind.FAILED or (
                self.has_failed and event.kind is not EventKind.STARTED
            )
            for notify in self.listeners.events:
                notify(event)
        elif key == keys.MANIFEST.key:
            self._set_manifest(codec.decode(Manifest, message.payload, message.encoding))

    def _set_sample(self, message: Sample) -> None:
        sample = self.sample = SampleView(message, self.manifest, self._index)
        self.has_failed = False
        self.counts.samples += 1
        self._changed.set()
        for notify in self.listeners.samples:
            notify(sample)

    async def _fetch_sample(self) -> None:
        """Query the sample, and set it unless a newer one has been received meanwhile."""
        try:
            message = await self.ask(keys.SAMPLE, None, Sample)
        except RequestRejected:  # there is none yet, for example at the beginning of a replay
            return
        latest = self.sample
        if latest is None or (latest.episode, latest.step) < (message.episode[0], message.step[0]):
            self._set_sample(message)

    async def _fetch_state(self) -> None:
        """Query whether the simulation has failed: the event may have been published before this client listened."""
        with suppress(ZenostatError, TimeoutError):
            async with asyncio.timeout(_STATE_S):
                self.has_failed = (await self.ask(keys.STATUS, Query(), Status)).state is State.FAILED

    def _set_manifest(self, manifest: Manifest) -> None:
        if manifest.instance != self._instance:
            self.sample = None  # another building, perhaps with other points
        self.manifest, self._instance, self._index = manifest, manifest.instance, value_index(manifest)
        for notify in self.listeners.manifests:
            notify(manifest)

    def _on_presence(self, _: str, instance: str, is_present: bool) -> None:  # noqa: FBT001
        if is_present and (not self.is_online or instance != self._instance):
            task = self._loop.create_task(self._join())
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        elif not is_present and instance == self._instance and self.is_online:
            self._set_online(value=False)

    async def _join(self) -> None:
        """Get the manifest and the sample of a node that is on the bus again."""
        try:
            manifest = await self.ask(keys.MANIFEST, None, Manifest)
            if manifest.instance == self._instance and self.is_online:
                return
            self._set_manifest(manifest)
            await self._fetch_sample()
            await self._fetch_state()
        except ZenostatError:  # it has left already; the next token reports its return
            return
        self._set_online(value=True)

    def _set_online(self, *, value: bool) -> None:
        self.is_online = value
        self._changed.set()
        for notify in self.listeners.presence:
            notify(value)

    def _cancel(self) -> None:
        for task in [*self._tasks]:
            task.cancel()
