"""A TCP link between two programs that a test can cut."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Any


class CuttableLink:
    """Forwards connections to a TCP port of the loopback; `cut` ends those that are open, `down` refuses new ones.

    Args:
        port: of the program that listens.

    Attributes:
        endpoint: where others connect.
        forwarded: the first bytes that it has forwarded, up to 1 MB, in the order in which they came.
    """

    def __init__(self, port: int) -> None:
        self._target = port
        self._open: list[socket.socket] = []
        self._is_down = False
        self.forwarded = bytearray()
        self._server = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp/127.0.0.1:{self._server.getsockname()[1]}"
        self._threads: list[threading.Thread] = []
        self._run(self._accept)

    def __enter__(self) -> CuttableLink:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._server.shutdown(socket.SHUT_RDWR)
        self.down()
        for thread in self._threads:
            thread.join()
        self._server.close()

    def cut(self) -> None:
        """Both sides see their connection end; they may connect again."""
        while self._open:
            with suppress(OSError):
                self._open.pop().shutdown(socket.SHUT_RDWR)

    def down(self) -> None:
        """Cuts, and no new connection comes through until `up`."""
        self._is_down = True
        self.cut()

    def up(self) -> None:
        """Connections come through again."""
        self._is_down = False

    def _run(self, work: Callable[..., None], *arguments: Any) -> None:
        thread = threading.Thread(target=work, args=arguments, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                near, _ = self._server.accept()
                try:
                    far = self._connect()
                except ConnectionError:
                    near.close()
                    continue
                self._open += [near, far]
                for source, target in ((near, far), (far, near)):
                    self._run(self._forward, source, target)

    def _connect(self) -> socket.socket:
        if self._is_down:
            raise ConnectionRefusedError
        return socket.create_connection(("127.0.0.1", self._target))

    def _forward(self, source: socket.socket, target: socket.socket) -> None:
        with source:
            with suppress(OSError):
                while data := source.recv(65536):
                    if len(self.forwarded) < 1_000_000:
                        self.forwarded += data
                    target.sendall(data)
            for one in (source, target):
                with suppress(OSError):
                    one.shutdown(socket.SHUT_RDWR)
