"""Zenoh sessions with Zenostat's settings: explicit endpoints, loopback by default, no multicast.

A node listens (mode peer) and routes messages between the clients that connect to it. All other programs connect (mode
client), as does a node that does not listen. A router (mode router) routes messages for nodes and controllers.
"""

from __future__ import annotations

import json
import os
import re
import socket
import warnings
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, suppress
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import zenoh

from zenostat.bridge.runtime.exhaustion import describe_exhaustion
from zenostat.bridge.transport.access_control import acl_config
from zenostat.topics import codec
from zenostat.topics.addresses import is_loopback
from zenostat.topics.errors import AddressInUse, BusError, ErrorCollector, InvalidConfig, NodeNotFound
from zenostat.topics.keys import DEFAULT_HOST, DEFAULT_PORT, Role

if TYPE_CHECKING:
    from zenostat.bridge.runtime.timer import Timer
    from zenostat.bridge.transport.identity import Identity

DEFAULT_ENDPOINT = f"tcp/{DEFAULT_HOST}:{DEFAULT_PORT}"
DEFAULT_TLS_ENDPOINT = f"tls/{DEFAULT_HOST}:{DEFAULT_PORT}"
MAX_MESSAGE_BYTES = 4 * codec.MAX_BYTES
"""Largest message that Zenoh receives; it drops larger ones, which would fill the memory before they are checked."""

_CONNECT_MS = 2000
_FORM = re.compile(r"unixsock-stream/\S+|tcp/\S+:(\d+)(?:[#?;]\S*)?|tls/[^\s#?;]+:(\d+)")
_PLAIN = re.compile(r"(?:tcp|tls)/([^/#?;]+):\d+")

zenoh.init_log_from_env_or("off")


FORKED = (
    "this process was forked from one with a Zenoh session, which does not work after a fork; spawn it instead "
    "(multiprocessing: context 'spawn'; gym.make_vec: vector_kwargs={'context': 'spawn'})"
)

_used = False
_forked = False


def _after_fork() -> None:
    global _forked
    _forked = _used


os.register_at_fork(after_in_child=_after_fork)


class Mode(StrEnum):
    """Mode of a Zenoh session."""

    PEER = "peer"
    CLIENT = "client"
    ROUTER = "router"


def check_endpoint(endpoint: str) -> str:
    """Return a valid endpoint.

    Raises:
        InvalidConfig: it is not an endpoint.
    """
    match = _FORM.fullmatch(endpoint) if isinstance(endpoint, str) else None
    if match is None or any(port and int(port) > 65535 for port in match.groups()):
        raise InvalidConfig(
            f"{endpoint!r} is not an endpoint; write tcp/HOST:PORT (for example {DEFAULT_ENDPOINT}), tls/HOST:PORT "
            "(with keys) or unixsock-stream/PATH"
        )
    return endpoint


def default_endpoint(keys: Path | None) -> str:
    """Return the default endpoint: this machine's loopback, over TLS if there are keys."""
    return DEFAULT_TLS_ENDPOINT if keys else DEFAULT_ENDPOINT


class OpenSession(AbstractContextManager[zenoh.Session]):
    """An open session, to be entered: one that is not closed can block the interpreter's exit.

    Zenoh gives up closing a session after 10 s if the other side is frozen; it then ends with its process.

    Attributes:
        name: the name in the certificate that it presents; empty without keys.
        roles: the roles of that certificate; none without keys.
    """

    def __init__(self, session: zenoh.Session, identity: Identity | None = None) -> None:
        self._session, self._identity = session, identity
        self.name = identity.name if identity else ""
        self.roles = identity.roles if identity else ()

    def watch_expiry(self, timer: Timer, warn: Callable[[str], None]) -> None:
        """Call a function in the timer's thread with a warning before its certificate expires, and when it does."""
        if self._identity is not None:
            from zenostat.bridge.transport.expiry_watch import ExpiryWatch  # only for what runs for long with keys

            ExpiryWatch(self._identity, timer, warn)

    def expired(self, endpoint: str = "") -> str:
        """Return whether its own certificate has expired, or that at an endpoint; empty if not, or without keys."""
        if self._identity is None or self._identity.expired or not endpoint:
            return self._identity.expired if self._identity else ""
        from zenostat.bridge.transport.tls_diagnosis import expired_certificate  # rarely needed

        return expired_certificate(endpoint, self._identity)

    def why_gone(self, endpoint: str = "") -> str:
        """Return the end of a sentence on a node that is gone: how its own certificate may be the reason.

        Args:
            endpoint: whose certificate is looked at as well, over the network; empty: none.

        Returns:
            ": " and that a certificate has expired, or ", or " and that its name may be revoked; empty without keys.
        """
        if self._identity is None:
            return ""
        expired = self.expired(endpoint)
        return f": {expired}" if expired else f", or {self.name} is revoked or not in the list of names"

    def names(self) -> dict[str, tuple[Role, ...]]:
        """Return the roles of each name of the authority, which a node or router reads; none without keys.

        Raises:
            InvalidConfig: the list of names cannot be used.
        """
        return self._identity.names() if self._identity else {}

    def __enter__(self) -> zenoh.Session:
        return self._session

    def __exit__(self, *_: object) -> None:
        with suppress(zenoh.ZError):
            self._session.close()  # type: ignore[no-untyped-call]


def open_session(
    *,
    listen: Sequence[str] = (),
    connect: Sequence[str] = (),
    wait: bool = False,
    expose: bool = False,
    keys: Path | None = None,
    role: Role | Sequence[Role] | None = None,
    certificate: str | None = None,
    mode: Mode | None = None,
    warn: Callable[[str], object] | None = None,
) -> OpenSession:
    """Open a session, to be entered with `with`.

    Args:
        listen: endpoints to listen on; none for a client.
        connect: endpoints to connect to.
        wait: keep trying to connect in the background instead of failing.
        expose: allow listening on addresses that other machines can reach.
        keys: a folder created by `zenostat keys init`, or a certificate in it (`FOLDER/NAME.pem`). All endpoints must
            then be `tls/` ones, both sides present their certificates, and the listening side applies the rules of
            `zenostat.bridge.transport.access_control`.
        role: the role that the certificate to present must have, or several; required with `keys`, except with
            `certificate`.
        certificate: name of the certificate, created by `zenostat keys add`; None is that of the role, of several roles
            `trainer`.
        mode: by default peer if the session listens, otherwise client.
        warn: called with the date on which the certificate expires, if that is soon; None is `warnings.warn`.

    Raises:
        InvalidConfig: an invalid endpoint, one beyond loopback without `expose`, keys without `tls/` or the reverse, a
            certificate that is missing, expired or of another authority or role; the text lists all errors.
        AddressInUse: another program listens there.
        NodeNotFound: no program listens at any of `connect`, or the TLS handshake failed; the text has the reason.
        BusError: this process was forked from one with a session (Zenoh's threads do not survive a fork), or the
            system has no threads left.
    """
    global _used
    if _forked:
        raise BusError(FORKED)
    _used = True
    mode = mode or (Mode.PEER if listen else Mode.CLIENT)
    errors = ErrorCollector()
    _check_endpoints(listen, connect, errors, keys=keys, expose=expose)
    identity = errors.collect(lambda: _identity(keys, role, certificate, listens=bool(listen)))
    errors.raise_if_any()
    _check_socket_paths(listen)
    settings = _settings(listen, connect, wait=wait, mode=mode)
    if identity is not None:
        settings |= _tls_settings(identity)
        if listen:
            settings["access_control"] = acl_config(_listed(identity))
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    try:
        session = OpenSession(zenoh.open(config), identity)
    except zenoh.ZError as error:
        raise _bus_error(error, listen, connect, identity) from None
    except BaseException as error:  # a panic in Zenoh is no `Exception`
        if (text := describe_exhaustion(error)) is None:
            raise
        raise BusError(text) from None
    if identity is not None and identity.warning:
        (warn or partial(warnings.warn, stacklevel=2))(identity.warning)
    return session


def names_certificate(keys: Path | None, certificate: str | None) -> bool:
    """Return whether a certificate is named, so that no role needs to be."""
    return certificate is not None or (keys is not None and keys.suffix == ".pem")


def keys_folder(keys: Path | None) -> Path | None:
    """Return the folder of keys, also where a certificate in it is named."""
    return keys.parent if keys is not None and keys.suffix == ".pem" else keys


def exposure(listen: Sequence[str], keys: Path | None) -> str:
    """Return a warning if other machines can reach an endpoint without keys; otherwise an empty text."""
    exposed = [endpoint for endpoint in listen if endpoint.startswith("tcp/") and not _is_local(endpoint)]
    if not exposed or keys is not None:
        return ""
    return (
        f"any program that can reach {', '.join(exposed)} can read and command everything, unencrypted; "
        "secure the bus with keys: zenostat keys init"
    )


def _is_local(endpoint: str) -> bool:
    """Return whether no other machine reaches a TCP or TLS endpoint; one with options is assumed to be reachable."""
    match = _PLAIN.fullmatch(endpoint)
    return match is not None and is_loopback(match[1])


def _check_endpoints(
    listen: Sequence[str], connect: Sequence[str], errors: ErrorCollector, *, keys: Path | None, expose: bool
) -> None:
    if not listen and not connect:
        errors.errors.append(InvalidConfig("name an endpoint to listen on, or one to connect to"))
    for endpoint in (*listen, *connect):
        if errors.collect(lambda endpoint=endpoint: check_endpoint(endpoint)) is None:  # type: ignore[misc]
            continue
        kind, _, address = endpoint.partition("/")
        if keys is not None and kind != "tls":
            expected = f"tls/{address}" if kind == "tcp" else DEFAULT_TLS_ENDPOINT
            errors.errors.append(
                InvalidConfig(f"{endpoint} takes no keys, only TLS does; write {expected}, or no keys")
            )
        if keys is None and kind == "tls":
            errors.errors.append(
                InvalidConfig(f"{endpoint} needs keys: zenostat keys init FOLDER, then keys=FOLDER (--keys FOLDER)")
            )
    for endpoint in listen:
        if endpoint.startswith(("tcp/", "tls/")) and not _is_local(endpoint) and not expose:
            protection = "" if endpoint.startswith("tls/") else ", without encryption or a password"
            errors.errors.append(
                InvalidConfig(
                    f"{endpoint} can be reached from other machines{protection}; "
                    "if that is intended, allow it with expose=True (--expose)"
                )
            )


def _identity(
    keys: Path | None, role: Role | Sequence[Role] | None, certificate: str | None, *, listens: bool
) -> Identity | None:
    if keys is None:
        if certificate is not None:
            raise InvalidConfig(f"certificate {certificate!r} needs the folder of its keys: keys=FOLDER (--keys)")
        return None
    if role is Role.ANYONE or (not role and not names_certificate(keys, certificate)):
        raise InvalidConfig(f"keys need a role: {', '.join(role for role in Role if role is not Role.ANYONE)}")
    if listens and role is not Role.NODE:
        raise InvalidConfig(
            f"a {role or 'certificate of any role'} does not listen; connect to a node or router, or listen as a node"
        )
    from zenostat.bridge.transport.identity import identity  # slow to import, and rarely needed

    if keys.suffix == ".pem":
        keys, certificate = keys.parent, keys.stem
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
        # Each session would create a file in /dev/shm, which remains if its process is killed.
        "transport/shared_memory/enabled": False,
    }


def _listed(identity: Identity) -> dict[str, tuple[Role, ...]]:
    """Return the names with their roles, without those that are revoked."""
    from zenostat.bridge.transport.deny_list import read_revoked  # only for what listens

    revoked = read_revoked(identity.authority.parent)
    return {name: roles for name, roles in identity.names().items() if name not in revoked}


def _tls_settings(identity: Identity) -> dict[str, Any]:
    """Settings for mutual TLS."""
    return {
        "transport/link/protocols": ["tls"],
        "transport/link/tls": {
            "root_ca_certificate": str(identity.authority),
            "listen_certificate": str(identity.certificate),
            "listen_private_key": str(identity.key),
            "connect_certificate": str(identity.certificate),
            "connect_private_key": str(identity.key),
            "enable_mtls": True,
            "verify_name_on_connect": True,
            "close_link_on_expiration": True,
        },
    }


def _check_socket_paths(listen: Sequence[str]) -> None:
    # Zenoh takes over the path of a unix socket that is in use, without an error for its owner.
    for endpoint in listen:
        kind, _, path = endpoint.partition("/")
        if kind == "unixsock-stream" and Path(path).exists():
            raise AddressInUse(f"{path} already exists; name another path, or remove it if no program listens there")


def _bus_error(
    error: zenoh.ZError, listen: Sequence[str], connect: Sequence[str], identity: Identity | None
) -> BusError:
    text = str(error)
    if "Address already in use" in text or ("listener" in text and "os error 98" in text):
        return AddressInUse(
            f"another program listens on {' or '.join(listen)}; name another port (--listen tcp/127.0.0.1:7448), or "
            f"join the existing bus without listening (--no-listen --connect {listen[0]})"
        )
    if "Unable to connect" in text or "Timeout" in text:
        if identity is not None:
            from zenostat.bridge.transport.tls_diagnosis import diagnose_tls

            return NodeNotFound("\n".join(diagnose_tls(endpoint, identity) for endpoint in connect))
        failures = {endpoint: _connect_error(endpoint) for endpoint in connect}
        if answerless := [endpoint for endpoint, failure in failures.items() if failure is None]:
            return NodeNotFound(
                f"a program listens on {' and '.join(answerless)}, but does not answer: it is suspended, needs "
                "--keys, or is no node or router of Zenostat"
            )
        if unreachable := [f"{endpoint} ({failure})" for endpoint, failure in failures.items() if failure]:
            return NodeNotFound(f"no connection to {' or '.join(unreachable)}; check the address and the network")
        return NodeNotFound(f"nobody listens on {' or '.join(connect)}; start a node there: zenostat node --help")
    return BusError(text.split(" at /")[0])


def _connect_error(endpoint: str) -> str | None:
    """Return why no program accepts a connection at an endpoint; empty if nobody listens there, None if one does."""
    protocol, _, address = endpoint.partition("/")
    try:
        if protocol == "unixsock-stream":
            with socket.socket(socket.AF_UNIX) as link:
                link.settimeout(_CONNECT_MS / 1000)
                link.connect(address)
        else:
            host, _, port = address.rpartition(":")
            socket.create_connection((host.strip("[]"), int(port)), _CONNECT_MS / 1000).close()
    except (ConnectionRefusedError, FileNotFoundError, ValueError):
        return ""
    except OSError as error:
        return error.strerror or str(error)
    return None
