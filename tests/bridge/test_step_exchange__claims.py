"""Claims of a step exchange: who commands an actuator, and who is replaced."""

import pytest
from support.builders import NAN, advance, answer, claim, exchange
from support.exchange_checks import KEEP, RELEASE, SET, check_event, running, same

from zenostat.bridge.exchange.actuator_commands import CommandSnapshot
from zenostat.bridge.exchange.step_exchange import StepExchange
from zenostat.topics.errors import RequestRejected
from zenostat.topics.messages import ControllerState, EventKind, Write


def test_step_exchange__second_claim_on_a_level_is_refused_by_name() -> None:
    at = exchange()
    claim(at, "first", 10, actuators=["cool"])
    with pytest.raises(RequestRejected) as raised:
        claim(at, "second", 10)
    assert "priority 10 of 'cool' is claimed by 'first'" in str(raised.value)
    assert [c.controller for c in at.controllers()] == ["first"]
    assert at.awaiting() == ["first"]


@pytest.mark.parametrize(("priority", "actuators"), [(11, None), (10, ["heat"])], ids=["priority", "actuators"])
def test_claims__that_do_not_meet_are_both_taken(priority: int, actuators: list[str] | None) -> None:
    at = exchange()
    claim(at, "first", 10, actuators=["cool"])
    (event,) = claim(at, "second", priority, actuators=actuators)
    check_event(event, EventKind.CONNECTED, "second")
    assert at.awaiting() == ["first", "second"]


def test_step_exchange__unknown_actuator_is_refused_with_near_names() -> None:
    at = exchange()
    with pytest.raises(RequestRejected, match=r"no actuator 'coool'; did you mean 'cool'"):
        claim(at, "a", actuators=["coool"])
    assert at.controllers() == []


def test_step_exchange__lower_level_rules_and_falls_back_on_release() -> None:
    at = exchange()
    claim(at, "agent", 10)
    claim(at, "guard", 5)
    answer(at, "agent", [20.0, 25.0])
    answer(at, "guard", [16.0, 0.0], [SET, KEEP])
    assert advance(at) == ([16.0, 25.0], ["guard", "agent"])
    answer(at, "agent", [21.0, 26.0])
    answer(at, "guard", [0.0, 0.0], [RELEASE, RELEASE])
    assert advance(at) == ([21.0, 26.0], ["agent", "agent"])


def test_step_exchange__one_that_has_gone_is_waited_for_until_it_is_back() -> None:
    # node@0 -> agent@0 -> node@1 -> agent leaves -> (waits) -> agent is back -> agent@1 -> node@2
    at = exchange()
    claim(at, "agent")
    answer(at, "agent", [20.0, 25.0])
    advance(at)
    (event,) = at.fallback.on_disconnect("agent", 0.0)
    check_event(event, EventKind.DISCONNECTED, "agent", "waits")
    assert not at.ready_to_step()
    assert at.awaiting() == ["agent"]
    assert [c.state for c in at.controllers()] == [ControllerState.DISCONNECTED]
    assert at.fallback.on_disconnect("agent", 0.0) == []
    claim(at, "agent")
    assert [(c.state, c.accepted) for c in at.controllers()] == [(ControllerState.CONNECTED, 1)]
    assert not at.ready_to_step()
    answer(at, "agent", [21.0, 26.0])
    assert advance(at) == ([21.0, 26.0], ["agent", "agent"])


def test_step_exchange__event_of_a_claim_has_its_priority_where_that_is_new() -> None:
    at = exchange()
    texts = [claim(at, "agent", priority)[-1].text for priority in (10, 10, 5)]
    assert texts == ["agent controls at priority 10", "agent controls again", "agent controls at priority 5"]


def test_step_exchange__one_that_was_never_there_cannot_leave() -> None:
    at = exchange()
    assert at.fallback.on_disconnect("nobody", 0.0) == []


def test_step_exchange__one_that_has_gone_is_replaced_at_its_level() -> None:
    # agent@0 -> node@1 -> agent leaves -> other takes over -> other@1 -> node@2 -> agent comes back: refused
    at = exchange()
    claim(at, "agent")
    answer(at, "agent", [20.0, 25.0])
    advance(at)
    at.fallback.on_disconnect("agent", 0.0)
    gone, joined = claim(at, "other")
    check_event(gone, EventKind.DISCONNECTED, "other takes over from agent")
    check_event(joined, EventKind.CONNECTED, "other")
    assert at.awaiting() == ["other"]
    assert answer(at, "other", [16.0, 29.0]) is None
    assert advance(at) == ([16.0, 29.0], ["other", "other"])
    with pytest.raises(RequestRejected, match="claimed by 'other'"):
        claim(at, "agent")
    check_event(answer(at, "agent", [20.0, 25.0]), EventKind.REJECTED, "'agent' has claimed nothing")


def test_step_exchange__one_that_has_gone_at_another_level_is_not_replaced() -> None:
    at = exchange()
    claim(at, "agent", 10)
    at.fallback.on_disconnect("agent", 0.0)
    claim(at, "other", 11)
    answer(at, "other", [16.0, 29.0])
    assert at.awaiting() == ["agent"]
    assert not at.ready_to_step()


def test_step_exchange__what_one_set_that_was_replaced_does_not_outlive_it() -> None:
    # The new one claims `heat` only: nobody is left who could release `cool`.
    at = exchange()
    claim(at, "agent")
    answer(at, "agent", [20.0, 25.0])
    advance(at)
    at.fallback.on_disconnect("agent", 0.0)
    claim(at, "other", actuators=["heat"])
    answer(at, "other", [16.0, 0.0], [SET, KEEP])
    values, sources = advance(at)
    assert same(values, [16.0, NAN])
    assert sources == ["other", ""]


def test_step_exchange__what_was_set_at_a_level_does_not_outlive_the_claim_on_it() -> None:
    # The agent moves from level 10 to 12 and releases all: nobody is left who could release level 10.
    at = exchange()
    claim(at, "agent", 10)
    answer(at, "agent", [20.0, 25.0])
    advance(at)
    claim(at, "agent", 12)
    answer(at, "agent", [0.0, 0.0], [RELEASE, RELEASE])
    values, sources = advance(at)
    assert same(values, [NAN, NAN])
    assert sources == ["", ""]


def test_step_exchange__one_that_claims_again_answers_again() -> None:
    at = exchange()
    claim(at, "agent")
    answer(at, "agent", [20.0, 25.0])
    (event,) = claim(at, "agent")
    check_event(event, EventKind.CONNECTED, "again")
    assert not at.ready_to_step()
    assert answer(at, "agent", [21.0, 26.0]) is None
    assert advance(at) == ([21.0, 26.0], ["agent", "agent"])


def test_step_exchange__one_that_joins_within_an_episode_is_waited_for_at_once() -> None:
    at = running()
    answer(at, "agent", [20.0, 25.0])
    claim(at, "late-comer", 11)
    assert not at.ready_to_step()
    assert at.awaiting() == ["late-comer"]


def test_step_exchange__status_tells_of_each_claim() -> None:
    at = running()
    rows = [(c.controller, c.priority, c.actuators, c.required, c.state, c.accepted) for c in at.controllers()]
    assert rows == [
        ("agent", 10, 2, True, ControllerState.CONNECTED, 2),
        ("helper", 9, 1, False, ControllerState.CONNECTED, 0),
    ]


def check(at: StepExchange, values: list[float], sources: list[str]) -> None:
    present, present_sources = advance(at)
    assert same(present, values)
    assert present_sources == sources


def _return_to(at: StepExchange, snapshot: CommandSnapshot, step: int) -> None:
    at.reset()
    at.ready(0.0, {0: step}, snapshot)


def test_return__to_a_snapshot_relinquishes_what_a_controller_that_has_left_had_set() -> None:
    at = exchange()
    claim(at, "agent", 10)
    at.intake.write("heat", Write(value=18.0, priority=12, source="operator"), 0.0)
    answer(at, "agent", [20.0, 25.0])
    advance(at)
    snapshot = at.capture()
    claim(at, "other", 11)
    at.fallback.on_disconnect("agent", 0.0)
    _return_to(at, snapshot, 1)
    answer(at, "other", [0.0, 0.0], [KEEP, KEEP])
    check(at, [18.0, NAN], ["operator", ""])


def test_return__to_a_snapshot_keeps_what_a_controller_with_the_same_claim_had_set() -> None:
    at = exchange()
    claim(at, "agent", 10)
    claim(at, "guard", 5)
    answer(at, "guard", [16.0, 0.0], [SET, KEEP])
    answer(at, "agent", [20.0, 25.0])
    advance(at)
    snapshot = at.capture()
    claim(at, "guard", 4)  # at another priority: its former value has nobody who would relinquish it
    answer(at, "guard", [0.0, 0.0], [KEEP, KEEP])
    answer(at, "agent", [21.0, 26.0])
    assert advance(at) == ([21.0, 26.0], ["agent", "agent"])
    _return_to(at, snapshot, 1)
    for name in ("agent", "guard"):
        answer(at, name, [0.0, 0.0], [KEEP, KEEP])
    assert advance(at) == ([20.0, 25.0], ["agent", "agent"])


def test_return__to_a_snapshot_leaves_values_to_the_controller_that_has_taken_over() -> None:
    at = exchange()
    claim(at, "agent", 10)
    answer(at, "agent", [20.0, 25.0])
    advance(at)
    snapshot = at.capture()
    at.fallback.on_disconnect("agent", 0.0)
    claim(at, "spare", 10, actuators=["cool"])
    for _ in range(2):
        _return_to(at, snapshot, 1)
        answer(at, "spare", [0.0, 0.0], [KEEP, KEEP])
        check(at, [NAN, 25.0], ["", "agent"])
        snapshot = at.capture()
    claim(at, "spare", 11)  # and it relinquishes them like its own
    answer(at, "spare", [0.0, 0.0], [KEEP, KEEP])
    check(at, [NAN, NAN], ["", ""])
