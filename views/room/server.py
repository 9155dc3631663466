"""The HTTP server of the control room."""

from __future__ import annotations

import asyncio

from zenostat.bridge.client.bus import Bus
from zenostat.bridge.http.connections import BoundedH11
from zenostat.bridge.http.server import HttpServer, LoopbackServer, host_and_port, listen
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.keys import Role
from zenostat.views.room.access import Access
from zenostat.views.room.app import DEFAULTS, Room, RoomSettings
from zenostat.views.room.users import CERTIFICATE, BusUsers, PageTls, client_certificate

DEFAULT_ADDRESS = "127.0.0.1:8600"

_REQUEST_S = 30.0
_REMEDY = "over a network it needs --expose with --keys and --page-certificate"
_HTTPS_PORT = 443
_LOOPBACK = ("localhost", "127.0.0.1", "[::1]")


class RoomServer(HttpServer):
    """A listening socket, and the control room on it: on the loopback interface, or over a network with TLS.

    Args:
        bus: connection to the bus; the caller closes it after this, and the end of this while requests wait for nodes.
        address: `HOST:PORT`; port 0 chooses a free one.
        operator: name of the user of the first link, the source of this user's changes.
        api_token: token of programs that read metrics and histories; None closes these.
        settings: what pages may do besides operating nodes.
        tls: certificate of the page, and keys of its users; None for plain HTTP on the loopback interface.
        is_exposed: whether other machines may reach the address, which needs `tls`.

    Attributes:
        url: of the page.
        link: address that signs one browser in.

    Raises:
        InvalidConfig: a malformed address, or one that other machines can reach without TLS; certificate, key or list
            of names cannot be used; with `tls`, `operator` is no operator of the bus.
        AddressInUse: another program listens there.
    """

    def __init__(
        self,
        bus: Bus,
        address: str,
        *,
        operator: str,
        api_token: str | None = None,
        settings: RoomSettings = DEFAULTS,
        tls: PageTls | None = None,
        is_exposed: bool = False,
    ) -> None:
        bus.timeout_s = _REQUEST_S
        users = None if tls is None else BusUsers(tls.keys)
        tls_settings = {} if tls is None else {**tls.settings(), "http": _TlsProtocol}
        names = None if tls is None else tls.hosts()
        listening = listen(
            address, DEFAULT_ADDRESS, "the control room", is_exposed=is_exposed and tls is not None, remedy=_REMEDY
        )
        host, port = host_and_port(listening)
        names = (host, "localhost") if names is None else names
        scheme = "http" if tls is None else "https"
        host = next((name for name in names if name not in _LOOPBACK), names[0])
        url = f"{scheme}://{host}:{port}"
        hosts = frozenset(f"{name}:{port}" for name in names) | (frozenset(names) if port == _HTTPS_PORT else set())
        cookie = f"{'' if tls is None else '__Host-'}zenostat-room-{port}"
        access = Access(hosts, cookie, api_token=api_token, scheme=scheme, users=users)
        try:
            if access.role(operator) is not Role.OPERATOR:
                raise InvalidConfig(
                    f"--operator {operator!r} is no operator of the bus; create a certificate with: "
                    f"zenostat keys add {operator} --role operator"
                )
            self.room = Room(bus, access, url, settings)
        except BaseException:
            listening.close()
            raise
        self.link = self.room.link(operator)
        super().__init__(listening, url, LoopbackServer(self.room.asgi, self.room.end, **tls_settings))


class _TlsProtocol(BoundedH11):
    """HTTP over TLS: each request has the certificate of its connection in its state."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        tls = transport.get_extra_info("ssl_object")
        self.app_state = {**self.app_state, CERTIFICATE: client_certificate(tls.getpeercert())}
