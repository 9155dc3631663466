"""The names of the nodes on a bus."""

from __future__ import annotations

import zenoh

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
