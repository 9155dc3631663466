"""Diagnosis of TLS sessions that failed or ended: Zenoh reports no reason, so the handshake is repeated here."""

from __future__ import annotations

import socket
import ssl
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zenostat.bridge.transport.identity import Identity

_TIMEOUT_S = 2.0
_EXPIRED = 10
"""OpenSSL's code of the verification error X509_V_ERR_CERT_HAS_EXPIRED."""


def diagnose_tls(endpoint: str, identity: Identity) -> str:
    """Return the reason why a session with `tls/HOST:PORT` failed, and a remedy."""
    try:
        with _handshake(endpoint, identity) as secured:
            secured.recv(1)  # with TLS 1.3, the server's verdict on this side's certificate arrives here
    except ssl.SSLCertVerificationError as error:
        return (
            f"the certificate at {endpoint} was refused: {error.verify_message}; is it a node's of the authority "
            f"{identity.authority}, and is {_address(endpoint)[0]!r} among its hosts (zenostat keys show)?"
        )
    except ssl.SSLError as error:
        return (
            f"{endpoint} refused the session over TLS: {error.reason or error}; does it have keys, and of the same "
            f"authority as {identity.certificate} (zenostat keys show)?"
        )
    except TimeoutError:
        pass
    except OSError as error:
        return f"nobody listens on {endpoint} ({error.strerror or error}); start a node there: zenostat node --help"
    return f"no session over TLS with {endpoint}; is it a node or router of Zenostat, of the same authority?"


def expired_certificate(endpoint: str, identity: Identity) -> str:
    """Return whether the certificate at `tls/HOST:PORT` has expired; empty if not, or if nobody answers."""
    try:
        with _handshake(endpoint, identity):
            return ""
    except ssl.SSLCertVerificationError as error:
        if error.verify_code != _EXPIRED:
            return ""
        return f"the certificate at {endpoint} has expired: renew it, and start the node or router again"
    except OSError:
        return ""


@contextmanager
def _handshake(endpoint: str, identity: Identity) -> Iterator[ssl.SSLSocket]:
    host, port = _address(endpoint)
    context = ssl.create_default_context(cafile=str(identity.authority))
    context.load_cert_chain(identity.certificate, identity.key)
    with (
        socket.create_connection((host, port), _TIMEOUT_S) as link,
        context.wrap_socket(link, server_hostname=host) as secured,
    ):
        yield secured


def _address(endpoint: str) -> tuple[str, int]:
    host, _, port = endpoint.partition("/")[2].rpartition(":")
    return host.strip("[]"), int(port)
