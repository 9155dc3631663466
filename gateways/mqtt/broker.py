"""Connections to an MQTT broker."""

from __future__ import annotations

import asyncio
import logging
from contextlib import suppress
from dataclasses import dataclass

import aiomqtt

from zenostat.gateways.tasks import cancel
from zenostat.topics.errors import BusError, InvalidConfig

_CONNECT_S = 10.0
_END_S = 1.0

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

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"


async def connect(broker: Broker, status_topic: str) -> aiomqtt.Client:
    """Return a client that is connected.

    Args:
        broker: the broker.
        status_topic: topic of the last will, `offline`.

    Raises:
        BusError: the broker cannot be reached or rejects the connection.
    """
    is_v5 = broker.version == 5
    client = aiomqtt.Client(
        broker.host, broker.port, username=broker.username, password=broker.password, tls_params=broker.tls,
        protocol=aiomqtt.ProtocolVersion.V5 if is_v5 else aiomqtt.ProtocolVersion.V311,
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
        raise BusError(f"no connection to the MQTT broker {broker}: {error}") from None
    return client


async def disconnect(client: aiomqtt.Client) -> None:
    """Close a connection, whatever its state: one that is open when the interpreter ends is an error there."""
    with suppress(aiomqtt.MqttError, TimeoutError):
        async with asyncio.timeout(_END_S):
            await client.__aexit__(None, None, None)
