"""A real MQTT broker as a program, and clients of it.

The broker is mosquitto where it is installed, else rumqttd, which is in the package iotcore. The variable
ZENOSTAT_MQTT_BROKER=mosquitto or ZENOSTAT_MQTT_BROKER=iotcore chooses one of them.
"""

from __future__ import annotations

import importlib.util
import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest

from support.nodes import free_port, until

if TYPE_CHECKING:
    import paho.mqtt.client as paho

MOSQUITTO = shutil.which("mosquitto", path=f"{os.environ['PATH']}:/usr/sbin")
BROKER = os.environ.get("ZENOSTAT_MQTT_BROKER") or ("mosquitto" if MOSQUITTO else "iotcore")

needs_broker = pytest.mark.usefixtures("mqtt_broker")
"""Mark of tests that use a broker; the broker is in their ids."""

needs_mosquitto = pytest.mark.skipif(
    BROKER != "mosquitto", reason="iotcore, the broker of these tests, cannot do it; on Debian: apt install mosquitto"
)
"""Mark of tests of what iotcore cannot do: retain as published, and a limit to the levels of a topic."""


def missing_broker() -> str | None:
    """Return why no broker can be started, None if one can."""
    if BROKER == "mosquitto":
        return None if MOSQUITTO else "mosquitto is not installed; on Debian: apt install mosquitto"
    return None if importlib.util.find_spec("iotcore") else "no MQTT broker is installed: pip install iotcore"


class Security(NamedTuple):
    """A password over TLS that a broker asks for. The files are PEM."""

    username: str
    password: str
    certificate: Path
    key: Path


class Broker:
    """A broker on loopback; it is ready.

    Args:
        folder: of its files.
        security: None for any client, without encryption.
        port: None for a free one.
        settings: further lines of mosquitto's configuration.

    Attributes:
        port: for clients of MQTT 5.
        port_v3: for clients of MQTT 3.1.1; mosquitto has the same for both.
    """

    def __init__(
        self, folder: Path, security: Security | None = None, *, port: int | None = None, settings: Sequence[str] = ()
    ) -> None:
        self.port = port or free_port()
        self.port_v3 = self.port if BROKER == "mosquitto" else free_port()
        self._security, self._settings = security, settings
        self._command = self._mosquitto(folder) if BROKER == "mosquitto" else self._iotcore(folder)
        self.start()

    def _mosquitto(self, folder: Path) -> list[str]:
        lines = [f"listener {self.port} 127.0.0.1", "max_queued_messages 0"]
        if self._security is None:
            lines.append("allow_anonymous true")
        else:
            username, password, certificate, key = self._security
            users = folder / "users"
            subprocess.run(["mosquitto_passwd", "-b", "-c", str(users), username, password], check=True)
            lines += [
                "allow_anonymous false",
                f"password_file {users}",
                f"certfile {certificate}",
                f"keyfile {key}",
                "user root",
            ]
        file = folder / "mosquitto.conf"
        file.write_text("\n".join([*lines, *self._settings]))
        return [MOSQUITTO or "", "-c", str(file)]

    def _iotcore(self, folder: Path) -> list[str]:
        limits = {"connection_timeout_ms": 60_000, "max_payload_size": 1 << 20, "max_inflight_count": 100}
        router = {"id": 0, "max_connections": 100, "max_outgoing_packet_count": 10_000}
        router |= {"max_segment_size": 100 << 20, "max_segment_count": 10}
        tables: dict[str, dict[str, Any]] = {"router": router}
        for version, port in (("v5", self.port), ("v4", self.port_v3)):
            tables[f"{version}.1"] = {"name": version, "listen": f"127.0.0.1:{port}", "next_connection_delay_ms": 1}
            tables[f"{version}.1.connections"] = limits
            if self._security is not None:
                username, password, certificate, key = self._security
                tables[f"{version}.1.tls"] = {"certpath": str(certificate), "keypath": str(key)}
                tables[f"{version}.1.connections.auth"] = {username: password}
        file = folder / "iotcore.toml"
        texts = ["id = 0"]
        for name, entries in tables.items():
            texts += [f"[{name}]", *(f"{key} = {json.dumps(value)}" for key, value in entries.items())]
        file.write_text("\n".join(texts))
        return [sys.executable, "-P", "-m", "iotcore", "--config", str(file), "--log-level", "CRITICAL"]

    def start(self) -> None:
        self.process = subprocess.Popen(self._command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        until(self._is_up, "the broker runs")

    def _is_up(self) -> bool:
        assert self.process.poll() is None, f"{self._command} ended with {self.process.returncode}"
        with suppress(OSError), self.client():
            return True
        return False

    def __enter__(self) -> Broker:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    @contextmanager
    def client(self, username: str | None = None, password: str | None = None) -> Iterator[paho.Client]:
        """A client of MQTT 5 that is connected."""
        # The tests of the lowest versions, with the same conftest.py, have none.
        import paho.mqtt.client as paho
        from paho.mqtt.enums import CallbackAPIVersion

        client = paho.Client(CallbackAPIVersion.VERSION2, protocol=paho.MQTTv5)
        if self._security is not None:
            client.username_pw_set(self._security.username, self._security.password)
            client.tls_set(str(self._security.certificate))
        elif username is not None:
            client.username_pw_set(username, password)
        client.connect("127.0.0.1", self.port)
        client.loop_start()
        try:
            until(client.is_connected, "a client is connected")
            yield client
        finally:
            client.disconnect()
            client.loop_stop()

    def publish(self, topic: str, *payloads: str, retain: bool = False, properties: Any = None) -> None:
        """Publish messages one after another; return once the broker has them."""
        with self.client() as client:
            sent = [client.publish(topic, payload, 1, retain, properties) for payload in payloads]
            until(lambda: all(message.is_published() for message in sent), "the broker has the messages")

    def retained(self, *topics: str) -> str | None:
        """The retained message of a topic, or the first one of several; None without one."""
        first: queue.SimpleQueue[str] = queue.SimpleQueue()
        with self.client() as client:

            def on_message(_: object, __: object, message: paho.MQTTMessage) -> None:
                if message.retain:
                    first.put(message.payload.decode())

            client.on_message = on_message
            client.subscribe([(topic, 1) for topic in topics])
            with suppress(queue.Empty):
                return first.get(timeout=3)
        return None

    @contextmanager
    def subscribed(self, *topics: str) -> Iterator[list[tuple[str, str]]]:
        """All messages of topics, as topic and payload; subscribed once this has been entered."""
        messages: list[tuple[str, str]] = []
        with self.client() as client:
            is_subscribed = threading.Event()
            client.on_message = lambda *received: messages.append((received[-1].topic, received[-1].payload.decode()))
            client.on_subscribe = lambda *_: is_subscribed.set()
            client.subscribe([(topic, 1) for topic in topics])
            until(is_subscribed.is_set, "the client has subscribed")
            yield messages


def payloads(messages: list[tuple[str, str]], topic: str) -> list[str]:
    """Payloads of a topic among messages of `Broker.subscribed`."""
    return [payload for name, payload in messages if name == topic]
