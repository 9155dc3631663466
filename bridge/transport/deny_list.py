"""The deny list of a node or router: the names that are revoked, in a file in its folder of keys.

Zenoh reads certificates and access rules once, so a node looks at the list itself, at most once a second. It ends the
links of revoked names, also those that they open again.
"""

from __future__ import annotations

import ipaddress
import os
import socket
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from time import monotonic

import psutil
import zenoh
from zenoh.handlers import Callback

from zenostat.bridge.runtime.timer import Timer
from zenostat.bridge.transport.name_list import LOCK_S, locked_names
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.keys import is_name

REVOKED = "revoked.txt"
"""Name of the file in a folder of keys: a name on each line; what follows `#` is a comment."""

CHECK_S = 1.0
"""Interval of the checks of the file."""

_NODE_LOCK_S = 1.0
"""Longest time that a node waits for another program that changes names: it simulates nothing meanwhile."""


def read_revoked(folder: Path) -> frozenset[str]:
    """Return the revoked names; none without a file.

    Raises:
        InvalidConfig: a line is not a name, or the file cannot be read.
    """
    path = folder / REVOKED
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except FileNotFoundError:
        return frozenset()
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidConfig(f"cannot read {path}: {error}") from None
    names = [line.partition("#")[0].strip() for line in lines]
    for number, name in enumerate(names, 1):
        if name and not is_name(name):
            raise InvalidConfig(f"{path}, line {number}: {name!r} is not a name; write a certificate's name on a line")
    return frozenset(filter(None, names))


def revoke(folder: Path, name: str, *, wait_s: float = LOCK_S) -> None:
    """Add a name to the file, after at most `wait_s` in which another program changes names.

    Raises:
        InvalidConfig: the file is damaged, or cannot be written.
    """
    with locked_names(folder, wait_s=wait_s):
        names = read_revoked(folder) | {name}
        content = "".join(f"{entry}\n" for entry in ("# names whose certificates are revoked", *sorted(names)))
        try:
            with atomic_file(folder / REVOKED) as temporary:
                temporary.write_text(content, encoding="utf-8")
                temporary.chmod(0o644)  # the node may be another user's
        except OSError as error:
            raise InvalidConfig(f"cannot write {folder / REVOKED}: {error.strerror}") from None


class DenyList:
    """The revoked names of a running node or router, and the links of its session that it ends.

    Args:
        folder: of the keys.
        session: whose links are ended.
        timer: of the checks.
        on_change: called with the names that are revoked now and were not before, in the timer's thread.
        on_error: called with the reason if the file cannot be read, or lacks names; those stay revoked.

    Raises:
        InvalidConfig: the file is damaged.

    Attributes:
        names: the revoked names.
    """

    def __init__(
        self,
        folder: Path,
        session: zenoh.Session,
        timer: Timer,
        on_change: Callable[[frozenset[str]], None],
        on_error: Callable[[str], None],
    ) -> None:
        self._folder, self._session, self._timer = folder, session, timer
        self._on_change, self._on_error = on_change, on_error
        self._version = self._file_version()
        self.names = read_revoked(folder)
        self._listener: zenoh.LinkEventsListener[None] | None = session.info.declare_link_events_listener(
            Callback(self._on_link, indirect=False), history=True
        )
        self._timer.at(monotonic() + CHECK_S, self._check)

    def close(self) -> None:
        """Watch no further links; idempotent. The checks end with the timer."""
        listener, self._listener = self._listener, None
        if listener is not None:
            listener.undeclare()  # type: ignore[no-untyped-call]

    def add(self, name: str) -> None:
        """Revoke a name at once, and write it to the file.

        Raises:
            InvalidConfig: the file is damaged, or cannot be written; the name is revoked until the process ends.
        """
        self._set(frozenset({name}))
        revoke(self._folder, name, wait_s=_NODE_LOCK_S)
        self._version = self._file_version()

    def _file_version(self) -> tuple[int, ...]:
        try:
            status = (self._folder / REVOKED).stat()
        except OSError:
            return ()
        return status.st_mtime_ns, status.st_size, status.st_ino

    def _check(self) -> None:
        self._timer.at(monotonic() + CHECK_S, self._check)
        version = self._file_version()
        if version == self._version:
            return
        self._version = version
        try:
            names = read_revoked(self._folder)
        except InvalidConfig as error:
            self._on_error(str(error))
            return
        if removed := self.names - names:
            self._on_error(f"{self._folder / REVOKED} no longer has {', '.join(sorted(removed))}")
        self._set(names)

    def _set(self, names: frozenset[str]) -> None:
        """Revoke names as well; a name is accepted again by a new start alone."""
        added, self.names = names - self.names, names | self.names
        if added:
            self._end_links(self._session.info.links())
            self._on_change(added)

    def _on_link(self, event: zenoh.LinkEvent) -> None:
        if event.kind == zenoh.SampleKind.PUT:
            self._end_links([event.link])

    def _end_links(self, links: Iterable[zenoh.Link]) -> None:
        shut_down([link for link in links if link.auth_identifier in self.names])


def shut_down(links: Iterable[zenoh.Link]) -> None:
    """End links of this process: Zenoh has no call for that, so their sockets are shut down."""
    peers = {_locator_peer(str(link.dst)) for link in links}
    for connection in psutil.Process().net_connections("tcp") if peers else ():
        if connection.raddr and connection.fd >= 0 and _peer(*connection.raddr) in peers:
            with suppress(OSError), socket.socket(fileno=os.dup(connection.fd)) as link:
                link.shutdown(socket.SHUT_RDWR)


def _locator_peer(locator: str) -> tuple[str, int]:
    """Return the address in a locator of a link, `tls/IP:PORT`."""
    host, _, port = locator.partition("/")[2].partition("?")[0].rpartition(":")
    return _peer(host, port)


def _peer(host: str, port: str | int) -> tuple[str, int]:
    """Return an address in one form: of IPv4, also where it is mapped to IPv6, and without brackets and zone."""
    address = ipaddress.ip_address(host.strip("[]").partition("%")[0])
    return str(getattr(address, "ipv4_mapped", None) or address), int(port)
