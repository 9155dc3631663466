"""The samples of a node for a process that does not control it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

import zenoh
from zenoh.handlers import Callback, RingChannel

from agent_sdk.bus import fork_guard
from agent_sdk.bus.sample import SampleView
from bridge.transport.session import FORKED
from bridge.transport.wakeup import Wake
from topics import codec, keys
from topics.errors import BusError, NodeLost
from topics.messages import Sample
from topics.points import value_index

if TYPE_CHECKING:
    from agent_sdk.bus.bus import Bus

_INBOX = 16384


@contextmanager
def listen(bus: Bus, node: str) -> Iterator[Iterator[SampleView]]:
    """Yield an iterator over a node's samples from now on; see `Bus.listen`."""
    manifest = bus.manifest(node)
    names = value_index(manifest)
    token, wake_key = keys.NODE_TOKEN.at(node, name=manifest.instance), keys.wake(node)
    wake = Wake(bus.session, wake_key)

    def on_token(sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.DELETE:
            wake()

    with ExitStack() as stack, _unless_forked(bus, stack) as session:
        inbox = stack.enter_context(session.declare_subscriber(keys.stream(node), RingChannel(_INBOX)))
        watch = session.liveliness().declare_subscriber(token, Callback(on_token, indirect=False))
        stack.callback(watch.undeclare)
        stack.callback(wake.close)
        bus.manifest(node)  # without this, the loss of a node that left meanwhile would not be reported

        def samples() -> Iterator[SampleView]:
            while True:
                if bus.session is not session:
                    raise BusError(FORKED)
                message = inbox.recv()
                key = str(message.key_expr)
                if key == wake_key:
                    raise NodeLost(f"node {node!r} is gone")
                if key == keys.SAMPLE.at(node):
                    sample = codec.decode(Sample, message.payload.to_bytes(), str(message.encoding))
                    yield SampleView(sample, manifest, names)

        yield samples()


@contextmanager
def _unless_forked(bus: Bus, stack: ExitStack) -> Iterator[zenoh.Session]:
    """Leave to the parent process what a forked one cannot undeclare."""
    session = bus.session
    try:
        yield session
    finally:
        if bus.session is not session:
            fork_guard.keep(stack.pop_all())
