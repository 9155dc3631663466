"""The protocol by which a message came to the bus: Zenoh, or another one through a gateway.

A gateway names its protocol in the attachment of each message that it sends for a client. It is what the gateway says,
as is the client's name below the gateway's own.
"""

from __future__ import annotations

from zenostat.topics.keys import safe_name

ZENOH = "zenoh"
"""Of messages without an attachment."""

_MAX_BYTES = 32


def attachment(via: str) -> bytes | None:
    """Return the attachment of a message; None for one that is not sent for a client of another protocol."""
    return via.encode() if via and via != ZENOH else None


def client_protocol(attached: bytes | None) -> str:
    """Return the protocol that an attachment names: a name in lower case, of up to 32 characters."""
    if not attached:
        return ZENOH
    return safe_name(attached[:_MAX_BYTES].decode("utf-8", "replace"))
