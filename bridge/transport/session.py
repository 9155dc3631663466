"""A Zenoh session as Zenostat wants it: endpoints that were named, loopback by default, no multicast.

A node listens (mode peer) and brokers between the clients that connect to it; everybody else connects
(mode client), a node that does not listen as well. A router (mode router) brokers for nodes and controllers.
Always `with open_session(...)`: a session that is not closed can hang the interpreter's exit.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import zenoh

from bridge.transport.access_control import ROLES, acl_config
from topics import codec
from topics.errors import AddressInUse, BusError, ErrorCollector, InvalidConfig, NodeNotFound
from topics.keys import Role

if TYPE_CHECKING:
    from bridge.transport.certificates import Identity

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
DEFAULT_TLS_ENDPOINT = "tls/127.0.0.1:7447"
MAX_MESSAGE_BYTES = 4 * codec.MAX_BYTES
"""Larger messages are dropped as they come in, by Zenoh: they would fill the memory before anybody could look."""

_CONNECT_MS = 2000
_FORM = re.compile(r"(tcp|unixsock-stream)/\S+|tls/[^\s#?;]+:\d+")
_LOOPBACK = re.compile(r"(tcp|tls)/(127\.\d+\.\d+\.\d+|localhost|\[::1\]):\d+")

zenoh.init_log_from_env_or("off")


FORKED = (
    "this process was forked from one that was on a bus already, which Zenoh does not survive; start it anew "
    "(multiprocessing: context 'spawn'; gym.make_vec: vector_kwargs={'context': 'spawn'})"
)

_used = False
_forked = False


def _after_fork() -> None:
    global _forked
    _forked = _used


os.register_at_fork(after_in_child=_after_fork)


class Mode(StrEnum):
    """A session's part in Zenoh's network."""

    PEER = "peer"
    CLIENT = "client"
    ROUTER = "router"


def check_endpoint(endpoint: str) -> str:
    """`endpoint`, or `InvalidConfig` that says what would be right."""
    if not _FORM.fullmatch(endpoint):
        raise InvalidConfig(
            f"{endpoint!r} is no endpoint; write tcp/HOST:PORT (for example {DEFAULT_ENDPOINT}), tls/HOST:PORT "
            "(with keys) or unixsock-stream/PATH"
        )
    return endpoint


def default_endpoint(keys: Path | None) -> str:
    """The endpoint of who names none: this machine's loopback, over TLS if there are keys."""
    return DEFAULT_TLS_ENDPOINT if keys else DEFAULT_ENDPOINT


def open_session(
    *,
    listen: Sequence[str] = (),
    connect: Sequence[str] = (),
    wait: bool = False,
    expose: bool = False,
    keys: Path | None = None,
    role: Role | None = None,
    certificate: str | None = None,
    mode: Mode | None = None,
) -> zenoh.Session:
    """Opens a session.

    Args:
        listen: endpoints to listen on; none for a client.
        connect: endpoints to connect to.
        wait: keep trying to connect in the background instead of failing.
        expose: allow listening beyond this machine.
        keys: a folder that `zenostat keys init` made; then every endpoint is a `tls/` one, both sides show their
            certificates, and who listens lets through what `bridge.transport.access_control` allows.
        role: whose certificate to show; needed with `keys`.
        certificate: the name of another certificate of that role, made with `zenostat keys add`.
        mode: None is a peer where it listens, else a client.

    Raises:
        InvalidConfig: an endpoint of no known form, or beyond loopback without `expose`, keys without `tls/` or the
            other way round, a certificate that is missing, expired or of another authority; all faults at once.
        AddressInUse: another program listens there.
        NodeNotFound: nobody listens at any of `connect`, or no session over TLS; the text says why.
        BusError: in a process forked from one that was on a bus; Zenoh's threads do not survive a fork.
    """
    global _used
    if _forked:
        raise BusError(FORKED)
    _used = True
    mode = mode or (Mode.PEER if listen else Mode.CLIENT)
    faults = ErrorCollector()
    _check_endpoints(listen, connect, faults, keys=keys, expose=expose)
    shown = faults.collect(lambda: _identity(keys, role, certificate, listens=bool(listen)))
    faults.raise_if_any()
    _refuse_used_socket(listen)
    settings = _settings(listen, connect, wait=wait, mode=mode) | (_closed(shown) if shown else {})
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise _explained(error, listen, connect, shown) from None


def exposure(listen: Sequence[str], keys: Path | None) -> str:
    """A warning for who listens beyond this machine without keys; else empty."""
    open_to_all = [one for one in listen if one.startswith("tcp/") and not _LOOPBACK.fullmatch(one)]
    if not open_to_all or keys is not None:
        return ""
    return (
        f"whoever reaches {', '.join(open_to_all)} can read and command everything here, unencrypted; "
        "close the door with keys: zenostat keys init"
    )


def _check_endpoints(
    listen: Sequence[str], connect: Sequence[str], faults: ErrorCollector, *, keys: Path | None, expose: bool
) -> None:
    if not listen and not connect:
        faults.errors.append(InvalidConfig("name an endpoint to listen on, or one to connect to"))
    for endpoint in (*listen, *connect):
        if faults.collect(lambda endpoint=endpoint: check_endpoint(endpoint)) is None:  # type: ignore[misc]
            continue
        kind, _, address = endpoint.partition("/")
        if keys is not None and kind != "tls":
            right = f"tls/{address}" if kind == "tcp" else DEFAULT_TLS_ENDPOINT
            faults.errors.append(InvalidConfig(f"{endpoint} takes no keys, only TLS does; write {right}, or no keys"))
        if keys is None and kind == "tls":
            faults.errors.append(
                InvalidConfig(f"{endpoint} needs keys: zenostat keys init FOLDER, then keys=FOLDER (--keys FOLDER)")
            )
    for endpoint in listen:
        if endpoint.startswith(("tcp/", "tls/")) and not _LOOPBACK.fullmatch(endpoint) and not expose:
            how = "" if endpoint.startswith("tls/") else ", without encryption or a password"
            faults.errors.append(
                InvalidConfig(
                    f"{endpoint} can be reached from other machines{how}; "
                    "ask for it with expose=True (--expose) if that is meant"
                )
            )


def _identity(keys: Path | None, role: Role | None, certificate: str | None, *, listens: bool) -> Identity | None:
    if keys is None:
        if certificate is not None:
            raise InvalidConfig(f"certificate {certificate!r} of which keys? Give their folder: keys=FOLDER (--keys)")
        return None
    if role not in ROLES:
        raise InvalidConfig(f"keys need a role: {', '.join(ROLES)}")
    if listens and role is not Role.NODE:
        raise InvalidConfig(f"a {role} does not listen; connect to a node or router, or listen as a node")
    from bridge.transport.certificates import identity  # few need it, and it takes a while

    return identity(keys, role, certificate)


def _settings(listen: Sequence[str], connect: Sequence[str], *, wait: bool, mode: Mode) -> dict[str, Any]:
    return {
        "mode": mode,
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        "connect/timeout_ms": -1 if wait else _CONNECT_MS,
        "connect/exit_on_failure": not wait,
        "scouting/multicast/enabled": False,
        "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES,
        # Each session would have a file in /dev/shm, which stays if its process is killed.
        "transport/shared_memory/enabled": False,
    }


def _closed(shown: Identity) -> dict[str, Any]:
    """Mutual TLS, and what each role may do on the links of this session."""
    return {
        "transport/link/protocols": ["tls"],
        "transport/link/tls": {
            "root_ca_certificate": str(shown.authority),
            "listen_certificate": str(shown.certificate),
            "listen_private_key": str(shown.key),
            "connect_certificate": str(shown.certificate),
            "connect_private_key": str(shown.key),
            "enable_mtls": True,
            "verify_name_on_connect": True,
            "close_link_on_expiration": True,
        },
        "access_control": acl_config(),
    }


def _refuse_used_socket(listen: Sequence[str]) -> None:
    # Zenoh takes over the path of a unix socket that is in use; the sockets' owners would not notice.
    for endpoint in listen:
        kind, _, path = endpoint.partition("/")
        if kind == "unixsock-stream" and Path(path).exists():
            raise AddressInUse(f"{path} exists already; name another path, or remove it if nobody listens there")


def _explained(error: zenoh.ZError, listen: Sequence[str], connect: Sequence[str], shown: Identity | None) -> BusError:
    text = str(error)
    if "Address already in use" in text or ("listener" in text and "os error 98" in text):
        return AddressInUse(
            f"another program listens on {' or '.join(listen)}; name another port (--listen tcp/127.0.0.1:7448), or "
            f"join the bus that is there without listening (--no-listen --connect {listen[0]})"
        )
    if "Unable to connect" in text or "Timeout" in text:
        if shown is not None:
            from bridge.transport.tls_diagnosis import diagnose_tls

            return NodeNotFound("\n".join(diagnose_tls(endpoint, shown) for endpoint in connect))
        return NodeNotFound(f"nobody listens on {' or '.join(connect)}; start a node there: zenostat node --help")
    return BusError(text.split(" at /")[0])
