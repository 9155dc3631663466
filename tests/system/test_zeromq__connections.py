"""ZeroMQ connections that do harm: an identity that is in use, a message without an end, too many frames."""

import re
import signal
import socket
import struct

import pytest

pytest.importorskip("zmq", reason="pyzmq is not installed")

import zmq
from support.nodes import Program
from support.zeromq import KILLED, GatewayProgram, Peer, gateway, keeping, module_gateway

import zenostat
from zenostat.gateways.zeromq import connections
from zenostat.gateways.zeromq.frames import split

__all__ = ["gateway", "module_gateway"]

IDENTITY = b"controller-1"
NAMED = KILLED.replace("requests.connect", f"requests.routing_id = {IDENTITY!r}\nrequests.connect")
MIB = 1 << 20


@pytest.mark.slow
def test_zeromq__controller_that_starts_again_takes_its_identity_from_a_connection_that_is_still_open(
    shared_node, gateway
):
    with Program(NAMED, gateway.command) as program, Peer(gateway) as new:
        assert program.line().endswith(".Ack")
        program.process.send_signal(signal.SIGSTOP)
        new.requests.disconnect(gateway.command)
        new.requests.routing_id = IDENTITY
        new.requests.connect(gateway.command)
        sample = new.first_sample()
        kind, denied = new.ask("command/doomed", **keeping(sample))
        assert (kind, denied["error"]) == ("ErrorReply", "RequestRejected")
        assert denied["message"].startswith("'doomed' has claimed nothing; claim first, through this connection")
        assert new.ask("rpc/claim/doomed", controller="doomed")[0] == "Ack"
        assert new.ask("command/doomed", **keeping(sample))[0] == "Ack"
        program.process.kill()
        program.process.wait()
        assert new.ask("command/doomed", **keeping(new.after(sample)))[0] == "Ack"
        with zenostat.connect(shared_node.endpoint, affinity="off") as bus:
            assert [c.state for c in bus.status("office").controllers] == ["connected"]


def bare(endpoint: str, kind: bytes) -> socket.socket:
    """A connection that speaks ZMTP 3.0 (rfc.zeromq.org/spec/23) by itself, ready for messages."""
    host, port = re.fullmatch(r"tcp://(.+):(\d+)", endpoint).groups()
    connection = socket.create_connection((host, int(port)), timeout=60)
    connection.sendall(b"\xff" + bytes(8) + b"\x7f\x03\x00" + b"NULL".ljust(20, b"\0") + bytes(32))
    ready = b"\x05READY\x0bSocket-Type" + struct.pack(">I", len(kind)) + kind
    connection.sendall(bytes([4, len(ready)]) + ready)
    received = b""
    while b"READY" not in received:  # a message before it is a protocol error
        received += connection.recv(1)
    return connection


def ended(connection: socket.socket) -> bool:
    """Reads whatever comes until the other side closes."""
    try:
        while connection.recv(MIB):
            pass
    except ConnectionError:
        pass
    return True


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize(("kind", "size"), [(b"DEALER", MIB), (b"DEALER", 1000), (b"SUB", 1000)])
def test_zeromq__message_without_an_end_ends_its_connection(gateway: GatewayProgram, kind: bytes, size: int) -> None:
    to = gateway.publish if kind == b"SUB" else gateway.command
    more = b"\x03" + struct.pack(">Q", size) + bytes(size)
    frames = more * (3 * MIB // len(more) + 1)
    with bare(to, kind) as connection, Peer(gateway) as peer:
        try:
            for _ in range(connections.MAX_UNREAD // (2 * MIB)):
                connection.sendall(frames)
        except ConnectionError:
            pass
        assert ended(connection)
        assert peer.ask("rpc/status")[0] == "Status"


@pytest.mark.slow
def test_zeromq__message_that_is_large_or_long_in_coming_is_read(gateway: GatewayProgram) -> None:
    topic = b"zenostat/v3/office/rpc/status"
    with bare(gateway.command, b"DEALER") as connection, Peer(gateway) as peer:
        connection.sendall(bytes([1, len(topic)]) + topic + b"\x02" + struct.pack(">Q", 8 * MIB) + bytes(4 * MIB))
        for _ in range(10):
            assert peer.ask("rpc/status")[0] == "Status"
        connection.sendall(bytes(4 * MIB))
        received = b""
        while b"ErrorReply" not in received:
            received += (more := connection.recv(MIB))
            assert more, "the connection has ended"


def test_zeromq__request_with_too_many_frames_has_one_proper_answer(gateway: GatewayProgram) -> None:
    with Peer(gateway, zmq.REQ) as peer:
        for frames in ([b"one", b"two", b"three"], [b"t"] * 12, [b"", b"one", b"two", b"three"]):
            peer.requests.send_multipart(frames)
            topic, encoding, payload = peer.requests.recv_multipart()[-3:]
            assert encoding.endswith(b".ErrorReply")
            assert b"frames; a request has a topic" in payload
            assert topic == frames[0]
        assert peer.ask("rpc/status")[0] == "Status"


def test_zeromq__envelope_ends_at_the_first_empty_frame():
    peer, rest = split([b"r", b"", b"one", b"two", b"three"], 3)
    assert (peer.envelope, list(rest)) == ((b"",), [b"one", b"two", b"three"])
    peer, rest = split([b"r", b"1", b"", b"t", b""], 3)
    assert (peer.envelope, list(rest)) == ((b"1", b""), [b"t", b""])
    assert split([b"r", b"t", b""], 3)[0].envelope == ()
