"""Connections to an MQTT broker."""

from __future__ import annotations

import asyncio
import logging
import ssl
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import aiomqtt
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from zenostat.gateways.tasks import cancel
from zenostat.topics.errors import BusError, InvalidConfig

_CONNECT_S = 10.0
_END_S = 1.0
_SHOWN = 200
_NO_ANSWER = "it ended the connection without an answer; it may expect TLS, or a certificate of this client"

_NOT_TLS = ("WRONG_VERSION_NUMBER", "PACKET_LENGTH_TOO_LONG", "RECORD_LAYER_FAILURE")
"""OpenSSL's reasons for bytes that are no TLS."""

_LOGGER = logging.getLogger(__name__)  # for aiomqtt: what goes wrong is in its exceptions as well
_LOGGER.addHandler(logging.NullHandler())
_LOGGER.propagate = False


@dataclass(frozen=True, slots=True)
class Broker:
    """Address and credentials of a broker.

    Attributes:
        host, port: its address.
        username, password: None for anonymous access.
        tls: certificates for an encrypted connection; None for a plain one.
        version: 5 or 3 (for 3.1.1), of the protocol.

    Raises:
        InvalidConfig: there is a client's key without its certificate.
    """

    host: str
    port: int
    username: str | None = None
    password: str | None = None
    tls: aiomqtt.TLSParameters | None = None
    version: int = 5

    def __post_init__(self) -> None:
        if self.tls is not None and self.tls.keyfile is not None and self.tls.certfile is None:
            raise InvalidConfig(f"{self.tls.keyfile}: a client's key without its certificate would not be used")
        if self.tls is not None:
            _check_files(self.tls)

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"


class _MessageRejected(Exception):
    """The broker has rejected a message; the text is its reason."""


class BrokerClient(aiomqtt.Client):
    """A client of a broker that reports which messages and subscriptions the broker rejects.

    In MQTT 3.1.1 brokers do not say that they reject a message.

    Args:
        hostname, port, settings: of aiomqtt's client.
        on_rejected: called with a text for each message and each subscription that the broker rejects.
    """

    def __init__(self, hostname: str, port: int, on_rejected: Callable[[str], None], **settings: Any) -> None:
        super().__init__(hostname, port, **settings)
        self._on_rejected = on_rejected
        self._reasons: dict[int, str] = {}
        self._confirmed: set[str] = set()

    async def send(
        self, topic: str, payload: str | bytes, *, qos: int = 0, retain: bool = False,
        properties: Properties | None = None,
    ) -> bool:  # fmt: skip
        """Publish a message; return whether the broker has not rejected it.

        The broker confirms no message of QoS 0. Those of a topic have QoS 1 until it has confirmed one.
        """
        own_qos = qos if topic in self._confirmed else 1
        try:
            await self.publish(topic, payload, qos=own_qos, retain=retain, properties=properties)
        except _MessageRejected as error:
            self._on_rejected(f"a message on {topic[:_SHOWN]!r} ({error})")
            return False
        if qos == 0:
            self._confirmed.add(topic)
        return True

    async def listen(self, topic: str, **options: Any) -> None:
        """Subscribe to a topic."""
        codes = await self.subscribe(topic, **options)
        if failures := [code for code in codes if isinstance(code, ReasonCode) and code.is_failure]:
            self._on_rejected(f"the subscription to {topic!r} ({failures[0]})")

    # Methods of aiomqtt, which waits for the answer of a broker that has ended the connection instead of answering, and
    # has no public access to the reason code of a PUBACK.

    def _on_disconnect(
        self, client: Any, userdata: Any, flags: Any, reason_code: ReasonCode, properties: Any = None
    ) -> None:
        if self._connected.done():
            super()._on_disconnect(client, userdata, flags, reason_code, properties)
        else:
            self._connected.set_exception(aiomqtt.MqttError(_NO_ANSWER))
            self._connected.exception()  # nobody waits for it if the thread that connects raises an error as well

    def _on_publish(self, client: Any, userdata: Any, mid: int, reason_code: ReasonCode, properties: Any) -> None:
        if reason_code.is_failure:
            self._reasons[mid] = str(reason_code)
        super()._on_publish(client, userdata, mid, reason_code, properties)

    @contextmanager
    def _pending_call(self, mid: int, value: Any, pending_dict: dict[int, Any]) -> Iterator[None]:
        self._reasons.pop(mid, None)
        with super()._pending_call(mid, value, pending_dict):
            yield
        if reason := self._reasons.pop(mid, ""):
            raise _MessageRejected(reason)


def _check_files(tls: aiomqtt.TLSParameters) -> None:
    """Raise `InvalidConfig` if a file of certificates or keys cannot be used, which names it."""
    try:
        context = ssl.create_default_context(cafile=tls.ca_certs)
    except OSError as error:
        raise InvalidConfig(f"{tls.ca_certs} is no CA certificate (PEM): {error}") from None
    if tls.certfile is not None:
        try:
            context.load_cert_chain(tls.certfile, tls.keyfile, password=lambda: "")
        except OSError as error:
            files = tls.certfile if tls.keyfile is None else f"{tls.certfile} and {tls.keyfile}"
            raise InvalidConfig(f"{files}: no certificate and its key (PEM, not encrypted): {error}") from None


async def connect(broker: Broker, status_topic: str, on_rejected: Callable[[str], None]) -> BrokerClient:
    """Return a client that is connected.

    Args:
        broker: the broker.
        status_topic: topic of the last will, `offline`.
        on_rejected: see `BrokerClient`.

    Raises:
        BusError: the broker cannot be reached or rejects the connection.
    """
    is_v5 = broker.version == 5
    client = BrokerClient(
        broker.host, broker.port, on_rejected, username=broker.username, password=broker.password,
        tls_params=broker.tls, protocol=aiomqtt.ProtocolVersion.V5 if is_v5 else aiomqtt.ProtocolVersion.V311,
        clean_session=None if is_v5 else True, timeout=_CONNECT_S, keepalive=15,
        will=aiomqtt.Will(status_topic, b"offline", qos=1, retain=True), logger=_LOGGER,
    )  # fmt: skip
    connecting = asyncio.create_task(client.__aenter__())
    try:
        await asyncio.shield(connecting)
    except asyncio.CancelledError:
        await asyncio.wait((connecting,), timeout=_END_S)  # a thread of aiomqtt opens the socket
        await disconnect(client)  # before the task ends: aiomqtt's callbacks need its futures
        await cancel(connecting, retry_s=_END_S)
        raise
    except (aiomqtt.MqttError, OSError, ValueError) as error:
        await disconnect(client)
        hint = "; it may not speak TLS" if broker.tls is not None and _is_no_tls(error.__context__) else ""
        raise BusError(f"no connection to the MQTT broker {broker}: {error}{hint}") from None
    return client


def _is_no_tls(error: BaseException | None) -> bool:
    """Return whether an error of a TLS handshake is that of a peer that does not speak TLS."""
    if isinstance(error, ssl.SSLError):
        return isinstance(error, ssl.SSLEOFError) or error.reason in _NOT_TLS
    return isinstance(error, ConnectionResetError)


async def disconnect(client: aiomqtt.Client) -> None:
    """Close a connection, whatever its state: one that is open when the interpreter ends is an error there."""
    with suppress(aiomqtt.MqttError, TimeoutError):
        async with asyncio.timeout(_END_S):
            await client.__aexit__(None, None, None)
