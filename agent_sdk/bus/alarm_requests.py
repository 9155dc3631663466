"""The part of the client of a bus that reads and acknowledges alarms."""

from __future__ import annotations

from agent_sdk.bus.requests import Requests, build
from topics import keys
from topics.messages import Ack, Acknowledge, AlarmList, AlarmQuery


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
