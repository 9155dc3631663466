"""Connections of HTTP servers: a real server, real sockets."""

import asyncio
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import pytest

pytest.importorskip("uvicorn")

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from zenostat.bridge.http.connections import BoundedConnection, BoundedH11
from zenostat.bridge.http.server import LoopbackServer, listen

GET = b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n"
LIMIT = 8


class BoundedHttpTools(BoundedConnection, HttpToolsProtocol):
    """The other parser."""


async def app(scope: dict[str, Any], receive: Callable[[], Any], send: Callable[[Any], Any]) -> None:
    """Answer `OK` at once; below `/stream` send a byte, and end when the client does."""
    if scope["type"] != "http":
        for kind in ("startup", "shutdown"):
            await receive()
            await send({"type": f"lifespan.{kind}.complete"})
        return
    is_stream = scope["path"] == "/stream"
    length = [] if is_stream else [(b"content-length", b"2")]
    await send({"type": "http.response.start", "status": 200, "headers": length})
    await send({"type": "http.response.body", "body": b"OK", "more_body": is_stream})
    while is_stream and (await receive())["type"] != "http.disconnect":
        pass


@contextmanager
def serving(protocol: type[Any], timeout_s: float) -> Iterator[Callable[[bytes], socket.socket]]:
    """Serve the application; yield a function that connects and sends."""
    kind = type("Protocol", (protocol,), {"request_timeout_s": timeout_s})
    with ExitStack() as stack:
        listening = stack.enter_context(listen("127.0.0.1:0", "", "the test"))
        server = LoopbackServer(app, http=kind, limit_concurrency=LIMIT)
        thread = threading.Thread(target=lambda: asyncio.run(server.serve([listening])))
        thread.start()
        stack.callback(thread.join)
        stack.callback(setattr, server, "should_exit", True)

        def send(data: bytes) -> socket.socket:
            client = stack.enter_context(socket.create_connection(listening.getsockname(), timeout=60))
            client.sendall(data)
            return client

        yield send


def read_to(stream: socket.socket, end: bytes) -> None:
    """Read until the data end so."""
    received = b""
    while not received.endswith(end):
        received += stream.recv(1)


@pytest.fixture(params=[BoundedH11, BoundedHttpTools])
def protocol(request: pytest.FixtureRequest) -> type[Any]:
    kind: type[Any] = request.param
    return kind


def test_silent_connections__do_not_shut_out_others(protocol: type[Any]) -> None:
    with serving(protocol, 60.0) as send:
        silent = [send(b"GET / HT" if number % 2 else b"") for number in range(3 * LIMIT)]
        assert send(GET).recv(12) == b"HTTP/1.1 200"
        assert silent[0].recv(1) == b""  # the oldest were closed


def test_requests_that_are_answered__keep_their_connection(protocol: type[Any]) -> None:
    with serving(protocol, 60.0) as send:
        stream = send(GET.replace(b"/ ", b"/stream ", 1))
        assert stream.recv(12) == b"HTTP/1.1 200"
        silent = [send(b"") for _ in range(3 * LIMIT)]
        assert silent[0].recv(1) == b""
        read_to(stream, b"\r\n2\r\nOK\r\n")
        stream.settimeout(0.2)
        with pytest.raises(TimeoutError):
            stream.recv(1)  # it is still open, and has no more to say


def test_streams_only__a_further_request_is_refused(protocol: type[Any]) -> None:
    with serving(protocol, 60.0) as send:
        streams = [send(GET.replace(b"/ ", b"/stream ", 1)) for _ in range(LIMIT - 1)]
        assert {stream.recv(12) for stream in streams} == {b"HTTP/1.1 200"}
        assert send(GET).recv(12) == b"HTTP/1.1 503"


@pytest.mark.parametrize("data", [b"", b"GET /vers", b"POST / HTTP/1.1\r\nHost: a\r\n", GET + b"GET / H"])
def test_incomplete_request__ends_the_connection(protocol: type[Any], data: bytes) -> None:
    with serving(protocol, 0.2) as send:
        client = send(data)
        received = b""
        while part := client.recv(1000):
            received += part
        assert received.count(b"HTTP/1.1 200") == data.count(GET)


def test_stream__outlasts_the_time_of_a_request(protocol: type[Any]) -> None:
    with serving(protocol, 0.1) as send:
        stream = send(GET.replace(b"/ ", b"/stream ", 1))
        read_to(stream, b"\r\n2\r\nOK\r\n")
        stream.settimeout(0.4)
        with pytest.raises(TimeoutError):
            stream.recv(1)
