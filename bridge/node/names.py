"""The names of the nodes on a bus."""

from __future__ import annotations

from collections.abc import Callable

import zenoh
from zenoh.handlers import Callback

from zenostat.topics import keys
from zenostat.topics.errors import NameInUse


def instances(session: zenoh.Session, name: str) -> list[str]:
    """Return the session ids of all nodes of a name on the bus."""
    replies = session.liveliness().get(keys.NODE_TOKEN.at(name, name="*"))
    return [keys.last_chunk(str(reply.ok.key_expr)) for reply in replies if reply.ok]


def check_name_is_free(session: zenoh.Session, name: str) -> None:
    """Raise `NameInUse` if there is a node of that name that has another session."""
    others = [instance for instance in instances(session, name) if instance != str(session.zid())]
    if others:
        raise NameInUse(f"a node named {name!r} is on this bus already (instance {others[0]}); choose another name")


def watch_name(session: zenoh.Session, name: str, on_namesake: Callable[[str], None]) -> zenoh.Subscriber[None]:
    """Follow the nodes of a name from now on: two parts of a bus, each with one of them, may be connected later.

    Args:
        session: that of a node of this name.
        name: of the node.
        on_namesake: called with the session id of each other node of the name that appears, in a thread of Zenoh's.
    """
    own = str(session.zid())

    def on_token(token: zenoh.Sample) -> None:
        instance = keys.last_chunk(str(token.key_expr))
        if token.kind == zenoh.SampleKind.PUT and instance != own:
            on_namesake(instance)

    tokens, callback = keys.NODE_TOKEN.at(name, name="*"), Callback(on_token, indirect=False)
    return session.liveliness().declare_subscriber(tokens, callback, history=True)
