"""Order and loss of what the MQTT gateway publishes, and its connection, without a broker."""

import asyncio
import gc
import warnings
from contextlib import suppress
from types import SimpleNamespace

import aiomqtt
import pytest

from zenostat.gateways.mqtt import gateway as gateway_module
from zenostat.gateways.mqtt.broker import Broker, connect
from zenostat.gateways.mqtt.commands import Received
from zenostat.gateways.mqtt.gateway import MAX_RESULTS, MAX_WAITING, MqttGateway
from zenostat.topics.errors import BusError
from zenostat.topics.messages import Event, EventKind


@pytest.fixture
def gateway() -> MqttGateway:
    return MqttGateway(SimpleNamespace(name="office"), Broker("localhost", 1883))


async def test_mqtt__points_have_their_turn_while_samples_keep_coming(
    gateway: MqttGateway, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Turn(Exception):
        """The points are published."""

    async def publish_state(_: object) -> None:
        pass

    async def publish_points(_: object) -> None:
        raise Turn

    class FreeNode:
        """A broker's client; the node has a new sample whenever one is sent."""

        sent = 0

        async def send(self, *_: object) -> bool:
            self.sent += 1
            assert self.sent <= 3
            gateway._samples.append("{}")
            return True

    monkeypatch.setattr(gateway, "_publish_state", publish_state)
    monkeypatch.setattr(gateway, "_publish_points", publish_points)
    gateway._samples.extend(["{}"] * 3)
    gateway._has_output.set()
    with pytest.raises(Turn):
        await gateway._publish(FreeNode())
    assert len(gateway._samples) == 3


def test_mqtt__events_that_are_dropped_are_counted(gateway: MqttGateway) -> None:
    for number in range(MAX_WAITING + 5):
        gateway._on_event(Event(kind=EventKind.WRITTEN, text=str(number)))
    assert "5 samples and events dropped" in gateway.summary()


def test_mqtt__results_that_are_dropped_are_counted_and_reported_once() -> None:
    notices: list[str] = []
    gateway = MqttGateway(SimpleNamespace(name="office"), Broker("localhost", 1883), notify=notices.append)
    command = Received(None, "setpoint", b"26", is_retained=False, reply_topic=None, own_topic=None, correlation=None)
    for number in range(MAX_RESULTS):
        gateway._reply(command, str(number), is_accepted=True)
    assert "results dropped" not in gateway.summary()
    assert not notices
    for number in range(3):
        gateway._reply(command, str(number), is_accepted=True)
    assert f"{MAX_RESULTS + 3} commands accepted, 0 rejected, 0 of them denied, 3 of their results" in gateway.summary()
    assert notices == ["20,000 results of commands wait for the broker; from now on the oldest are dropped"]


async def test_mqtt__event_that_was_dropped_while_it_was_published_takes_no_other_with_it(gateway: MqttGateway) -> None:
    """The queue is full when one more event comes in the meantime, which drops the one in transit from it."""
    gateway._events.extend(str(number) for number in range(MAX_WAITING))
    published: list[str] = []

    class SlowBroker:
        async def send(self, _: str, text: str, **__: object) -> bool:
            published.append(text)
            if len(published) == 1:
                gateway._queue(gateway._events, "last")
            return True

    while gateway._events:
        await gateway._publish_next(SlowBroker())
    assert published == [*(str(number) for number in range(MAX_WAITING)), "last"]


async def test_mqtt__broker_that_ends_the_connection_without_an_answer_is_said_to_do_so() -> None:
    async def end(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read(1)
        writer.close()

    async with await asyncio.start_server(end, "127.0.0.1", 0) as server:
        port = server.sockets[0].getsockname()[1]
        with pytest.raises(BusError, match="ended the connection without an answer"):
            await connect(Broker("127.0.0.1", port), "status", lambda _: None)


@pytest.mark.parametrize("answer", [b"", b"220 mail.example ready\r\n", b"\x20\x03\x00\x87\x00"])
def test_mqtt__broker_without_tls_is_said_to_be_one(answer: bytes) -> None:
    """It ends the connection, or answers with a text or the bytes of MQTT."""

    async def reject(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read(1)  # the rest is not read, so that the connection is reset
        writer.write(answer)
        writer.close()

    async def error() -> str:
        async with await asyncio.start_server(reject, "127.0.0.1", 0) as server:
            broker = Broker("127.0.0.1", server.sockets[0].getsockname()[1], tls=aiomqtt.TLSParameters())
            with pytest.raises(BusError) as raised:
                await connect(broker, "status", lambda _: None)
            return str(raised.value)

    with warnings.catch_warnings():  # paho leaves the socket of a failed handshake to the garbage collector
        warnings.simplefilter("ignore", ResourceWarning)
        text = asyncio.run(error())
        gc.collect()
    assert text.endswith("; it may not speak TLS")


async def test_mqtt__each_reason_why_the_broker_cannot_be_reached_again_is_reported_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Connected(Exception):
        """The gateway serves the new connection."""

    notices: list[str] = []
    gateway = MqttGateway(SimpleNamespace(name="office"), Broker("localhost", 1883), notify=notices.append)
    gateway._client = aiomqtt.Client("localhost")
    answers = ["refused", "refused", "not authorized", "refused", None]

    async def connect_again(*_: object) -> aiomqtt.Client:
        if (reason := answers.pop(0)) is not None:
            raise BusError(reason)
        return gateway._client

    async def serve(_: object) -> None:
        if not answers:
            raise Connected
        raise aiomqtt.MqttError("closed")

    monkeypatch.setattr(gateway_module, "_RETRY_S", (0.0,))
    monkeypatch.setattr(gateway_module, "connect", connect_again)
    monkeypatch.setattr(gateway, "_serve", serve)
    with suppress(Connected):
        await gateway.run()
    assert notices == [
        "the broker localhost:1883 is lost (closed); reconnecting",
        "refused",
        "not authorized",
        "connected to the broker localhost:1883 again",
    ]
