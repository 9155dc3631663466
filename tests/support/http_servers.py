"""HTTP servers in this process."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zenostat.bridge.http.server import HttpServer


@contextmanager
def running(server: HttpServer) -> Iterator[None]:
    """Run a server in a thread, and stop it in the end."""
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        yield
    finally:
        server.stop()
        thread.join()
