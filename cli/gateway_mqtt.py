"""`zenostat gateway mqtt`: a node on an MQTT broker."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from zenostat.cli.gateway import serve
from zenostat.cli.gateway_clients import Allow, ClientsFile, clients_of, notify
from zenostat.cli.options import DEFAULTS, BusOptions, Node, Wait, on_bus
from zenostat.gateways.addresses import names_of
from zenostat.topics.addresses import is_loopback, split_address
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.extras import requires_extra
from zenostat.topics.user_file import user_file


@on_bus
def mqtt(
    node: Node,
    broker: Annotated[str, typer.Option(help="HOST:PORT of the broker; port 1883, with --tls 8883, by default.")] = (
        "127.0.0.1:1883"
    ),
    topic: Annotated[
        str | None, typer.Option(help="Topic below which all topics of the node are. [default: zenostat/NODE]")
    ] = None,
    priority: Annotated[
        int, typer.Option(min=1, max=16, metavar="1-16", help="Priority of commands that name none; 1 is the highest.")
    ] = 8,
    source: Annotated[str, typer.Option(help="Name of the writer of commands that name none.")] = "mqtt",
    home_assistant: Annotated[
        bool, typer.Option("--home-assistant", help="Publish discovery messages of Home Assistant.")
    ] = False,
    discovery_prefix: Annotated[str, typer.Option(help="Home Assistant's discovery prefix.")] = "homeassistant",
    username: Annotated[str | None, typer.Option(help="User name for the broker.")] = None,
    password_file: Annotated[
        Path | None, typer.Option(help="File with the password; or the variable MQTT_PASSWORD.")
    ] = None,
    tls: Annotated[bool, typer.Option("--tls", help="Encrypt the connection to the broker.")] = False,
    ca: Annotated[Path | None, typer.Option(help="CA certificate of the broker (PEM). Default: the system's.")] = None,
    broker_certificate: Annotated[Path | None, typer.Option(help="Certificate to present to the broker (PEM).")] = None,
    broker_key: Annotated[Path | None, typer.Option(help="Private key of --broker-certificate (PEM).")] = None,
    mqtt_version: Annotated[str, typer.Option(metavar="5|3.1.1", help="Version of the protocol.")] = "5",
    clients: ClientsFile = None,
    allow: Allow = None,
    options: BusOptions = DEFAULTS,
    wait: Wait = False,
    expose: Annotated[bool, typer.Option("--expose", help="Allow a broker on another machine without --tls.")] = False,
) -> None:
    """Run an MQTT gateway of a node until Ctrl-C. With keys, it uses the gateway role.

    Example: `zenostat gateway mqtt office --broker 127.0.0.1:1883 --home-assistant`
    """
    with requires_extra("mqtt", "the MQTT gateway", "aiomqtt"):
        import aiomqtt
    from zenostat.gateways.mqtt.broker import Broker
    from zenostat.gateways.mqtt.gateway import MqttGateway
    from zenostat.gateways.mqtt.topic_names import PREFIX, check_root

    versions = {"5": 5, "3.1.1": 3}
    if mqtt_version not in versions:
        raise InvalidConfig(f"--mqtt-version {mqtt_version}: expected 5 or 3.1.1")
    host, port = _address(broker, default_port=8883 if tls else 1883)
    if not (tls or expose or is_loopback(host)):
        raise InvalidConfig(
            f"--broker {broker}: the connection to another machine would not be encrypted; use --tls, or allow it with "
            "--expose"
        )
    files = {"--ca": ca, "--broker-certificate": broker_certificate, "--broker-key": broker_key}
    for option, file in files.items():
        if file is not None and not tls:
            raise InvalidConfig(f"{option} needs --tls")
        if file is not None and not file.is_file():
            raise InvalidConfig(f"{option} {file}: no such file")
    if broker_key is not None and broker_certificate is None:
        raise InvalidConfig("--broker-key needs --broker-certificate")
    ca_file, certificate_file, key_file = (str(file) if file is not None else None for file in files.values())
    parameters = aiomqtt.TLSParameters(ca_certs=ca_file, certfile=certificate_file, keyfile=key_file) if tls else None
    at = Broker(host, port, username, _password(username, password_file), parameters, versions[mqtt_version])
    root = check_root(f"{PREFIX}/{node}" if topic is None else topic)
    prefix = check_root(discovery_prefix) if home_assistant else None
    known = clients_of(clients, allow, is_exposed=not is_loopback(host), name_themselves=True)
    serve(
        node,
        lambda client: MqttGateway(
            client, at, root=root, priority=priority, clients=known, home_assistant=prefix, notify=notify,
        ),
        source=source, via="mqtt", options=options, wait=wait,
        exclusive={f"{root} on {name}": "choose another topic with --topic" for name in names_of(host, port)},
    )  # fmt: skip


def _address(text: str, default_port: int) -> tuple[str, int]:
    address = split_address(text, default_port)
    if address is None or address[1] == 0:
        raise InvalidConfig(f"--broker {text}: expected HOST:PORT, for example 127.0.0.1:{default_port}")
    return address


def _password(username: str | None, file: Path | None) -> str | None:
    if file is None:
        source, password = "MQTT_PASSWORD", os.environ.get("MQTT_PASSWORD")
    else:
        source = f"--password-file {file}"
        with user_file(file):
            password = file.read_text(encoding="utf-8-sig").rstrip("\r\n")
    if password is not None and username is None:
        raise InvalidConfig(f"{source} needs --username")
    if password == "" and file is not None:
        raise InvalidConfig(f"{source}: the file is empty; a password expected")
    return password
