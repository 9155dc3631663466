"""A monitor, as a program: it hears all of a node's stream, and writes it down if it is given a file.

`python -m chaos.monitor SETTINGS`, JSON: endpoint, node, record (a path or None). It says `ready` once it listens, and
ends with 0 when the node has said that it was stopped.
"""

import json
import signal
import sys
from contextlib import ExitStack
from time import monotonic, sleep

import msgpack
import zenoh
from zenoh.handlers import RingChannel

from chaos.journal import KINDS
from zenostat.bridge.transport.session import open_session
from zenostat.topics import codec, keys
from zenostat.topics.messages import Event, EventKind

_LISTEN = 65536
_PATIENCE_S = 60.0


def main() -> int:
    """Listens until the node has stopped."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    settings = json.loads(sys.argv[1])
    with ExitStack() as stack:
        # Like `zenostat monitor`, it waits for a node that is frozen, or slow, as it comes.
        session = stack.enter_context(open_session(connect=[settings["endpoint"]], wait=True))
        stream = keys.stream(settings["node"])
        inbox = stack.enter_context(session.declare_subscriber(stream, RingChannel(_LISTEN)))
        file = stack.enter_context(open(settings["record"], "wb")) if settings["record"] else None
        _await_answer(session, settings["node"])  # the node knows of the subscription by then
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        while True:
            message = inbox.recv()
            kind, payload = keys.last_chunk(str(message.key_expr)), message.payload.to_bytes()
            if file is not None and kind in KINDS:
                file.write(msgpack.packb((kind, payload)))
            if kind == "event" and codec.decode(Event, payload).kind is EventKind.STOPPED:
                return 0


def _await_answer(session: zenoh.Session, node: str) -> None:
    """Ask for the status until the node answers; `SystemExit` if it never does."""
    end_s = monotonic() + _PATIENCE_S
    while not any(reply.ok for reply in session.get(keys.STATUS.at(node))):
        if monotonic() > end_s:
            sys.exit(f"{node} answered nothing for {_PATIENCE_S:g} s")
        sleep(0.1)


if __name__ == "__main__":
    sys.exit(main())
