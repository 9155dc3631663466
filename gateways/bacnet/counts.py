"""Counts of a BACnet gateway's messages."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class BacnetCounts:
    """Numbers of messages of BACnet clients.

    Attributes:
        datagrams: datagrams received.
        requests: confirmed requests, which have an answer.
        rejected: confirmed requests that were answered with an error, a reject or an abort.
        writes: properties written.
        denied: writes that their client may not make.
        malformed: datagrams that are no valid message, and so have no answer.
        notifications: COV notifications sent.
    """

    datagrams: int = 0
    requests: int = 0
    rejected: int = 0
    writes: int = 0
    denied: int = 0
    malformed: int = 0
    notifications: int = 0
