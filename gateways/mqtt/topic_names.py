"""Names of MQTT topics."""

from __future__ import annotations

from zenostat.topics.errors import InvalidConfig

PREFIX = "zenostat"
"""First level of a gateway's topics, if the user chooses no other; the node's name follows."""

_MAX_BYTES = 65_535
_MAX_ROOT = 1000


def is_topic(topic: str | None) -> bool:
    """Return whether a message can be published to a topic: a client may name any text as response topic."""
    if not topic or any(char in topic for char in "+#\0"):
        return False
    return len(topic.encode()) <= _MAX_BYTES


def is_below(topic: str, root: str) -> bool:
    """Return whether a topic is a root or below it."""
    return topic == root or topic.startswith(f"{root}/")


def check_root(root: str) -> str:
    """Return a topic without its slash at the end.

    Raises:
        InvalidConfig: it has wildcards or empty levels, is one of the broker's own (`$SYS`), or is too long.
    """
    if len(root) > _MAX_ROOT:
        raise InvalidConfig(f"a topic of {len(root)} characters; at most {_MAX_ROOT} are accepted")
    if root.startswith("$"):
        raise InvalidConfig(f"topic {root!r}: brokers accept no messages on topics that begin with '$'")
    bare = root.removesuffix("/")
    if not bare or any(char in bare for char in "+#\0") or "" in bare.split("/"):
        raise InvalidConfig(f"topic {root!r}: expected levels without wildcards, for example buildings/office")
    return bare
