"""The HTTP server of the control room."""

from __future__ import annotations

from types import TracebackType

from zenostat.bridge.client.bus import Bus
from zenostat.views.loopback import LoopbackServer, listen, names_of
from zenostat.views.room.access import Access
from zenostat.views.room.app import DEFAULTS, Room, RoomSettings

DEFAULT_ADDRESS = "127.0.0.1:8600"

_REQUEST_S = 30.0


class RoomServer:
    """A listening socket on the loopback interface, and the control room on it.

    Args:
        bus: connection to the bus; the caller closes it after this.
        address: `HOST:PORT`; port 0 chooses a free one.
        operator: name of the user of the first link, the source of this user's changes.
        api_token: token of programs that read metrics and histories; None closes these.
        settings: what pages may do besides operating nodes.

    Attributes:
        url: of the page.
        link: address that signs one browser in.

    Raises:
        InvalidConfig: a malformed address, or one that other machines can reach.
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
    ) -> None:
        bus.timeout_s = _REQUEST_S
        self._socket = listen(address, DEFAULT_ADDRESS, "the control room")
        name, hosts = names_of(self._socket)
        self.url = f"http://{name}"
        access = Access(hosts, f"zenostat-room-{name.rpartition(':')[2]}", api_token=api_token)
        self.room = Room(bus, access, self.url, settings)
        self.link = self.room.link(operator)
        self._server = LoopbackServer(self.room.asgi, self.room.updates.close)

    def run(self) -> None:
        """Serve until `stop` is called."""
        self._server.run(sockets=[self._socket])

    def stop(self) -> None:
        """End `run`; from any thread or signal handler."""
        self._server.should_exit = True

    def __enter__(self) -> RoomServer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._socket.close()
