"""The samples of a node for a process that does not control it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import zenoh
from zenoh.handlers import RingChannel

from zenostat.bridge.client import fork_guard
from zenostat.bridge.client.connection import Connection
from zenostat.bridge.client.presence import NodeWatch
from zenostat.bridge.client.sample import SampleView
from zenostat.bridge.transport.session import FORKED
from zenostat.bridge.transport.wakeup import stream_wake
from zenostat.topics import codec, keys
from zenostat.topics.errors import BusError, NodeNotFound
from zenostat.topics.messages import Sample
from zenostat.topics.points import value_index

_INBOX = 16384


@contextmanager
def listen(bus: Connection, node: str) -> Iterator[Iterator[SampleView]]:
    """Yield an iterator over a node's samples from now on; see `Bus.listen`."""
    manifest = bus.manifest(node)
    names = value_index(manifest)
    with ExitStack() as stack, _unless_forked(bus, stack) as session:
        inbox = stack.enter_context(session.declare_subscriber(keys.stream(node), RingChannel(_INBOX)))
        wake = stream_wake(session, node)
        watch = NodeWatch(session, node, wake)
        stack.callback(watch.close)
        stack.callback(wake.close)
        watch.watch(manifest.instance)
        if not watch.wait():
            raise NodeNotFound(f"node {node!r} is not on the bus")

        def samples() -> Iterator[SampleView]:
            while True:
                if bus.session is not session:
                    raise BusError(FORKED)
                message = inbox.recv()
                key = str(message.key_expr)
                if key == wake.key and watch.lost:
                    raise bus.lost(node, ", or the connection to it is lost")
                if key == keys.SAMPLE.at(node):
                    sample = codec.decode(Sample, message.payload.to_bytes(), str(message.encoding))
                    yield SampleView(sample, manifest, names)

        yield samples()


@contextmanager
def _unless_forked(bus: Connection, stack: ExitStack) -> Iterator[zenoh.Session]:
    """Leave to the parent process what a forked one cannot undeclare."""
    session = bus.session
    try:
        yield session
    finally:
        if bus.session is not session:
            fork_guard.keep(stack.pop_all())
