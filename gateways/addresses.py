"""Addresses on which gateways listen: loopback, unless others are allowed."""

from __future__ import annotations

import ipaddress
import socket

from zenostat.topics.addresses import is_loopback, split_address
from zenostat.topics.errors import InvalidConfig


def parse_address(text: str, protocol: str, *, expose: bool, default_port: int) -> tuple[str, int]:
    """Return host and port of `HOST` or `HOST:PORT`.

    Args:
        text: an IPv4 address, an IPv6 address (in brackets before a port) or `localhost`.
        protocol: name of the protocol, for errors.
        expose: allow addresses that other machines can reach.
        default_port: port where the text has none.

    Raises:
        InvalidConfig: not an address, or other machines can reach it and `expose` is false.
    """
    host, port = split_address(text, default_port) or (text.strip("[]"), default_port)
    try:
        address = ipaddress.ip_address("127.0.0.1" if host == "localhost" else host)
    except ValueError:
        address = None
    if address is None or "%" in host:
        raise InvalidConfig(
            f"{text!r} is not an address to listen on; write ADDRESS:PORT, for example 127.0.0.1:{default_port}"
        )
    if not address.is_loopback and not expose:
        raise InvalidConfig(
            f"{text} can be reached from other machines, and {protocol} has neither encryption nor a password here; "
            "if that is intended, allow it with --expose"
        )
    return str(address), port


def keep_alive(connection: socket.socket, *, idle_s: int, interval_s: int, probes: int) -> None:
    """Let a connection fail once its other end is gone without having closed it.

    Args:
        connection: a TCP connection.
        idle_s: time without data before the first probe, in s.
        interval_s: time between probes, in s.
        probes: number of probes without an answer.
    """
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, idle_s)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, interval_s)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, probes)


def names_of(host: str, port: int) -> list[str]:
    """Return `ADDRESS:PORT` for each address of a host, whatever its spelling; for this machine, with its name."""
    if is_loopback(host):
        return [f"{socket.gethostname()}:{port}"]
    try:
        entries = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except OSError:  # not known yet
        return [f"{host}:{port}"]
    return sorted({f"{target[0]}:{port}" for *_, target in entries})
