"""Hosts and ports in texts, and which hosts are this machine alone."""

from __future__ import annotations

import ipaddress
import re

_FORM = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[^\s:/\[\]]+)(?::(\d{1,5}))?")


def split_address(text: str, default_port: int) -> tuple[str, int] | None:
    """Return host, without brackets, and port of `HOST` or `HOST:PORT`; None if the text has another form.

    An IPv6 address is in brackets.
    """
    match = _FORM.fullmatch(text)
    port = int(match[2] or default_port) if match else 0
    return (match[1].strip("[]"), port) if match and port <= 65535 else None


def join_address(host: str, port: int) -> str:
    """Return `HOST:PORT`, with brackets around an IPv6 address."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def is_loopback(host: str) -> bool:
    """Return whether a host is this machine alone: a loopback address, also in brackets, or `localhost`."""
    try:
        return ipaddress.ip_address(host.strip("[]").partition("%")[0]).is_loopback
    except ValueError:
        return host == "localhost"
