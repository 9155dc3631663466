"""The states of a controller with a claim: the table, and what calls of the exchange can reach. No bus, no clock."""

import copy
from collections.abc import Callable

import numpy as np
import pytest
from support.builders import advance, answer, claim, command, exchange, wire

from zenostat.bridge.exchange.claims import ClaimHolder, ControllerStats
from zenostat.bridge.exchange.transitions import CONTROLLER_TRANSITIONS, ControllerTrigger, IllegalTransition
from zenostat.topics.messages import ControllerState, EventKind, Policy

CONNECTED, UNRESPONSIVE = ControllerState.CONNECTED, ControllerState.UNRESPONSIVE
DISCONNECTED, ABSENT, BYPASSED = ControllerState.DISCONNECTED, ControllerState.ABSENT, ControllerState.BYPASSED
ANSWER, DEADLINE, RESET = ControllerTrigger.ANSWER, ControllerTrigger.DEADLINE, ControllerTrigger.RESET
DISCONNECT, RECONNECT, BYPASS = ControllerTrigger.DISCONNECT, ControllerTrigger.RECONNECT, ControllerTrigger.BYPASS

# The table


def test_controller_states__table_is_that_of_the_drawing() -> None:
    """Written out by hand from the module's drawing and the sentences below it."""
    drawn = {
        CONNECTED: {ANSWER: CONNECTED, DEADLINE: UNRESPONSIVE, DISCONNECT: DISCONNECTED, RESET: CONNECTED},
        UNRESPONSIVE: {ANSWER: CONNECTED, DEADLINE: UNRESPONSIVE, DISCONNECT: ABSENT, RESET: CONNECTED},
        DISCONNECTED: {ANSWER: DISCONNECTED, DEADLINE: ABSENT, BYPASS: BYPASSED, RECONNECT: CONNECTED},
        ABSENT: {ANSWER: DISCONNECTED, DEADLINE: ABSENT, BYPASS: BYPASSED, RECONNECT: CONNECTED},
        BYPASSED: {ANSWER: BYPASSED, DEADLINE: BYPASSED, RECONNECT: CONNECTED},
    }
    assert {(state, what): to for state, row in drawn.items() for what, to in row.items()} == CONTROLLER_TRANSITIONS


@pytest.mark.parametrize("what", ControllerTrigger)
@pytest.mark.parametrize("state", ControllerState)
def test_controller_states__pair_has_a_row_or_is_illegal(state: ControllerState, what: ControllerTrigger) -> None:
    agent = ClaimHolder(
        "agent",
        10,
        np.ones(2, np.bool_),
        required=True,
        source=1,
        covers_all=True,
        stats=ControllerStats(),
        state=state,
    )
    if (state, what) in CONTROLLER_TRANSITIONS:
        assert agent.transition(what) is (CONTROLLER_TRANSITIONS[state, what] is not state)
        assert agent.state is CONTROLLER_TRANSITIONS[state, what]
        return
    with pytest.raises(IllegalTransition) as raised:
        agent.transition(what)
    for word in (state.value, what.value, "agent"):
        assert word in str(raised.value)
    assert agent.state is state


def test_controller_states__whether_it_is_connected_changes_only_where_it_leaves_or_returns() -> None:
    """No answer brings a disconnected controller back: it may have been sent before."""
    assert [state for state in ControllerState if state.is_connected] == [CONNECTED, UNRESPONSIVE]
    for (state, what), to in CONTROLLER_TRANSITIONS.items():
        assert to.is_connected == (what is RECONNECT or (state.is_connected and what is not DISCONNECT))


# By calls of the exchange


GRACE_S = 5.0


class Schedule:
    """A node with a deadline and two controllers: `guard` answers each sample, `agent` is the one of interest."""

    def __init__(self, policy: Policy) -> None:
        self.exchange = exchange()
        self.exchange.policy, self.exchange.deadline_s = policy, 2.0
        claim(self.exchange, "guard", 12)
        claim(self.exchange, "agent")

    @property
    def state(self) -> ControllerState | None:
        return next((c.state for c in self.exchange.controllers() if c.controller == "agent"), None)

    def goes_on(self) -> None:
        """Timesteps as long as nobody is waited for."""
        if self.exchange.ready_to_step():
            advance(self.exchange)

    def answers(self) -> list[EventKind]:
        answer(self.exchange, "guard", [16.0, 29.0])
        event = answer(self.exchange, "agent", [20.0, 25.0])
        self.goes_on()
        return [event.kind] if event is not None else []

    def misses_the_deadline(self) -> list[EventKind]:
        answer(self.exchange, "guard", [16.0, 29.0])
        events = self.exchange.fallback.on_deadline(0.0)
        self.goes_on()
        return [event.kind for event in events]

    def disconnects(self) -> list[EventKind]:
        return [event.kind for event in self.exchange.fallback.on_disconnect("agent", 0.0)]

    def reconnects(self) -> list[EventKind]:
        return [event.kind for event in self.exchange.fallback.on_reconnect("agent", 0.0)]

    def is_gone_for_the_grace_period(self) -> list[EventKind]:
        return [event.kind for event in self.exchange.fallback.bypass("agent", GRACE_S, GRACE_S)]

    def claims_again(self) -> list[EventKind]:
        return [event.kind for event in claim(self.exchange, "agent")]

    def begins_another_episode(self) -> list[EventKind]:
        self.exchange.reset()
        self.exchange.ready(0.0)
        return []


CALLS: dict[str, Callable[[Schedule], list[EventKind]]] = {
    "answer": Schedule.answers,
    "deadline": Schedule.misses_the_deadline,
    "disconnect": Schedule.disconnects,
    "reconnect": Schedule.reconnects,
    "grace": Schedule.is_gone_for_the_grace_period,
    "claim": Schedule.claims_again,
    "reset": Schedule.begins_another_episode,
}

EXPECTED: dict[tuple[ControllerState, str], tuple[ControllerState | None, list[EventKind]]] = {
    (CONNECTED, "answer"): (CONNECTED, []),
    (CONNECTED, "deadline"): (UNRESPONSIVE, [EventKind.FALLBACK]),
    (CONNECTED, "disconnect"): (DISCONNECTED, [EventKind.DISCONNECTED]),
    (CONNECTED, "grace"): (CONNECTED, []),
    (UNRESPONSIVE, "answer"): (CONNECTED, [EventKind.CONNECTED]),
    (UNRESPONSIVE, "deadline"): (UNRESPONSIVE, []),  # one event for each outage, not for each step
    (UNRESPONSIVE, "disconnect"): (ABSENT, [EventKind.DISCONNECTED]),
    (UNRESPONSIVE, "grace"): (UNRESPONSIVE, []),
    (DISCONNECTED, "answer"): (DISCONNECTED, []),  # sent before it disconnected
    (DISCONNECTED, "deadline"): (ABSENT, [EventKind.FALLBACK]),
    (DISCONNECTED, "disconnect"): (DISCONNECTED, []),
    (DISCONNECTED, "grace"): (BYPASSED, [EventKind.FALLBACK]),
    (ABSENT, "answer"): (DISCONNECTED, [EventKind.CONNECTED]),
    (ABSENT, "deadline"): (ABSENT, []),
    (ABSENT, "disconnect"): (ABSENT, []),
    (ABSENT, "grace"): (BYPASSED, [EventKind.FALLBACK]),
    (BYPASSED, "answer"): (BYPASSED, []),
    (BYPASSED, "deadline"): (BYPASSED, []),
    (BYPASSED, "disconnect"): (BYPASSED, []),
    (BYPASSED, "grace"): (BYPASSED, []),
    **{(s, "reconnect"): (s, []) if s.is_connected else (CONNECTED, [EventKind.CONNECTED]) for s in ControllerState},
    **{(state, "claim"): (CONNECTED, [EventKind.CONNECTED]) for state in ControllerState},
    **{(state, "reset"): (CONNECTED if state.is_connected else None, []) for state in ControllerState},
}


@pytest.mark.parametrize("policy", [Policy.HOLD, Policy.RELINQUISH])
def test_controller_states__exchange_reaches_each_state_and_takes_each_transition(policy: Policy) -> None:
    """All sequences of calls, breadth first, until no new state is reached."""
    begin = Schedule(policy)
    assert begin.state is CONNECTED
    transitions, queue = {}, [begin]
    reached = {CONNECTED}
    while queue:
        at = queue.pop(0)
        before = at.state
        assert before is not None
        for name, call in CALLS.items():
            after = copy.deepcopy(at)
            kinds = call(after)
            transitions[before, name] = (after.state, kinds)
            if after.state is not None and after.state not in reached:
                reached.add(after.state)
                queue.append(after)
    assert transitions == EXPECTED


def in_state(state: ControllerState) -> Schedule:
    """A schedule whose agent is in that state."""
    at = Schedule(Policy.HOLD)
    if state in (UNRESPONSIVE, ABSENT):
        at.misses_the_deadline()
    if not state.is_connected:
        at.disconnects()
    if state is BYPASSED:
        at.is_gone_for_the_grace_period()
    assert at.state is state
    return at


@pytest.mark.parametrize("state", ControllerState)
def test_controller_states__in_each_state_the_node_waits_for_it_or_does_not(state: ControllerState) -> None:
    """Only one that is bypassed is not waited for; any other has the whole deadline at each sample."""
    at = in_state(state)
    answer(at.exchange, "guard", [16.0, 29.0])
    assert at.exchange.ready_to_step() == (state is BYPASSED)
    assert at.exchange.awaiting() == ([] if state is BYPASSED else ["agent"])


@pytest.mark.parametrize("state", [DISCONNECTED, ABSENT, BYPASSED])
def test_controller_states__one_that_returns_is_waited_for_unless_it_has_answered(state: ControllerState) -> None:
    at = in_state(state)
    at.reconnects()
    answer(at.exchange, "guard", [16.0, 29.0])
    assert at.exchange.awaiting() == ["agent"]
    answer(at.exchange, "agent", [20.0, 25.0])
    at.disconnects()
    at.reconnects()
    assert at.exchange.awaiting() == []
    assert at.exchange.ready_to_step()


@pytest.mark.parametrize("state", ControllerState)
def test_controller_states__fast_path_serves_connected_controllers_and_the_other_path_all(
    state: ControllerState,
) -> None:
    at = in_state(state)
    payload = wire(command([20.0, 25.0], step=at.exchange.step, episode=at.exchange.episode))
    assert at.exchange.intake.accept_fast("agent", payload, 0.0) == (state is CONNECTED)
    if state is not CONNECTED:
        at.exchange.intake.receive_command("agent", payload, 0.0)
    assert at.exchange.counts.accepted == 1 + (state in (UNRESPONSIVE, ABSENT))  # the guard's answer before
