"""Permissions of senders within a node, where keys are in use: revoked names, roles, and what belongs to others.

Zenoh's rules at the link drop what no role permits. They are those of the node or router to which a program connects,
as of its start; with these permissions a node applies its own list of names, its deny list, and what a rule on keys
cannot express.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

from zenostat.bridge.transport import name_list
from zenostat.bridge.transport.access_control import Permission, may
from zenostat.topics import keys
from zenostat.topics.keys import Role, Topic

_SENDS = frozenset((Permission.SEND, Permission.ASK))


class Access:
    """Permissions of senders on one node server.

    Args:
        names: the roles of each name.
        revoked: returns the revoked names.
        owner: of a branch, the controller that created it; empty for a node.
    """

    def __init__(
        self, names: Mapping[str, tuple[Role, ...]], revoked: Callable[[], Collection[str]], owner: str = ""
    ) -> None:
        self._names, self._revoked, self._owner = names, revoked, owner
        self._holders: dict[str, str] = {}
        self._by_role: dict[tuple[str, str], str] = {}

    @property
    def revoked(self) -> Collection[str]:
        """The revoked names."""
        return self._revoked()

    def of_branch(self, owner: str) -> Access:
        """Return the permissions on a branch that a controller has created."""
        return Access(self._names, self._revoked, owner)

    def holder(self, sender: str) -> str:
        """Return the name of the certificate under which a sender's name is; empty if there is none."""
        holder = self._holders.get(sender)
        if holder is None:
            holder = name_list.holder(self._names, sender)
            if len(self._holders) < 10_000:
                self._holders[sender] = holder
        return holder

    def denial(self, topic: Topic, sender: str) -> str:
        """Return why a sender may not send on a topic; empty if it may."""
        holder = self.holder(sender)
        if not holder:
            return f"{sender!r} is in no certificate's name in the list of names (names.json) of this node"
        if holder in self._revoked():
            return f"{holder} is revoked"
        reason = self._by_role.get((topic.key, holder))
        if reason is None:
            reason = self._by_role[topic.key, holder] = self._denial_by_role(topic, holder)
        return reason

    def _denial_by_role(self, topic: Topic, holder: str) -> str:
        """Return why a certificate's roles do not permit to send on a topic; empty if they do."""
        roles = self._names[holder]
        if Role.NODE in roles:
            return ""
        if not any(_SENDS.intersection(may(role, topic)) for role in roles):
            return f"{' and '.join(roles)} {holder!r} may not send {topic.key}; {' or '.join(topic.senders)} may"
        if topic is keys.STOP and not self.operates(holder):
            if not self._owner:
                return f"{' and '.join(roles)} {holder!r} may not stop a node, only end its own branches; operator may"
            if self.holder(self._owner) != holder:
                return f"{holder!r} may not end a branch of {self._owner!r}"
        return ""

    def operates(self, sender: str) -> bool:
        """Return whether a sender's certificate is that of an operator or a gateway."""
        return not {Role.OPERATOR, Role.GATEWAY}.isdisjoint(self._names.get(self.holder(sender), ()))

    def is_same_holder(self, sender: str, other: str) -> bool:
        """Return whether two senders' names are under the name of one certificate, or the first is a node's."""
        holder = self.holder(sender)
        return holder == self.holder(other) or Role.NODE in self._names.get(holder, ())
