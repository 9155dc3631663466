"""Without a controller, as schedules: who was there when, what ruled, and what was told. No bus, no clock."""

import pytest
from support.builders import NAN, advance, answer, claim, command, wire
from support.fallback_exchanges import (
    GO_ON,
    KEEP,
    SET,
    both,
    check_ruled,
    disconnect,
    expected_under,
    kinds_and_sources,
    node,
    state,
    status,
    with_agent,
    with_two,
)

from zenostat.bridge.exchange.step_exchange import MAX_MESSAGES_PER_STEP, Trigger
from zenostat.topics.errors import EpisodeAborted
from zenostat.topics.messages import Command, ControllerState, EventKind, Mode, Policy, State

# Gone


@pytest.mark.parametrize("policy", [Policy.WAIT, *GO_ON])
def test_step_exchange__policy_begins_when_the_time_of_grace_is_over(policy: Policy) -> None:
    """agent@0 → node@1 → agent gone at 2 s → 5 s of grace → policy"""
    at = with_agent(policy)
    (event,) = at.fallback.on_disconnect("agent", 2.0)
    assert event.kind is EventKind.DISCONNECTED
    assert ("waits for it" in event.text) == (policy is Policy.WAIT)
    assert at.fallback.bypass("agent", 6.9, 5.0) == []
    assert not at.ready_to_step()
    events = at.fallback.bypass("agent", 7.0, 5.0)
    if policy is Policy.WAIT:
        assert events == []
        assert not at.ready_to_step()
        assert at.awaiting() == ["agent"]
        assert state(at, "agent") is ControllerState.DISCONNECTED
        return
    assert kinds_and_sources(events) == [(EventKind.FALLBACK, "agent")]
    assert ("stay in effect" if policy is Policy.HOLD else "are relinquished") in events[0].text
    assert state(at, "agent") is ControllerState.BYPASSED
    for _ in range(3):
        check_ruled(at, expected_under(policy), now_s=7.0, fallback=True)
    assert at.fallback.bypass("agent", 7.0, 5.0) == []


def test_step_exchange__abort_raises_when_the_time_of_grace_is_over() -> None:
    at = with_agent(Policy.ABORT)
    at.fallback.on_disconnect("agent", 2.0)
    assert at.fallback.bypass("agent", 6.0, 5.0) == []
    with pytest.raises(EpisodeAborted, match="agent disconnected"):
        at.fallback.bypass("agent", 7.0, 5.0)


@pytest.mark.parametrize("policy", Policy)
def test_step_exchange__one_that_is_back_within_the_time_of_grace_goes_on_as_if_nothing_was(policy: Policy) -> None:
    at = with_agent(policy)
    at.fallback.on_disconnect("agent", 2.0)
    assert kinds_and_sources(claim(at, "agent", now_s=4.0)) == [(EventKind.CONNECTED, "agent")]
    assert at.fallback.bypass("agent", 7.0, 5.0) == []
    assert at.awaiting() == ["agent"]
    assert answer(at, "agent", [21.0, 26.0], now_s=7.0) is None
    check_ruled(at, ([21.0, 26.0], ["agent", "agent"]), now_s=7.0, fallback=False)
    assert at.counts.missed == status(at, "agent").missed == 0


@pytest.mark.parametrize("policy", [*GO_ON, Policy.ABORT])
def test_step_exchange__one_that_leaves_again_has_its_time_of_grace_again(policy: Policy) -> None:
    """gone at 2 s → back at 4 s → gone at 6 s → the first grace ends at 7 s, the second at 11 s"""
    at = with_agent(policy)
    at.fallback.on_disconnect("agent", 2.0)
    claim(at, "agent", now_s=4.0)
    at.fallback.on_disconnect("agent", 6.0)
    assert at.fallback.bypass("agent", 7.0, 5.0) == []
    assert not at.ready_to_step()
    if policy is Policy.ABORT:
        with pytest.raises(EpisodeAborted):
            at.fallback.bypass("agent", 11.0, 5.0)
    else:
        assert kinds_and_sources(at.fallback.bypass("agent", 11.0, 5.0)) == [(EventKind.FALLBACK, "agent")]


@pytest.mark.parametrize("policy", GO_ON)
def test_step_exchange__one_that_is_back_later_resumes_at_the_present_step(policy: Policy) -> None:
    """agent@0 → node@1 → gone → node@2 → node@3 → agent is back → agent@3 → node@4"""
    at = with_agent(policy)
    disconnect(at, "agent")
    flags = [at.fallback_active]
    for _ in range(2):
        check_ruled(at, expected_under(policy))
        flags.append(at.fallback_active)
    claim(at, "agent")
    assert not at.ready_to_step()
    assert state(at, "agent") is ControllerState.CONNECTED
    assert answer(at, "agent", [21.0, 26.0]) is None
    check_ruled(at, ([21.0, 26.0], ["agent", "agent"]))
    flags.append(at.fallback_active)
    assert flags == [False, True, True, False]
    assert (at.step, at.counts.missed, status(at, "agent").missed) == ([4], 2, 2)


@pytest.mark.parametrize("policy", GO_ON)
def test_step_exchange__one_that_is_back_before_the_step_goes_on_has_missed_nothing(policy: Policy) -> None:
    """heater gone and waived at sample 1, while the cooler still thinks; the heater is back and answers sample 1"""
    at = with_two(policy)
    disconnect(at, "heater")
    assert at.awaiting() == ["cooler"]
    claim(at, "heater", actuators=["heat"])
    both(at, 21.0, 26.0)
    check_ruled(at, ([21.0, 26.0], ["heater", "cooler"]), fallback=False)
    assert at.counts.missed == status(at, "heater").missed == 0


@pytest.mark.parametrize("policy", GO_ON)
def test_step_exchange__one_that_leaves_after_its_answer(policy: Policy) -> None:
    """Held, its answer rules the timestep that it was for, which is no fallback; released, it does not."""
    at = with_two(policy)
    answer(at, "heater", [21.0, 0.0], [SET, KEEP])
    disconnect(at, "heater")
    answer(at, "cooler", [0.0, 26.0], [KEEP, SET])
    if policy is Policy.HOLD:
        check_ruled(at, ([21.0, 26.0], ["heater", "cooler"]), fallback=False)
    else:
        check_ruled(at, ([NAN, 26.0], ["", "cooler"]), fallback=True)
    answer(at, "cooler", [0.0, 27.0], [KEEP, SET])
    advance(at)
    assert at.fallback_active
    assert status(at, "cooler").missed == 0


def test_step_exchange__released_falls_to_the_next_level() -> None:
    """agent@10 over guard@12: the agent goes, and the guard's command rules."""
    at = node(Policy.RELINQUISH)
    claim(at, "agent", 10)
    claim(at, "guard", 12)
    answer(at, "agent", [20.0, 25.0])
    answer(at, "guard", [16.0, 29.0])
    check_ruled(at, ([20.0, 25.0], ["agent", "agent"]))
    disconnect(at, "agent", 0.0)
    answer(at, "guard", [16.0, 29.0])
    check_ruled(at, ([16.0, 29.0], ["guard", "guard"]))


@pytest.mark.parametrize("deadline_s", [None, 5.0])
def test_step_exchange__others_are_not_held_up_by_one_that_is_waived(deadline_s: float | None) -> None:
    """The cooler has answered already when the heater is waived: the step goes on at once."""
    at = with_two(Policy.HOLD, deadline_s)
    answer(at, "cooler", [0.0, 26.0], [KEEP, SET])
    at.fallback.on_disconnect("heater", 1.0)
    assert not at.ready_to_step()
    at.fallback.bypass("heater", 1.0)
    check_ruled(at, ([20.0, 26.0], ["heater", "cooler"]))
    assert at.awaiting() == ["cooler"]


def test_step_exchange__with_nobody_there_and_no_deadline_the_episode_runs_through() -> None:
    at = with_agent(Policy.HOLD)
    disconnect(at, "agent")
    for _ in range(20):
        check_ruled(at, expected_under(Policy.HOLD))
    assert at.counts.missed == status(at, "agent").missed == 20


@pytest.mark.parametrize("policy", GO_ON)
def test_step_exchange__with_nobody_there_the_deadline_sets_the_pace(policy: Policy) -> None:
    at = with_agent(policy, 2.0)
    disconnect(at, "agent")
    for k in range(1, 4):
        assert not at.ready_to_step(), f"at sample {k}"
        assert at.fallback.on_deadline(1.0) == []  # it was told that the agent has gone
        check_ruled(at, expected_under(policy), fallback=True)
    assert at.counts.missed == status(at, "agent").missed == 3


def test_step_exchange__with_two_gone_the_deadline_sets_the_pace() -> None:
    at = with_two(Policy.HOLD, 2.0)
    for name in ("heater", "cooler"):
        disconnect(at, name)
    assert not at.ready_to_step()
    at.fallback.on_deadline(1.0)
    check_ruled(at, ([20.0, 25.0], ["heater", "cooler"]))
    assert (at.counts.missed, status(at, "heater").missed, status(at, "cooler").missed) == (1, 1, 1)


@pytest.mark.parametrize("policy", Policy)
def test_step_exchange__nothing_goes_on_where_nobody_ever_claimed(policy: Policy) -> None:
    at = node(policy, 2.0)
    assert at.fallback.on_deadline(0.0) == []
    assert not at.ready_to_step()


@pytest.mark.parametrize("policy", [*GO_ON, Policy.ABORT])
def test_disconnection__after_the_end_is_no_fallback_and_aborts_nothing(policy: Policy) -> None:
    at = with_agent(policy)
    answer(at, "agent", [20.0, 25.0])
    advance(at, last=True)
    at.fallback.on_disconnect("agent", 1.0)
    assert at.fallback.bypass("agent", 1.0) == []
    assert at.state is State.ENDED


def test_new_episode__forgets_bypassed_and_late_controllers() -> None:
    at = with_two(Policy.HOLD, 2.0)
    disconnect(at, "heater")
    at.fallback.on_deadline(1.0)
    advance(at)
    assert state(at, "cooler") is ControllerState.UNRESPONSIVE
    at.reset()
    at.ready(1.0)
    assert [(c.controller, c.state) for c in at.controllers()] == [("cooler", ControllerState.CONNECTED)]
    assert answer(at, "cooler", [0.0, 26.0], [KEEP, SET]) is None
    check_ruled(at, ([NAN, 26.0], ["", "cooler"]), fallback=False)


def test_step_exchange__after_an_abort_a_reset_begins_anew() -> None:
    at = with_two(Policy.ABORT, 2.0)
    answer(at, "cooler", [0.0, 26.0], [KEEP, SET])
    with pytest.raises(EpisodeAborted, match=r"^heater sent no command within 2 s$"):
        at.fallback.on_deadline(1.0)
    at.transition(Trigger.FAIL)
    late = answer(at, "heater", [21.0, 0.0], [SET, KEEP])
    assert late.kind is EventKind.REJECTED
    at.reset()
    at.ready(1.0)
    assert at.awaiting() == ["cooler", "heater"]
    both(at, 21.0, 26.0)
    check_ruled(at, ([21.0, 26.0], ["heater", "cooler"]))


# Silent


@pytest.mark.parametrize("policy", GO_ON)
def test_step_exchange__one_that_is_silent_beyond_the_deadline(policy: Policy) -> None:
    """node@1 at 1 s → silent → 3 s: policy → node@2 → silent → 5 s → node@3: told once, missed twice"""
    at = with_agent(policy, 2.0)
    events = at.fallback.on_deadline(3.0)
    assert kinds_and_sources(events) == [(EventKind.FALLBACK, "agent")]
    assert "no command within 2 s" in events[0].text
    assert state(at, "agent") is ControllerState.UNRESPONSIVE
    check_ruled(at, expected_under(policy), now_s=3.0, fallback=True)
    assert not at.ready_to_step()
    assert at.fallback.on_deadline(5.0) == []
    check_ruled(at, expected_under(policy), now_s=5.0)
    assert (at.counts.missed, status(at, "agent").missed, at.counts.late) == (2, 2, 0)


@pytest.mark.parametrize("policy", GO_ON)
def test_step_exchange__one_that_was_silent_and_answers_again(policy: Policy) -> None:
    at = with_agent(policy, 2.0)
    at.fallback.on_deadline(3.0)
    advance(at, now_s=3.0)
    payload = wire(command([21.0, 26.0], step=2))
    assert not at.intake.accept_fast("agent", payload, 4.0)  # its return is told
    event = at.intake.receive_command("agent", payload, 4.0)
    assert (event.kind, event.source, event.late_s) == (EventKind.CONNECTED, "agent", None)
    check_ruled(at, ([21.0, 26.0], ["agent", "agent"]), now_s=4.0, fallback=False)
    assert state(at, "agent") is ControllerState.CONNECTED
    assert at.intake.accept_fast("agent", wire(command([21.5, 26.5], step=3)), 4.0)


@pytest.mark.parametrize("policy", Policy)
def test_step_exchange__one_that_answers_in_time_meets_no_policy(policy: Policy) -> None:
    at = with_agent(policy, 2.0)
    assert at.intake.accept_fast("agent", wire(command([21.0, 26.0], step=1)), 1.0)
    assert at.fallback.on_deadline(1.0) == []
    check_ruled(at, ([21.0, 26.0], ["agent", "agent"]), fallback=False)
    assert at.counts.late == at.counts.missed == 0


def test_step_exchange__waiting_takes_a_late_command_and_states_how_late() -> None:
    """node@1 at 1 s → 3 s: deadline → agent@1 at 4.5 s: taken, 1.5 s late"""
    at = with_agent(Policy.WAIT, 2.0)
    assert at.fallback.on_deadline(3.0) == []
    assert not at.ready_to_step()
    payload = wire(command([21.0, 26.0], step=1))
    assert not at.intake.accept_fast("agent", payload, 4.5)
    event = at.intake.receive_command("agent", payload, 4.5)
    assert (event.kind, event.late_s) == (EventKind.ACCEPTED_LATE, 1.5)
    assert "accepted after the deadline" in event.text
    check_ruled(at, ([21.0, 26.0], ["agent", "agent"]), now_s=4.5, fallback=False)
    agent = status(at, "agent")
    assert (agent.accepted, agent.accepted_late, agent.late, agent.missed) == (2, 1, 0, 0)
    assert (at.counts.accepted_late, at.counts.late) == (1, 0)
    assert at.intake.accept_fast("agent", wire(command([21.0, 26.0], step=2)), 4.5)  # the next one is usual again


def test_claim__after_the_deadline_is_not_late() -> None:
    at = with_agent(Policy.WAIT, 2.0)
    at.fallback.on_deadline(3.0)
    claim(at, "guard", 5, now_s=9.0)
    assert answer(at, "guard", [16.0, 29.0], now_s=9.5) is None
    assert status(at, "guard").accepted_late == 0
    assert status(at, "guard").response.max_ms == pytest.approx(500.0)


@pytest.mark.parametrize("policy", [*GO_ON, Policy.ABORT])
def test_step_exchange__of_two_the_one_that_answered_is_not_blamed(policy: Policy) -> None:
    at = with_two(policy, 2.0)
    answer(at, "cooler", [0.0, 26.0], [KEEP, SET])
    if policy is Policy.ABORT:
        with pytest.raises(EpisodeAborted, match=r"^heater sent no command within 2 s$"):
            at.fallback.on_deadline(3.0)
        return
    assert kinds_and_sources(at.fallback.on_deadline(3.0)) == [(EventKind.FALLBACK, "heater")]
    held = policy is Policy.HOLD
    check_ruled(at, ([20.0 if held else NAN, 26.0], ["heater" if held else "", "cooler"]), now_s=3.0, fallback=True)
    assert at.awaiting() == ["cooler", "heater"]
    assert [(c.controller, c.state, c.missed) for c in at.controllers()] == [
        ("heater", ControllerState.UNRESPONSIVE, 1),
        ("cooler", ControllerState.CONNECTED, 0),
    ]


# Controllers that are not waited for


@pytest.mark.parametrize("policy", Policy)
def test_step_exchange__one_that_is_not_required_stops_nothing_by_leaving(policy: Policy) -> None:
    at = node(policy)
    claim(at, "agent", 10)
    claim(at, "helper", 9, actuators=["cool"], required=False)
    answer(at, "helper", [0.0, 28.0], [KEEP, SET])
    answer(at, "agent", [20.0, 25.0])
    check_ruled(at, ([20.0, 28.0], ["agent", "helper"]))
    (left,) = at.fallback.on_disconnect("helper", 0.0)
    assert "waits" not in left.text
    events = at.fallback.bypass("helper", 0.0)
    assert kinds_and_sources(events) == ([] if policy is Policy.WAIT else [(EventKind.FALLBACK, "helper")])
    answer(at, "agent", [20.0, 25.0])
    relinquished = policy is Policy.RELINQUISH
    check_ruled(
        at, ([20.0, 25.0 if relinquished else 28.0], ["agent", "agent" if relinquished else "helper"]), fallback=False
    )
    assert at.counts.missed == status(at, "helper").missed == 0


@pytest.mark.parametrize("policy", Policy)
def test_step_exchange__one_that_is_not_required_has_no_deadline(policy: Policy) -> None:
    at = node(policy, 2.0)
    claim(at, "agent", 10)
    claim(at, "helper", 9, required=False)
    answer(at, "agent", [20.0, 25.0])
    assert at.fallback.on_deadline(0.0) == []
    check_ruled(at, ([20.0, 25.0], ["agent", "agent"]), fallback=False)


# Time that runs by itself


@pytest.mark.parametrize("mode", [Mode.FREE, Mode.PACED])
@pytest.mark.parametrize("policy", GO_ON)
def test_step_exchange__where_time_runs_by_itself_the_policy_states_what_becomes_of_commands(
    policy: Policy, mode: Mode
) -> None:
    at = with_agent(policy, mode=mode)
    check_ruled(at, ([20.0, 25.0], ["agent", "agent"]))  # not answered in time, and there: no fallback
    assert not at.fallback_active
    at.fallback.on_disconnect("agent", 1.0)
    check_ruled(at, ([20.0, 25.0], ["agent", "agent"]), fallback=False)
    assert kinds_and_sources(at.fallback.bypass("agent", 1.0)) == [(EventKind.FALLBACK, "agent")]
    check_ruled(at, expected_under(policy), fallback=True)
    claim(at, "agent")
    answer(at, "agent", [21.0, 26.0])
    check_ruled(at, ([21.0, 26.0], ["agent", "agent"]), fallback=False)
    assert at.counts.missed == status(at, "agent").missed == 1


@pytest.mark.parametrize("mode", [Mode.FREE, Mode.PACED])
def test_step_exchange__where_time_runs_by_itself_one_that_is_there_misses_nothing(mode: Mode) -> None:
    """The heater has gone; the cooler is there and lets what it commanded hold."""
    at = with_two(Policy.HOLD)
    at.mode = mode
    disconnect(at, "heater")
    check_ruled(at, ([20.0, 25.0], ["heater", "cooler"]))
    assert (status(at, "heater").missed, status(at, "cooler").missed, at.counts.missed) == (1, 0, 1)


@pytest.mark.parametrize("mode", [Mode.FREE, Mode.PACED])
def test_step_exchange__where_time_runs_by_itself_abort_ends_the_episode_of_one_that_has_gone(mode: Mode) -> None:
    at = with_agent(Policy.ABORT, mode=mode)
    with pytest.raises(EpisodeAborted):
        disconnect(at, "agent")


@pytest.mark.parametrize("mode", [Mode.FREE, Mode.PACED])
def test_step_exchange__where_time_runs_by_itself_a_late_command_states_how_late(mode: Mode) -> None:
    """node@2 at 4 s; agent@1 comes at 4.25 s"""
    at = with_agent(Policy.WAIT, mode=mode)
    advance(at, now_s=4.0)
    event = at.intake.receive_command("agent", wire(command([22.0, 29.0], step=1)), 4.25)
    assert (event.kind, event.late_s) == (EventKind.LATE, 0.25)
    check_ruled(at, ([20.0, 25.0], ["agent", "agent"]), now_s=4.25)


# Slots


@pytest.mark.parametrize("policy", GO_ON)
def test_step_exchange__all_slots_go_on_without_one_that_is_silent(policy: Policy) -> None:
    at = node(policy, 2.0, slots=2)
    claim(at, "agent")
    values = [20.0, 25.0, 21.0, 26.0]
    assert at.intake.command("agent", command(values, step=at.step, episode=at.episode), 0.0) is None
    check_ruled(at, (values, ["agent"] * 4))
    at.fallback.on_deadline(0.0)
    held = policy is Policy.HOLD
    check_ruled(at, (values if held else [NAN] * 4, ["agent" if held else ""] * 4))
    assert at.step == [2, 2]
    assert at.fallback_active


def test_step_exchange__slot_that_is_over_stays_so_while_the_policy_goes_on() -> None:
    at = node(Policy.HOLD, 2.0, slots=2)
    claim(at, "agent")
    at.intake.command("agent", command([20.0, 25.0] * 2, step=at.step, episode=at.episode), 0.0)
    at.begin_step(0.0)
    at.finish_step([True, False], 0.0)
    at.fallback.on_deadline(0.0)
    at.begin_step(0.0)
    assert [*at.active_slots] == [1]
    at.finish_step([False], 0.0)
    assert (at.step, at.done) == ([1, 2], [True, False])


# Floods


def test_step_exchange__flood_is_passed_over_and_the_others_are_served() -> None:
    at = with_two(Policy.WAIT)
    wrong = wire(command([99.0, 0.0], step=1, operations=[SET, KEEP]))
    events = [at.intake.receive_command("heater", wrong, 1.0) for _ in range(MAX_MESSAGES_PER_STEP + 50)]
    assert sum(event is not None for event in events) == MAX_MESSAGES_PER_STEP
    assert events[MAX_MESSAGES_PER_STEP:] == [None] * 50
    assert (at.counts.rate_limited, at.counts.rejected, status(at, "heater").rejected) == (
        50,
        MAX_MESSAGES_PER_STEP,
        MAX_MESSAGES_PER_STEP,
    )
    assert at.intake.receive_command("cooler", wire(command([0.0, 26.0], step=1, operations=[KEEP, SET])), 1.0) is None
    assert at.awaiting() == ["heater"]


@pytest.mark.parametrize(
    "wrong",
    [
        command([99.0, 0.0], step=1, operations=[SET, KEEP]),
        command([20.0, 0.0], step=0, operations=[SET, KEEP]),
        command([20.0, 25.0], step=1, operations=[SET, SET]),
        command([20.0, 0.0], step=[None], operations=[SET, KEEP]),
        command([20.0] * 2_000, step=1, operations=[KEEP] * 2_000),
    ],
    ids=["out_of_bounds", "over", "unclaimed", "no_slot", "too_large"],
)
def test_step_exchange__answer_that_the_step_waits_for_is_accepted_after_a_flood(wrong: Command) -> None:
    at = with_two(Policy.WAIT)
    for _ in range(MAX_MESSAGES_PER_STEP + 50):
        at.intake.receive_command("heater", wire(wrong), 1.0)
    assert (at.counts.rate_limited, "heater" in at.awaiting()) == (50, True)
    right = wire(command([21.0, 0.0], step=1, operations=[SET, KEEP]))
    assert at.intake.receive_command("heater", right, 1.0) is None
    assert at.awaiting() == ["cooler"]
    assert (at.counts.rate_limited, status(at, "heater").accepted) == (50, 2)
    assert at.intake.receive_command("heater", right, 1.0) is None
    assert at.counts.rate_limited == 51, "it has answered"


def test_step_exchange__flood_does_not_stop_a_usual_command_and_ends_with_the_step() -> None:
    at = with_agent(Policy.WAIT)
    for _ in range(MAX_MESSAGES_PER_STEP + 1):
        at.intake.receive_command("agent", b"", 1.0)
    assert at.intake.accept_fast("agent", wire(command([21.0, 26.0], step=1)), 1.0)
    advance(at)
    assert at.intake.receive_command("agent", b"", 1.0) is not None
    assert at.counts.rate_limited == 1


def test_step_exchange__strangers_of_many_names_are_one_flood() -> None:
    at = with_agent(Policy.WAIT)
    events = [at.intake.receive_command(f"stranger-{k}", b"", 1.0) for k in range(MAX_MESSAGES_PER_STEP + 900)]
    assert sum(event is not None for event in events) == MAX_MESSAGES_PER_STEP
    assert at.counts.rate_limited == 900
    assert at.intake.receive_command("agent", wire(command([21.0, 26.0], step=1)), 1.0) is None
    assert at.ready_to_step()


# Counts


def test_step_exchange__responses_are_counted_from_the_sample_or_from_the_claim() -> None:
    """joined 100 s after sample 0, answers 0.25 s later; sample 1 at 101 s, answered at 101.5 s"""
    at = node(Policy.WAIT)
    claim(at, "agent", now_s=100.0)
    answer(at, "agent", [20.0, 25.0], now_s=100.25)
    advance(at, now_s=101.0)
    assert at.intake.accept_fast("agent", wire(command([20.0, 25.0], step=1)), 101.5)
    response = status(at, "agent").response
    assert (response.count, response.median_ms, response.max_ms) == (2, 250.0, 500.0)


def test_step_exchange__controller_that_is_back_keeps_its_counts() -> None:
    at = with_agent(Policy.HOLD, 2.0)
    at.intake.receive_command("agent", b"", 1.0)
    at.fallback.on_deadline(1.0)
    advance(at)
    at.intake.receive_command("agent", wire(command([22.0, 29.0], step=1)), 1.0)
    at.fallback.on_disconnect("agent", 1.0)
    claim(at, "agent")
    answer(at, "agent", [20.0, 25.0])
    answer(at, "agent", [20.0, 25.0])
    agent = status(at, "agent")
    assert (agent.accepted, agent.rejected, agent.late, agent.duplicate, agent.missed) == (2, 1, 1, 1, 1)
