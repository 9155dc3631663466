"""Access to tests: who a request is from, and whether it may change a test.

Pages of strangers in a browser on this machine may send no request: not by their own address, which the header `Origin`
shows, and not by a name of theirs that resolves to this machine, which `Host` shows.

A client proves its name with a token (`Authorization: Bearer …`). Its tests are its own: others read them, if they know
the id, and do not change them. Of the inputs, it may override those that its name permits.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

from starlette.datastructures import Headers

from zenostat.gateways.boptest.extensions import ExtendedTest
from zenostat.gateways.boptest.operations import Operation
from zenostat.gateways.clients import Clients
from zenostat.gateways.notices import Notices
from zenostat.topics.addresses import is_loopback
from zenostat.topics.errors import AccessDenied, UsageError

_SCHEME = "bearer "
_PORT = re.compile(r":\d*$")


class UnknownToken(UsageError):
    """A token that is no client's."""


def check_sender(headers: Headers, *, is_local: bool) -> None:
    """Raise `AccessDenied` for a request that a page of another site may have sent.

    Args:
        headers: of the request.
        is_local: whether the service is on loopback, so that `Host` names that.
    """
    hosts = headers.getlist("host")
    if is_local and not all(is_loopback(_PORT.sub("", host.lower())) for host in hosts):
        raise AccessDenied(f"this service is on this machine and none of the name {hosts[0][:80]!r}")
    for origin in headers.getlist("origin"):
        if origin.partition("://")[2] not in hosts:
            raise AccessDenied(f"a page of {origin[:80]!r} may send no requests here")


class TestAccess:
    """Permissions of requests.

    Args:
        clients: names of clients, and what they may write.
        notify: called with a line for the operator about each denied request, once.
    """

    __test__ = False  # for pytest, which takes it for a test

    def __init__(self, clients: Clients, notify: Callable[[str], None]) -> None:
        self._clients, self._notices = clients, Notices(notify)

    def client(self, headers: Mapping[str, str]) -> str:
        """Return the name of the client that sent a request; empty without a token.

        Raises:
            UnknownToken: no client has the token.
        """
        if not self._clients.is_restricted:
            return ""
        header = headers.get("authorization", "")
        if not header:
            return ""
        token = header[len(_SCHEME) :].strip() if header.lower().startswith(_SCHEME) else ""
        name = self._clients.of_boptest(token)
        if not name:
            self._notices.add("a request with an unknown token was denied")
            raise UnknownToken("no client has this token; send `Authorization: Bearer TOKEN`")
        return name

    def check_start(self, client: str) -> None:
        """Raise `AccessDenied` unless a client may start tests: one with a name, or where all may write."""
        if not client and not self._clients.may_write(""):
            self._deny("a client without a token may only read here; send `Authorization: Bearer TOKEN`")

    def check_change(self, client: str, owner: str) -> None:
        """Raise `AccessDenied` unless a client may change a test, which `owner` has started."""
        self.check_start(client)
        if owner not in ("", client):
            self._deny(f"{client or 'a client without a token'} may not change a test of {owner}")

    def check_operation(self, client: str, operation: Operation, test: ExtendedTest, fields: Mapping[str, Any]) -> None:
        """Raise `AccessDenied` unless a client may carry out an operation on a test."""
        if not self._clients.is_restricted or operation.is_reading:
            return
        self.check_change(client, test.client)
        if operation.path == "/advance":
            try:
                self._clients.check(client, test.overridden(fields))
            except AccessDenied as error:
                self._deny(str(error))

    def _deny(self, text: str) -> None:
        self._notices.add(f"a request was denied: {text}")
        raise AccessDenied(text)
