"""A Zenoh session as Zenostat wants it: endpoints that were named, loopback by default, no multicast.

A node listens (mode peer) and brokers between the clients that connect to it; everybody else connects
(mode client). Always `with open_session(...)`: a session that is not closed can hang the interpreter's exit.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import zenoh

from topics.errors import BusError, EndpointTaken, InvalidConfig, NothingThere

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
_CONNECT_MS = 2000
_FORM = re.compile(r"(tcp|unixsock-stream)/\S+")
_LOOPBACK = re.compile(r"tcp/(127\.\d+\.\d+\.\d+|localhost|\[::1\]):\d+")

zenoh.init_log_from_env_or("off")


_used = False
_forked = False


def _after_fork() -> None:
    global _forked
    _forked = _used


os.register_at_fork(after_in_child=_after_fork)


def check_endpoint(endpoint: str) -> str:
    """`endpoint`, or `InvalidConfig` that says what would be right."""
    if not _FORM.fullmatch(endpoint):
        raise InvalidConfig(
            f"{endpoint!r} is no endpoint; write tcp/HOST:PORT (for example {DEFAULT_ENDPOINT}) or unixsock-stream/PATH"
        )
    return endpoint


def open_session(
    *, listen: Sequence[str] = (), connect: Sequence[str] = (), wait: bool = False, expose: bool = False
) -> zenoh.Session:
    """Opens a session.

    Args:
        listen: endpoints to listen on; none for a client.
        connect: endpoints to connect to.
        wait: keep trying to connect in the background instead of failing.
        expose: allow listening beyond this machine.

    Raises:
        InvalidConfig: an endpoint of no known form, or beyond loopback without `expose`.
        EndpointTaken: another program listens there.
        NothingThere: nobody listens at any of `connect`.
        BusError: in a process forked from one that was on a bus; Zenoh's threads do not survive a fork.
    """
    global _used
    if _forked:
        raise BusError(
            "this process was forked from one that was on a bus already, which Zenoh does not survive; start it anew "
            "(multiprocessing: context 'spawn'; gym.make_vec: vector_kwargs={'context': 'spawn'})"
        )
    _used = True
    for endpoint in (*listen, *connect):
        check_endpoint(endpoint)
    for endpoint in listen:
        if endpoint.startswith("tcp/") and not _LOOPBACK.fullmatch(endpoint) and not expose:
            raise InvalidConfig(
                f"{endpoint} can be reached from other machines, without encryption or a password; "
                "ask for it with expose=True (--expose) if that is meant"
            )
    _refuse_used_socket(listen)
    try:
        return zenoh.open(_config(listen, connect, wait=wait))
    except zenoh.ZError as error:
        raise _explained(error, listen, connect) from None


def _config(listen: Sequence[str], connect: Sequence[str], *, wait: bool) -> zenoh.Config:
    settings: dict[str, Any] = {
        "mode": "peer" if listen else "client",
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        "connect/timeout_ms": -1 if wait else _CONNECT_MS,
        "connect/exit_on_failure": not wait,
        "scouting/multicast/enabled": False,
    }
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config


def _refuse_used_socket(listen: Sequence[str]) -> None:
    # Zenoh takes over the path of a unix socket that is in use; the sockets' owners would not notice.
    for endpoint in listen:
        kind, _, path = endpoint.partition("/")
        if kind == "unixsock-stream" and Path(path).exists():
            raise EndpointTaken(f"{path} exists already; name another path, or remove it if nobody listens there")


def _explained(error: zenoh.ZError, listen: Sequence[str], connect: Sequence[str]) -> BusError:
    text = str(error)
    if "Address already in use" in text or ("listener" in text and "os error 98" in text):
        return EndpointTaken(
            f"another program listens on {' or '.join(listen)}; name another port (--listen), "
            "or join the bus that is there (--connect)"
        )
    if "Unable to connect" in text or "Timeout" in text:
        return NothingThere(f"nobody listens on {' or '.join(connect)}; start a node there: zenostat node --help")
    return BusError(text.split(" at /")[0])
