"""Users of a control room that other machines reach: the names and roles of the bus, proven by certificates."""

from __future__ import annotations

import ssl
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from ipaddress import ip_address
from pathlib import Path
from stat import S_IRWXG, S_IRWXO
from typing import Any

from cryptography import x509

from zenostat.bridge.transport.deny_list import read_revoked
from zenostat.bridge.transport.identity import AUTHORITY, expired_on, names_of
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.keys import Role

CERTIFICATE = "certificate"
"""Key of the state of a connection: what its client's certificate states, a `ClientCertificate`."""

_READ_S = 1.0
_READERS = (Role.MONITOR, Role.CONTROLLER)


class BusUsers:
    """Roles of names by the list of names in a folder of keys, without those that are revoked.

    Args:
        folder: of keys, with `ca.pem` and `names.json`.
        clock: monotonic time in seconds.

    Raises:
        InvalidConfig: the list is missing, is damaged, or its authority has not signed it.
    """

    def __init__(self, folder: Path, clock: Callable[[], float] = time.monotonic) -> None:
        self._folder, self._clock, self._lock = folder, clock, threading.Lock()
        self._names: Mapping[str, tuple[Role, ...]] = names_of(folder)
        self._revoked = read_revoked(folder)
        self._read_s = clock()

    def role(self, name: str) -> Role | None:
        """Return what a name may do on the page: `operator` or `monitor`; None for nothing."""
        with self._lock:
            self._refresh()
            roles = () if name in self._revoked else self._names.get(name, ())
        if Role.OPERATOR in roles:
            return Role.OPERATOR
        return Role.MONITOR if any(role in roles for role in _READERS) else None

    def denial(self, name: str) -> str:
        """Return why a name may do nothing on the page."""
        with self._lock:
            is_revoked = name in self._revoked
        return (
            f"{name} is revoked"
            if is_revoked
            else f"{name} is no operator, monitor or controller in the list of names of the bus"
        )

    def _refresh(self) -> None:
        """Read both lists again, at most once a second; a damaged one is not followed."""
        if self._clock() - self._read_s < _READ_S:
            return
        self._read_s = self._clock()
        with suppress(InvalidConfig):
            self._revoked |= read_revoked(self._folder)
        with suppress(InvalidConfig):
            self._names = names_of(self._folder)


@dataclass(frozen=True)
class PageTls:
    """TLS of a control room that other machines reach.

    Attributes:
        certificate: file with the server's certificate, and those of intermediate authorities.
        key: file with its private key.
        keys: folder of keys of the bus, whose authority has issued the users' certificates.
    """

    certificate: Path
    key: Path
    keys: Path

    def hosts(self) -> tuple[str, ...]:
        """Return the names and addresses in the server's certificate, as in addresses of pages.

        Raises:
            InvalidConfig: it cannot be read, or has none.
        """
        try:
            certificate = x509.load_pem_x509_certificate(self.certificate.read_bytes())
            alternative = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        except OSError as error:
            raise InvalidConfig(f"--page-certificate {self.certificate}: {error.strerror}") from None
        except (ValueError, x509.ExtensionNotFound):
            raise InvalidConfig(
                f"--page-certificate {self.certificate}: a certificate (PEM) with the names of this machine expected"
            ) from None
        return tuple(_host(str(name.value)).lower() for name in alternative)

    def settings(self) -> dict[str, Any]:
        """Return the settings of uvicorn; a browser may present a certificate of the bus's authority.

        Raises:
            InvalidConfig: certificate and key do not belong together, cannot be read, or others may read
                the key.
        """
        try:
            if self.key.stat().st_mode & (S_IRWXG | S_IRWXO):
                raise InvalidConfig(f"{self.key} can be read by other users: chmod 600 {self.key}")
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            context.load_cert_chain(self.certificate, self.key)
        except (OSError, ssl.SSLError) as error:
            raise InvalidConfig(f"--page-certificate {self.certificate} and its key {self.key}: {error}") from None
        return {
            "ssl_certfile": str(self.certificate),
            "ssl_keyfile": str(self.key),
            "ssl_ca_certs": str(self.keys / f"{AUTHORITY}.pem"),
            "ssl_cert_reqs": ssl.CERT_OPTIONAL,
        }


def _host(name: str) -> str:
    try:
        return f"[{name}]" if ip_address(name).version == 6 else name
    except ValueError:
        return name


@dataclass(frozen=True, slots=True)
class ClientCertificate:
    """Verified certificate of a browser.

    Attributes:
        name: its common name; empty without a certificate.
        expires_s: end of its validity, in seconds since 1970.
    """

    name: str = ""
    expires_s: float = 0.0

    @property
    def valid_name(self) -> str:
        """Name until the certificate expires; a connection may last longer."""
        return "" if self.expired else self.name

    @property
    def expired(self) -> str:
        """Text that the certificate has expired; empty while it is valid, or without one."""
        if not self.name or time.time() < self.expires_s:
            return ""
        return f"the certificate of {self.name} {expired_on(datetime.fromtimestamp(self.expires_s, UTC))}"


def client_certificate(verified: Mapping[str, Any] | None) -> ClientCertificate:
    """Return what a verified certificate states, as `ssl` describes it."""
    if not verified:
        return ClientCertificate()
    fields = [field for part in verified.get("subject", ()) for field in part]
    names = [value for name, value in fields if name == "commonName"]
    return ClientCertificate(names[0] if len(names) == 1 else "", ssl.cert_time_to_seconds(verified["notAfter"]))
