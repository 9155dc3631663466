"""Commands as the MQTT gateway receives them, their results, and counts."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class Counts:
    """Numbers of published samples, of samples and events dropped as the broker was slow or away, and of commands.

    Attributes:
        lost_results: results of commands that were dropped as the broker was slow or away.
        denied: rejected commands that their client may not send.
        refused: messages and subscriptions of the gateway that the broker rejected.
    """

    samples: int = 0
    dropped: int = 0
    lost_results: int = 0
    accepted: int = 0
    rejected: int = 0
    denied: int = 0
    refused: int = 0
    reconnections: int = 0


@dataclass(frozen=True, slots=True)
class Received:
    """A command as received: the actuator's name, the payload, and where an MQTT 5 client wants the result.

    Attributes:
        user: the user that its topic names; None if it names none.
        reply_topic: the response topic, unless it is a gateway's own, or none to which can be published.
        own_topic: the response topic if it is a gateway's own.
    """

    user: str | None
    actuator: str
    payload: bytes
    is_retained: bool
    reply_topic: str | None
    own_topic: str | None
    correlation: bytes | None


@dataclass(slots=True)
class Result:
    """A result to be published; `attempts_left` on its topic, None for any number."""

    topic: str
    text: str
    correlation: bytes | None
    attempts_left: int | None = None
