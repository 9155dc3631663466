"""Names that only one gateway of a node can have: sources, topics on a broker, BACnet device instances."""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from urllib.parse import quote, unquote

import zenoh
from zenoh.handlers import Callback

from zenostat.topics import keys
from zenostat.topics.errors import NameInUse
from zenostat.topics.printable import replace_controls

_TOKEN_PARTS = 4
"""Parts of a token's last chunk: the reserved name, host, process and instance, separated by colons."""


@asynccontextmanager
async def reserved_names(
    session: zenoh.Session, node: str, names: Mapping[str, str], identity: str = ""
) -> AsyncIterator[None]:
    """Reserve names for a gateway of a node for as long as the context or the session lasts.

    Each name is a liveliness token, so the name of a gateway that dies is free again. The token's key has the name in
    the gateway's certificate, so no other gateway can declare it.

    Args:
        session: an open session.
        node: name of the node.
        names: the names, each with advice for the case that it is in use: `choose another name with --source`.
        identity: the name in the gateway's certificate; empty without keys.

    Raises:
        NameInUse: another gateway of the node has one of the names, or one above or below it; the text has its
            certificate, host and process.
    """
    own = str(session.zid())
    await _check(session, node, names, lambda instance: instance != own)
    declare = session.liveliness().declare_token
    sender = keys.own_name(identity, "")
    declared = [declare(keys.GATEWAY_TOKEN.at(node, sender=sender, name=_token_name(name, own))) for name in names]
    try:
        # Of two gateways that start at the same time, the one with the lower id remains.
        await _check(session, node, names, lambda instance: instance < own)
        yield
    finally:
        for token in declared:
            token.undeclare()  # type: ignore[no-untyped-call]


async def liveliness_tokens(session: zenoh.Session, key: str) -> list[str]:
    """Return the keys of the liveliness tokens that match a key expression."""
    loop = asyncio.get_running_loop()
    is_complete, tokens = asyncio.Event(), list[str]()

    def on_reply(reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            tokens.append(str(reply.ok.key_expr))

    def on_end() -> None:
        with suppress(RuntimeError):  # the loop is closed
            loop.call_soon_threadsafe(is_complete.set)

    session.liveliness().get(key, Callback(on_reply, on_end, indirect=False))
    await is_complete.wait()
    return tokens


def _token_name(name: str, instance: str) -> str:
    parts = (name, socket.gethostname(), str(os.getpid()), instance)
    return ":".join(quote(part, safe="") for part in parts)


async def _check(session: zenoh.Session, node: str, names: Mapping[str, str], precedes: Callable[[str], bool]) -> None:
    for token in await liveliness_tokens(session, keys.GATEWAY_TOKEN.everywhere(node)):
        sender, last = keys.GATEWAY_TOKEN.names_in(token)
        parts = [replace_controls(unquote(part)) for part in last.split(":")]
        if len(parts) != _TOKEN_PARTS:
            continue  # no gateway of Zenostat
        name, host, process, instance = parts
        advice = next((text for own, text in names.items() if _overlap(own, name)), None)
        if advice is not None and precedes(instance):
            whose = f"{sender}, " if sender != keys.own_name("", "") else ""
            raise NameInUse(
                f"a gateway of node {node!r} uses {name!r} already ({whose}process {process} on {host}); {advice}"
            )


def _overlap(name: str, other: str) -> bool:
    """Return whether two names are equal, or one is below the other, as `modbus.two` is below `modbus`."""
    return f"{name}.".startswith(f"{other}.") or f"{other}.".startswith(f"{name}.")
