"""One node on an MQTT broker."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from contextlib import AsyncExitStack, suppress
from itertools import chain, repeat
from typing import TypeVar

import aiomqtt
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.subscribeoptions import SubscribeOptions

from zenostat.bridge.client.sample import SampleView
from zenostat.gateways.clients import UNRESTRICTED, Clients
from zenostat.gateways.mqtt.broker import Broker, BrokerClient, connect, disconnect
from zenostat.gateways.mqtt.commands import Counts, Received, Result
from zenostat.gateways.mqtt.home_assistant import discovery, discovery_topics, is_discovery
from zenostat.gateways.mqtt.messages import (
    accepted,
    event_json,
    manifest_json,
    number,
    read_command,
    read_manifest,
    rejected,
    sample_json,
)
from zenostat.gateways.mqtt.retained import RetainedMessages, point_topics, stored_topics
from zenostat.gateways.mqtt.topic_names import PREFIX, is_below, is_topic
from zenostat.gateways.node_client import NodeClient
from zenostat.gateways.notices import Notices
from zenostat.gateways.points import effective_value, readings
from zenostat.gateways.tasks import cancel
from zenostat.topics.errors import (
    AccessDenied,
    BadMessage,
    BusError,
    NameInUse,
    NodeLost,
    RequestRejected,
    ZenostatError,
)
from zenostat.topics.keys import own_name
from zenostat.topics.messages import Event, Manifest

MAX_WAITING = 1000
"""Largest number of commands, samples or events that wait; further commands are rejected, the oldest others dropped."""

MAX_RESULTS = 20_000
"""Largest number of results that wait while the broker is away or slow; beyond, the oldest are dropped."""

T = TypeVar("T")

_RETRY_S = (0.5, 1.0, 2.0, 5.0, 10.0)
_END_S = 2.0
_SHOWN = 200
_ATTEMPTS = 2  # a broker may end the connection because of a response topic, for example one with too many levels


class MqttGateway:
    """Publishes one node to a broker and carries out commands: `async with MqttGateway(node, broker) as gateway`.

    On entering the context it connects for the first time. Later, it reconnects for as long as it runs. Commands that
    arrived before a connection was lost are carried out, and their results are published on the next connection.

    Args:
        node: the node.
        broker: the broker.
        root: topic below which all topics of the node are; None for `zenostat/NODE`.
        priority: priority of commands that name none.
        clients: names of users, and what they may write.
        home_assistant: discovery prefix of Home Assistant; None for no discovery messages.
        notify: called with a text when the broker is lost, when it is back, and for each topic that it rejects.

    Raises:
        BusError: on entering the context, the broker cannot be reached or rejects the connection.
        NameInUse: on entering the context, the gateway of another node publishes below the same topic.

    Attributes:
        counts: counts of messages.
    """

    def __init__(
        self,
        node: NodeClient,
        broker: Broker,
        *,
        root: str | None = None,
        priority: int = 8,
        clients: Clients = UNRESTRICTED,
        home_assistant: str | None = None,
        notify: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.counts = Counts()
        self._node, self._broker, self._priority = node, broker, priority
        self._root = f"{PREFIX}/{node.name}" if root is None else root
        self._home_assistant, self._notify, self._clients = home_assistant, notify, clients
        self._denials, self._refusals = Notices(notify), Notices(notify)
        # Nobody may use the gateway's rights on the broker to publish where other clients believe what is there.
        own = self._root if not is_below(self._root, PREFIX) else PREFIX
        self._own_roots = [*dict.fromkeys(root for root in (PREFIX, own, home_assistant) if root is not None)]
        self._samples: deque[str] = deque(maxlen=MAX_WAITING)
        self._events: deque[str] = deque(maxlen=MAX_WAITING)
        self._results: deque[Result] = deque(maxlen=MAX_RESULTS)
        self._commands: deque[Received] = deque()
        self._has_output, self._has_commands = asyncio.Event(), asyncio.Event()
        self._retained = RetainedMessages()
        self._cleared_for: Manifest | None = None
        self._executing: asyncio.Task[None] | None = None
        self._close = AsyncExitStack()

    async def __aenter__(self) -> MqttGateway:
        listeners = self._node.listeners
        self._listen(listeners.samples, self._on_sample)
        self._listen(listeners.events, self._on_event)
        self._listen(listeners.presence, self._on_change)
        self._listen(listeners.manifests, self._on_change)
        self._client = await self._connect()
        try:
            await self._check_unused(self._client)
        except BaseException:
            await disconnect(self._client)
            raise
        self._close.push_async_callback(self._say_goodbye)
        return self

    def _listen(self, functions: list[Callable[[T], None]], function: Callable[[T], None]) -> None:
        functions.append(function)
        self._close.callback(functions.remove, function)

    async def __aexit__(self, *_: object) -> None:
        await self._close.aclose()

    @property
    def waiting(self) -> int:
        """Number of commands that wait for the one that is carried out."""
        return len(self._commands)

    @property
    def description(self) -> str:
        """Node and broker, for the first line."""
        safety = "encrypted" if self._broker.tls else "without encryption"
        password = "with a password" if self._broker.password else "without a password"
        return (
            f"node {self._node.name} on the MQTT broker {self._broker} under {self._root}/, {safety}, {password}; "
            f"{self._clients.description}"
        )

    def summary(self) -> str:
        """Return counts for the last line."""
        counts = self.counts
        lost = f", {counts.lost_results} of their results dropped" if counts.lost_results else ""
        return (
            f"{counts.samples} samples published, {counts.dropped} samples and events dropped; "
            f"{counts.accepted} commands accepted, {counts.rejected} rejected, {counts.denied} of them denied{lost}; "
            f"{counts.refused} messages refused by the broker, {counts.reconnections} reconnections"
        )

    async def run(self) -> None:
        """Publish and carry out commands until cancelled; then answer those that wait."""
        executing = asyncio.create_task(self._execute())
        try:
            while True:
                try:
                    await self._serve(self._client)
                except aiomqtt.MqttError as error:
                    self._notify(f"the broker {self._broker} is lost ({error}); reconnecting")
                    await disconnect(self._client)
                self._client = await self._reconnect()
                self.counts.reconnections += 1
                self._notify(f"connected to the broker {self._broker} again")
        finally:
            executing.cancel()
            await self._reject_waiting()

    # Connection

    async def _connect(self) -> BrokerClient:
        return await connect(self._broker, f"{self._root}/status", self._on_rejected)

    async def _reconnect(self) -> BrokerClient:
        """Try to connect until it succeeds; each different reason why it fails is reported once."""
        failures, waits_s = Notices(self._notify), chain(_RETRY_S, repeat(_RETRY_S[-1]))
        while True:
            await asyncio.sleep(next(waits_s))
            try:
                return await self._connect()
            except BusError as error:
                failures.add(str(error))

    async def _check_unused(self, client: BrokerClient) -> None:
        """Raise `NameInUse` if the gateway of another node publishes below the same topic."""
        names, stored = ("status", "manifest"), dict[str, bytes]()
        with suppress(aiomqtt.MqttError):  # it may not read there; if the connection is lost, there will be another one
            for name in names:  # a broker sends what it has stored at once
                await client.subscribe(f"{self._root}/{name}", qos=1)
            for name in names:
                await client.unsubscribe(f"{self._root}/{name}")
        while len(client.messages):
            message = await anext(client.messages)
            if message.retain and isinstance(message.payload, bytes):
                stored[str(message.topic)] = message.payload
        status, manifest = (stored.get(f"{self._root}/{name}", b"") for name in names)
        own, other = self._node.manifest, read_manifest(manifest)
        if status == b"online" and other is not None and other != (own.node, own.instance):
            raise NameInUse(
                f"a gateway of node {other[0]!r} publishes below {self._root}/ on the broker {self._broker}; choose "
                f"another topic with --topic. If it has ended without the broker's notice, remove {self._root}/status: "
                "publish an empty retained message there"
            )

    def _on_rejected(self, text: str) -> None:
        self.counts.refused += 1
        self._refusals.add(f"the broker {self._broker} rejects {text}")

    async def _reject_waiting(self) -> None:
        """Wait a moment for the command in progress, and reject those after it."""
        if self._executing is not None:
            await asyncio.wait((self._executing,), timeout=_END_S)
            await cancel(self._executing, retry_s=_END_S)
        while self._commands:
            error = RequestRejected("the gateway has ended")
            self._reply(self._commands.popleft(), rejected(error), is_accepted=False)

    async def _say_goodbye(self) -> None:
        """Publish the last results and that the node is not served any more, and disconnect.

        A lost broker publishes the last will.
        """
        try:
            async with asyncio.timeout(_END_S):
                while self._results:
                    await self._publish_next(self._client)
                await self._client.send(f"{self._root}/status", b"offline", qos=1, retain=True)
        except (aiomqtt.MqttError, TimeoutError):
            pass
        await disconnect(self._client)

    async def _serve(self, client: BrokerClient) -> None:
        """Serve one connection until it is lost."""
        self._retained.reconnected()
        self._cleared_for = None
        self._has_output.set()
        tasks = [asyncio.create_task(self._receive(client)), asyncio.create_task(self._publish(client))]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        finally:
            await cancel(*tasks, retry_s=0.2)
            while len(client.messages):  # received, and confirmed to the broker
                self._take(await anext(client.messages))

    # From the node

    def _on_sample(self, sample: SampleView) -> None:
        self._queue(self._samples, sample_json(sample, readings(self._node.manifest)))

    def _on_event(self, event: Event) -> None:
        self._queue(self._events, event_json(event))

    def _queue(self, waiting: deque[str], text: str) -> None:
        self.counts.dropped += len(waiting) == MAX_WAITING
        waiting.append(text)
        self._has_output.set()

    def _on_change(self, _: bool | Manifest) -> None:  # noqa: FBT001
        self._has_output.set()

    # To the broker

    async def _publish(self, client: BrokerClient) -> None:
        """Publish results, events and samples as they come, and each point's latest value where it has changed."""
        while True:
            await self._has_output.wait()
            self._has_output.clear()
            await self._publish_state(client)
            for _ in range(len(self._results) + len(self._events) + len(self._samples)):  # those to come: next time
                await self._publish_next(client)
            await self._publish_points(client)

    async def _publish_next(self, client: BrokerClient) -> None:
        if self._results:
            result = self._results[0]
            await self._publish_result(client, result)
            _remove_first(self._results, result)  # only now: it is published again if the connection was lost meanwhile
        elif self._events:
            event = self._events[0]
            await client.send(f"{self._root}/event", event, qos=1)
            _remove_first(self._events, event)
        elif self._samples:
            self.counts.samples += await client.send(f"{self._root}/sample", self._samples.popleft())

    async def _publish_result(self, client: BrokerClient, result: Result) -> None:
        if result.attempts_left is not None:
            if result.attempts_left == 0:
                return
            result.attempts_left -= 1
        properties = None
        if result.correlation is not None:
            properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
            properties.CorrelationData = result.correlation
        await client.send(result.topic, result.text, qos=1, properties=properties)

    async def _publish_state(self, client: BrokerClient) -> None:
        manifest, root, publish = self._node.manifest, self._root, self._retained.publish
        await publish(client, f"{root}/manifest", manifest_json(manifest, readings(manifest)), qos=1)
        discovered = [] if self._home_assistant is None else [*discovery(manifest, root, self._home_assistant)]
        for topic, text in discovered:
            await publish(client, topic, text, qos=1)
        await publish(client, f"{root}/status", "online" if self._node.is_online else "offline", qos=1)
        if self._cleared_for is not manifest:  # another building may not have all points of the former one
            own = [f"{root}/manifest", f"{root}/status", *(topic for topic, _ in discovered)]
            self._cleared_for = manifest  # before: a stored message may arrive meanwhile
            await self._retained.clear_others(client, [*own, *point_topics(manifest, root)])

    async def _publish_points(self, client: BrokerClient) -> None:
        sample = self._node.sample
        if sample is None or not self._node.is_online:
            return
        values = [reading.of(sample) for reading in readings(sample.manifest)]
        values += [effective_value(sample, index) for index in range(len(sample.manifest.actuators))]
        topics = point_topics(sample.manifest, self._root)
        await self._retained.publish_all(client, zip(topics, map(number, values), strict=True))

    # Commands

    async def _receive(self, client: BrokerClient) -> None:
        is_v5 = self._broker.version == 5
        # Else a broker shows only at the next connection that a command is retained; MQTT 3.1.1 has no such option.
        flags = {"options": SubscribeOptions(1, retainAsPublished=True)} if is_v5 else {"qos": 1}
        await client.listen(f"{self._root}/actuator/+/set", **flags)
        await client.listen(f"{self._root}/client/+/actuator/+/set", **flags)
        await self._ask_for_stored(client)
        async for message in client.messages:
            self._take(message)

    async def _ask_for_stored(self, client: BrokerClient) -> None:
        """Let the broker send the values and discovery messages that it has stored, but not those that follow."""
        is_v5 = self._broker.version == 5
        topics = stored_topics(self._root)
        topics += [] if self._home_assistant is None else discovery_topics(self._home_assistant)
        for topic in topics:
            await client.listen(topic, **({"options": SubscribeOptions(0, noLocal=True)} if is_v5 else {"qos": 0}))
            if not is_v5:  # it would send what the gateway publishes
                await client.unsubscribe(topic)

    def _take(self, message: aiomqtt.Message) -> None:
        """Queue a command, or add the topic of a stored message."""
        properties, levels = message.properties, str(message.topic).removeprefix(f"{self._root}/").split("/")
        if len(levels) < 3 or levels[-1] != "set":
            self._take_stored(message)
            return
        user, actuator = levels[1] if len(levels) > 3 else None, levels[-2]
        reply_topic = getattr(properties, "ResponseTopic", None)
        if not is_topic(reply_topic) or reply_topic == self._result_topic(actuator, user):
            reply_topic = None
        is_own = reply_topic is not None and any(is_below(reply_topic, root) for root in self._own_roots)
        received = Received(
            user,
            actuator,
            message.payload if isinstance(message.payload, bytes) else str(message.payload or "").encode(),
            bool(message.retain),
            None if is_own else reply_topic,
            reply_topic if is_own else None,
            getattr(properties, "CorrelationData", None),
        )
        if len(self._commands) >= MAX_WAITING:
            error = RequestRejected(f"{MAX_WAITING} commands are waiting; try again later")
            self._reply(received, rejected(error), is_accepted=False)
        else:
            self._commands.append(received)
            self._has_commands.set()

    def _take_stored(self, message: aiomqtt.Message) -> None:
        """Add the topic of a stored message, so that it is cleared unless the building has that point."""
        topic, payload = str(message.topic), message.payload
        if not message.retain or not payload or not isinstance(payload, bytes):
            return
        is_own = is_below(topic, self._root) or is_discovery(payload, self._root)
        if is_own and self._retained.add_stored(topic):
            self._cleared_for = None
            self._has_output.set()

    async def _execute(self) -> None:
        """Carry out commands one after another, in the order received, also while the broker is away."""
        while True:
            await self._has_commands.wait()
            self._has_commands.clear()
            while self._commands:
                self._executing = asyncio.create_task(self._carry_out(self._commands.popleft()))
                await asyncio.shield(self._executing)

    async def _carry_out(self, received: Received) -> None:
        try:
            if received.is_retained:
                raise BadMessage("a retained command is ignored: it would be repeated at each connection")
            if received.own_topic is not None:
                own = " and ".join(f"{root}/" for root in self._own_roots)
                raise BadMessage(
                    f"response topic {received.own_topic[:_SHOWN]!r} is a gateway's own; choose one that is not below "
                    f"{own}, or {self._result_topic(received.actuator, received.user)}"
                )
            if received.user == "":
                raise BadMessage("the topic has an empty user: client/USER/actuator/NAME/set, or actuator/NAME/set")
            client = "" if received.user is None else self._clients.of_mqtt(received.user)
            self._clients.check(client, (received.actuator,))
            own_source = self._node.source_of(client)
            command = read_command(received.payload, priority=self._priority, source=own_source)
            ack = await self._node.write(
                received.actuator, command.value, priority=command.priority, duration_s=command.duration_s,
                source=own_name(own_source, command.source),
            )  # fmt: skip
        except asyncio.CancelledError:
            error = NodeLost("the gateway has ended before the node answered; the command may take effect")
            self._reply(received, rejected(error), is_accepted=False)
            raise
        except AccessDenied as error:
            self.counts.denied += 1
            user = "" if received.user is None else f" of the user {received.user[:_SHOWN]}"
            self._denials.add(f"a command{user} was denied: {error}")
            self._reply(received, rejected(error), is_accepted=False)
        except ZenostatError as error:
            self._reply(received, rejected(error), is_accepted=False)
        else:
            at = (ack.episode[0] if ack.episode else 0, ack.step[0] if ack.step else 0)
            self._reply(received, accepted(command, ack.text, *at), is_accepted=True)

    def _result_topic(self, actuator: str, user: str | None) -> str:
        root = self._root if user is None else f"{self._root}/client/{user}"
        return f"{root}/actuator/{actuator}/result"

    def _reply(self, received: Received, text: str, *, is_accepted: bool) -> None:
        """Queue the result for `…/actuator/NAME/result`, and for the response topic of an MQTT 5 client."""
        self.counts.accepted += is_accepted
        self.counts.rejected += not is_accepted
        own = self._result_topic(received.actuator, received.user)
        if is_topic(own):  # it is longer than the topic of the command
            self._queue_result(Result(own, text, received.correlation))
        if received.reply_topic:
            self._queue_result(Result(received.reply_topic, text, received.correlation, _ATTEMPTS))

    def _queue_result(self, result: Result) -> None:
        if len(self._results) == MAX_RESULTS:
            self.counts.lost_results += 1
            if self.counts.lost_results == 1:
                self._notify(
                    f"{MAX_RESULTS:,} results of commands wait for the broker; from now on the oldest are dropped"
                )
        self._results.append(result)
        self._has_output.set()


def _remove_first(waiting: deque[T], item: T) -> None:
    """Remove an item from the front of a queue, unless a full queue has dropped it meanwhile."""
    if waiting and waiting[0] is item:
        waiting.popleft()
