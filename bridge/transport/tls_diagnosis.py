"""Diagnosis of failed TLS sessions: Zenoh only reports a timeout, so the handshake is repeated here."""

from __future__ import annotations

import socket
import ssl
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zenostat.bridge.transport.certificates import Identity

_TIMEOUT_S = 2.0


def diagnose_tls(endpoint: str, identity: Identity) -> str:
    """Return the reason why a session with `tls/HOST:PORT` failed, and a remedy."""
    host, _, port = endpoint.partition("/")[2].rpartition(":")
    host = host.strip("[]")
    context = ssl.create_default_context(cafile=str(identity.authority))
    context.load_cert_chain(identity.certificate, identity.key)
    try:
        with (
            socket.create_connection((host, int(port)), _TIMEOUT_S) as link,
            context.wrap_socket(link, server_hostname=host) as secured,
        ):
            secured.recv(1)  # with TLS 1.3, the server's verdict on this side's certificate arrives here
    except ssl.SSLCertVerificationError as error:
        return (
            f"the certificate at {endpoint} was refused: {error.verify_message}; is it a node's of the authority "
            f"{identity.authority}, and is {host!r} among its hosts (zenostat keys show)?"
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
