"""The part of the client of a bus that reads alarms and carries out what operators decide."""

from __future__ import annotations

from zenostat.bridge.client.requests import Requests, build
from zenostat.topics import keys
from zenostat.topics.messages import (
    Ack,
    Acknowledge,
    AlarmList,
    AlarmQuery,
    RemoveFromService,
    ReturnToService,
    Shelve,
    Unshelve,
)


class AlarmRequests(Requests):
    """Base class of `Bus`: requests about the alarms of a node."""

    def alarms(self, node: str, *, slot: int = 0) -> AlarmList:
        """Return all alarms of a slot with their states, in the order of the rules; without rules there are none."""
        return self._ask(keys.ALARMS, node, build(AlarmQuery, slot=slot), AlarmList)

    def acknowledge(
        self, node: str, alarm: str, *, slot: int | None = None, source: str = "", comment: str = ""
    ) -> Ack:
        """Acknowledge alarms; the text of the reply has a line for each.

        Args:
            node: The node's name.
            alarm: Name of an alarm, or of a rule for all of its points; `*` stands for any characters.
            slot: Number of the slot; None is all of them.
            source: Name of who acknowledges, at most 128 characters.
            comment: For the record, at most 500 characters.

        Raises:
            NodeNotFound: No such node.
            UnknownName: No such alarm; the text lists similar names.
            RequestRejected: None of these alarms awaits an acknowledgment.
        """
        request = build(Acknowledge, alarm=alarm, slot=slot, source=source, comment=comment)
        return self._ask(keys.ACKNOWLEDGE, node, request, Ack)

    def shelve(
        self,
        node: str,
        alarm: str,
        duration_s: float,
        *,
        slot: int | None = None,
        source: str = "",
        comment: str = "",
    ) -> Ack:
        """Shelve alarms: for a time they alert nobody. For a shelved alarm, the time begins anew.

        Args:
            node: The node's name.
            alarm: Name of an alarm, or of a rule for all of its points; `*` stands for any characters.
            duration_s: Simulated seconds, rounded up to whole timesteps; at most the `max_shelve_s` of the rule.
            slot: Number of the slot; None is all of them.
            source: Name of who shelves, at most 128 characters.
            comment: For the record, at most 500 characters.

        Raises:
            NodeNotFound: No such node.
            UnknownName: No such alarm; the text lists similar names.
            RequestRejected: The time is too long, or these alarms are out of service.
        """
        request = build(Shelve, alarm=alarm, duration_s=duration_s, slot=slot, source=source, comment=comment)
        return self._ask(keys.SHELVE, node, request, Ack)

    def unshelve(self, node: str, alarm: str, *, slot: int | None = None, source: str = "", comment: str = "") -> Ack:
        """End the shelving of alarms; those that are off-normal become active. Arguments: see `acknowledge`.

        Raises:
            NodeNotFound: No such node.
            UnknownName: No such alarm; the text lists similar names.
            RequestRejected: None of these alarms is shelved.
        """
        request = build(Unshelve, alarm=alarm, slot=slot, source=source, comment=comment)
        return self._ask(keys.UNSHELVE, node, request, Ack)

    def remove_from_service(
        self,
        node: str,
        alarm: str,
        duration_s: float | None = None,
        *,
        slot: int | None = None,
        source: str = "",
        comment: str = "",
    ) -> Ack:
        """Remove alarms from service, for example while a sensor is repaired: they alert nobody until returned.

        Args:
            node: The node's name.
            alarm: Name of an alarm, or of a rule for all of its points; `*` stands for any characters.
            duration_s: Simulated seconds after which they are returned, at most a year; None is no limit.
            slot: Number of the slot; None is all of them.
            source: Name of who removes them, at most 128 characters.
            comment: For the record, at most 500 characters.

        Raises:
            NodeNotFound: No such node.
            UnknownName: No such alarm; the text lists similar names.
        """
        request = build(
            RemoveFromService, alarm=alarm, duration_s=duration_s, slot=slot, source=source, comment=comment
        )
        return self._ask(keys.REMOVE_FROM_SERVICE, node, request, Ack)

    def return_to_service(
        self, node: str, alarm: str, *, slot: int | None = None, source: str = "", comment: str = ""
    ) -> Ack:
        """Return alarms to service; those that are off-normal become active. Arguments: see `acknowledge`.

        Raises:
            NodeNotFound: No such node.
            UnknownName: No such alarm; the text lists similar names.
            RequestRejected: None of these alarms is out of service.
        """
        request = build(ReturnToService, alarm=alarm, slot=slot, source=source, comment=comment)
        return self._ask(keys.RETURN_TO_SERVICE, node, request, Ack)
