"""The ZeroMQ gateway as a program, and a ZeroMQ program at its other end."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import msgpack
import numpy as np
import pytest
import zmq

import zenostat
from support.nodes import NodeProgram, begin_new_episode, until
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.topics import codec
from zenostat.topics.messages import Event, EventKind, Sample

ANY = "tcp://127.0.0.1:*"
PATIENCE_MS = 60_000

KILLED = """
import sys, msgpack, zmq
requests = zmq.Context().socket(zmq.REQ)
requests.connect(sys.argv[1])
requests.send_multipart([b"zenostat/v3/office/rpc/claim/doomed", msgpack.packb({"controller": "doomed"})])
print(requests.recv_multipart()[1].decode(), flush=True)
sys.stdin.read()
"""
"""A program that claims as `doomed`, says how that was answered, and waits."""


class GatewayProgram:
    """`zenostat gateway zeromq` as a program, on free ports."""

    def __init__(self, endpoint: str, *options: str) -> None:
        command = [sys.executable, "-P", "-u", "-m", "zenostat.cli.main", "gateway", "zeromq", "--connect", endpoint]
        command += [*(() if "--publish" in options else ("--publish", ANY, "--command", ANY)), *options]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        line = self.first_line = self.process.stdout.readline()
        if not line:
            raise AssertionError(self.process.communicate()[1])
        self.publish, self.command = re.findall(r"tcp://127\.0\.0\.1:\d+", line)[-2:]

    def __enter__(self) -> GatewayProgram:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.communicate()

    def interrupt(self) -> tuple[int, str, str]:
        self.process.send_signal(signal.SIGINT)
        out, err = self.process.communicate(timeout=60)
        return self.process.returncode, out, err


class Peer:
    """A ZeroMQ program's two sockets."""

    def __init__(self, gateway: GatewayProgram, kind: int = 0, node: str = "office") -> None:
        self.root = f"zenostat/v3/{node}"
        self.context = zmq.Context()
        self.req = kind == zmq.REQ
        self.requests = self.context.socket(kind or zmq.DEALER)
        self.published = self.context.socket(zmq.SUB)
        for socket, endpoint in ((self.requests, gateway.command), (self.published, gateway.publish)):
            socket.linger, socket.rcvtimeo = 0, PATIENCE_MS
            socket.connect(endpoint)

    def __enter__(self) -> Peer:
        return self

    def __exit__(self, *_: object) -> None:
        self.context.destroy(linger=0)

    def say(self, what: str, payload: bytes | None = None, /, **fields: Any) -> None:
        self.requests.send_multipart(
            [f"{self.root}/{what}".encode(), msgpack.packb(fields) if payload is None else payload]
        )

    def answer(self) -> tuple[str, dict[str, Any]]:
        """The class of an answer, and its fields."""
        _, encoding, payload = self.requests.recv_multipart()
        return encoding.decode().rpartition(".")[2], msgpack.unpackb(payload)

    def ask(self, what: str, payload: bytes | None = None, /, **fields: Any) -> tuple[str, dict[str, Any]]:
        self.say(what, payload, **fields)
        return self.answer()

    def silent(self) -> bool:
        return not self.requests.poll(0)

    def listen(self, topic: str) -> None:
        self.published.subscribe(f"{self.root}/{topic}")

    def hear(self, kind: type[Any]) -> Any:
        """The next published message."""
        _, encoding, payload = self.published.recv_multipart()
        return codec.decode(kind, payload, encoding.decode())

    def first_sample(self) -> Sample:
        """Subscribe to samples; return the latest one."""
        self.listen("sample")
        return self.after(None)

    def after(self, sample: Sample | None) -> Sample:
        """The first sample that is another one."""
        while (
            (received := self.hear(Sample))
            and sample
            and (received.episode, received.step) == (sample.episode, sample.step)
        ):
            pass
        return received

    def event(self, kind: EventKind) -> Event:
        while (event := self.hear(Event)).kind is not kind:
            pass
        return event


def answering(sample: Sample, values: np.ndarray, **more: Any) -> dict[str, Any]:
    return {"episode": sample.episode, "step": sample.step, "values": values.astype("<f8").tobytes(), **more}


def keeping(sample: Sample, **changes: Any) -> dict[str, Any]:
    """A command that changes nothing."""
    count = len(sample.effective) // 8
    return answering(sample, np.zeros(count), operations=bytes(count)) | changes


@pytest.fixture(scope="module")
def module_gateway(shared_node: NodeProgram) -> Iterator[GatewayProgram]:
    """The gateway of the node that the tests of this module share."""
    with GatewayProgram(shared_node.endpoint) as program:
        yield program


@pytest.fixture
def gateway(shared_node: NodeProgram, module_gateway: GatewayProgram) -> GatewayProgram:
    """`module_gateway`, after it has published the first sample of a new episode."""
    with zenostat.connect(shared_node.endpoint, affinity=Affinity.OFF) as bus:
        episode = begin_new_episode(bus)
    with Peer(module_gateway) as peer:
        peer.listen("sample")
        until(lambda: (sample := peer.hear(Sample)).episode == episode and sample.step == [0], "the first sample")
    return module_gateway
