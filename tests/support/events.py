"""Events of a node, as a subscriber receives them."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import zenoh
from zenoh.handlers import FifoChannel

from zenostat import Bus
from zenostat.topics import codec, keys
from zenostat.topics.messages import Event, EventKind


@contextmanager
def events_of(bus: Bus, node: str = "office") -> Iterator[zenoh.Subscriber[Any]]:
    """A subscription to a node's events, which the node has heard of."""
    with bus.session.declare_subscriber(keys.EVENT.at(node), FifoChannel(4096)) as events:
        bus.status(node)  # its answer comes after the subscription
        yield events


def next_event(events: zenoh.Subscriber[Any], *kinds: EventKind) -> Event:
    """The next event of these kinds; others are passed over."""
    while True:
        event = codec.decode(Event, events.recv().payload.to_bytes())
        if event.kind in kinds:
            return event
