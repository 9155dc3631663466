"""Revocation of a name: its claims end, and everything that it has set is relinquished. No I/O."""

from __future__ import annotations

from zenostat.bridge.exchange.state import ExchangeState
from zenostat.topics.keys import is_own
from zenostat.topics.messages import Event, EventKind


def revoke(exchange: ExchangeState, name: str) -> list[Event]:
    """End the claims of a name and of the names below it, and relinquish their values at all priorities.

    Args:
        exchange: the state of the exchange.
        name: of a certificate that is revoked.

    Returns:
        The event that reports it.
    """
    claims = [controller for controller in exchange.claims.by_name if is_own(name, controller)]
    for controller in claims:
        exchange.answers.forget(controller)
        exchange.claims.remove(controller)
    sources = [source for source in exchange.commands.array.names if source and is_own(name, source)]
    actuators = exchange.commands.relinquish_sources(sources)
    if actuators:
        exchange.modified = exchange.all_modified
    parts = [f"{name} is revoked"]
    if claims:
        parts.append(f"released: {', '.join(claims)}")
    if actuators:
        parts.append(f"relinquished: {', '.join(actuators)}")
    return [exchange.event(EventKind.REVOKED, "; ".join(parts), name)]
