"""The state machines of the exchange: of the episode and of each controller that has a claim.

The module `step_exchange` has a drawing of the episode's states. Those of a controller:

    claim ──▶ CONNECTED ─────deadline──────▶ UNRESPONSIVE
                  │     ◀──answer, reset───       │
              disconnect                      disconnect
                  ▼                               ▼
             DISCONNECTED ───deadline──────▶   ABSENT
                  │       ◀──answer────────       │
                bypass                          bypass
                  └─────────▶ BYPASSED ◀──────────┘

An answer changes nothing in the other states, nor does a deadline, or a reset in the state CONNECTED. A reset of all
slots drops the claims of disconnected controllers. A controller that claims again, or that is on the bus again with its
claim, begins as CONNECTED.
"""

from __future__ import annotations

from enum import StrEnum

from zenostat.topics.messages import ControllerState, State


class Trigger(StrEnum):
    """Inputs of the episode's state machine."""

    READY = "ready"
    GO = "go"
    SAMPLED = "sampled"
    ENDED = "ended"
    RESET = "reset"
    FAIL = "fail"
    STOP = "stop"


TRANSITIONS: dict[tuple[State, Trigger], State] = {
    (State.STARTING, Trigger.READY): State.WAITING,
    (State.WAITING, Trigger.GO): State.RUNNING,
    (State.RUNNING, Trigger.SAMPLED): State.WAITING,
    (State.RUNNING, Trigger.ENDED): State.ENDED,
    (State.WAITING, Trigger.RESET): State.STARTING,
    (State.ENDED, Trigger.RESET): State.STARTING,
    (State.FAILED, Trigger.RESET): State.STARTING,
    **{(s, Trigger.FAIL): State.FAILED for s in (State.STARTING, State.WAITING, State.RUNNING)},
    **{(s, Trigger.STOP): State.STOPPED for s in State if s is not State.STOPPED},
}


class ControllerTrigger(StrEnum):
    """Inputs of a controller's state machine.

    `ANSWER`: its command is accepted. `DEADLINE`: it has not answered by the deadline. `DISCONNECT`: it has left the
    bus. `RECONNECT`: it is on the bus again. `BYPASS`: it has been disconnected for the grace period. `RESET`: a new
    episode begins in all slots.
    """

    ANSWER = "answer"
    DEADLINE = "deadline"
    DISCONNECT = "disconnect"
    RECONNECT = "reconnect"
    BYPASS = "bypass"
    RESET = "reset"


_CONNECTED, _UNRESPONSIVE = ControllerState.CONNECTED, ControllerState.UNRESPONSIVE
_DISCONNECTED, _ABSENT, _BYPASSED = ControllerState.DISCONNECTED, ControllerState.ABSENT, ControllerState.BYPASSED

CONTROLLER_TRANSITIONS: dict[tuple[ControllerState, ControllerTrigger], ControllerState] = {
    (_CONNECTED, ControllerTrigger.ANSWER): _CONNECTED,
    (_CONNECTED, ControllerTrigger.DEADLINE): _UNRESPONSIVE,
    (_CONNECTED, ControllerTrigger.DISCONNECT): _DISCONNECTED,
    (_CONNECTED, ControllerTrigger.RESET): _CONNECTED,
    (_UNRESPONSIVE, ControllerTrigger.ANSWER): _CONNECTED,
    (_UNRESPONSIVE, ControllerTrigger.DEADLINE): _UNRESPONSIVE,
    (_UNRESPONSIVE, ControllerTrigger.DISCONNECT): _ABSENT,
    (_UNRESPONSIVE, ControllerTrigger.RESET): _CONNECTED,
    (_DISCONNECTED, ControllerTrigger.ANSWER): _DISCONNECTED,
    (_DISCONNECTED, ControllerTrigger.DEADLINE): _ABSENT,
    (_DISCONNECTED, ControllerTrigger.BYPASS): _BYPASSED,
    (_DISCONNECTED, ControllerTrigger.RECONNECT): _CONNECTED,
    (_ABSENT, ControllerTrigger.ANSWER): _DISCONNECTED,
    (_ABSENT, ControllerTrigger.DEADLINE): _ABSENT,
    (_ABSENT, ControllerTrigger.BYPASS): _BYPASSED,
    (_ABSENT, ControllerTrigger.RECONNECT): _CONNECTED,
    (_BYPASSED, ControllerTrigger.ANSWER): _BYPASSED,
    (_BYPASSED, ControllerTrigger.DEADLINE): _BYPASSED,
    (_BYPASSED, ControllerTrigger.RECONNECT): _CONNECTED,
}


class IllegalTransition(RuntimeError):
    """A trigger that is not allowed in the current state: a bug in the program, not a mistake of a peer."""
