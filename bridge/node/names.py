"""The names of the nodes on a bus."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic

import zenoh
from zenoh.handlers import Callback

from zenostat.bridge.runtime.timer import Timer
from zenostat.topics import keys
from zenostat.topics.errors import NameInUse

SETTLE_S = 5.0
"""Wall time after its start within which a node leaves its name to one with a lower session id, in s."""


def check_name_is_free(session: zenoh.Session, name: str) -> None:
    """Raise `NameInUse` if there is a node of that name that has another session."""
    for reply in session.liveliness().get(keys.NODE_TOKEN.at(name, name="*")):
        if reply.ok and (instance := keys.last_chunk(str(reply.ok.key_expr))) != str(session.zid()):
            raise _name_in_use(name, instance)


class BranchNames:
    """Names of branches of a node that other nodes on the bus have.

    Args:
        session: that of the node and its branches.
        node: name of the node.
        on_taken: called with each such name when another node has it, in a thread of the session.
    """

    def __init__(self, session: zenoh.Session, node: str, on_taken: Callable[[str], None]) -> None:
        self._own, self._on_taken = str(session.zid()), on_taken
        self._others = set[tuple[str, str]]()
        tokens, callback = keys.NODE_TOKEN.at(f"{node}.b$*", name="*"), Callback(self._on_token, indirect=False)
        self._subscriber = session.liveliness().declare_subscriber(tokens, callback, history=True)

    def close(self) -> None:
        """Follow them no longer."""
        self._subscriber.undeclare()  # type: ignore[no-untyped-call]

    def __contains__(self, name: object) -> bool:
        return any(other == name for other, _ in self._others.copy())

    def _on_token(self, token: zenoh.Sample) -> None:
        key = str(token.key_expr)
        name, instance = keys.node_of(key), keys.last_chunk(key)
        if instance == self._own:
            return
        if token.kind == zenoh.SampleKind.DELETE:
            self._others.discard((name, instance))
            return
        self._others.add((name, instance))
        self._on_taken(name)


class NameWatch:
    """Follows the other nodes of a node's name.

    Nodes that start at once find the name free. Each of them then sees the tokens of the others, and all but the one
    with the lowest session id end. Two parts of a bus, each with a node of the name, may also be connected later; both
    have been used by then, so they remain and report each other.

    Args:
        session: that of the node, which has not declared its own token yet.
        name: of the node.
        timer: delays reports of nodes that start at once with this one, since most of them end.
        on_name_in_use: called with the error if this node has to end.
        on_namesake: called with the session id of another node of the name, once this one has been on the bus for
            `SETTLE_S`. When one that was reported has left, called with another that was, or with an empty text. Both
            are called in a thread of the session or the timer.
    """

    def __init__(
        self,
        session: zenoh.Session,
        name: str,
        timer: Timer,
        on_name_in_use: Callable[[NameInUse], None],
        on_namesake: Callable[[str], None],
    ) -> None:
        self._name, self._own, self._timer = name, str(session.zid()), timer
        self._on_name_in_use, self._on_namesake = on_name_in_use, on_namesake
        self._others, self._reported = set[str](), set[str]()
        self._settled_s = monotonic() + SETTLE_S
        tokens, callback = keys.NODE_TOKEN.at(name, name="*"), Callback(self._on_token, indirect=False)
        self._subscriber = session.liveliness().declare_subscriber(tokens, callback, history=True)

    def close(self) -> None:
        """Follow them no longer."""
        self._subscriber.undeclare()  # type: ignore[no-untyped-call]

    def _on_token(self, token: zenoh.Sample) -> None:
        instance = keys.last_chunk(str(token.key_expr))
        if instance == self._own:
            return
        if token.kind == zenoh.SampleKind.DELETE:
            self._others.discard(instance)
            if instance in self._reported:
                self._reported.discard(instance)
                self._on_namesake(max(self._reported, default=""))
            return
        self._others.add(instance)
        if monotonic() >= self._settled_s:
            self._report(instance)
        elif instance < self._own:
            self._on_name_in_use(_name_in_use(self._name, instance))
        else:
            self._timer.at(self._settled_s, lambda: self._report(instance))

    def _report(self, instance: str) -> None:
        if instance in self._others:
            self._reported.add(instance)
            self._on_namesake(instance)


def _name_in_use(name: str, instance: str) -> NameInUse:
    return NameInUse(f"a node named {name!r} is on this bus already (instance {instance}); choose another name")
