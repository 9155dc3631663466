"""The step exchange as schedules: who spoke when, and what ruled. No bus, no EnergyPlus, no clock."""

import math

import pytest
from support.builders import NAN, actuator, advance, answer, claim, command, exchange, ruling, wire
from support.exchange_checks import KEEP, RELEASE, SET, check_event, running, same, unchanged

from zenostat.bridge.exchange.step_exchange import TRANSITIONS, IllegalTransition, StepExchange, Trigger
from zenostat.bridge.node.planning import require_episodes
from zenostat.topics.errors import RequestRejected
from zenostat.topics.messages import Command, EventKind, Mode, State, Write

# The table


PAIRS = [(state, what) for state in State for what in Trigger]


@pytest.mark.parametrize(("state", "what"), PAIRS, ids=lambda p: p.value)
def test_step_exchange__pair_has_a_row_or_is_illegal(state: State, what: Trigger) -> None:
    at = StepExchange((), state=state)
    if (state, what) in TRANSITIONS:
        at.transition(what)
        assert at.state is TRANSITIONS[state, what]
        return
    with pytest.raises(IllegalTransition) as raised:
        at.transition(what)
    assert state.value in str(raised.value)
    assert what.value in str(raised.value)
    assert at.state is state


def test_step_exchange__table_is_that_of_the_drawing() -> None:
    """Written out by hand from the module's drawing: each state, what may happen, where it leads."""
    drawn = {
        State.STARTING: {Trigger.READY: State.WAITING, Trigger.FAIL: State.FAILED, Trigger.STOP: State.STOPPED},
        State.WAITING: {
            Trigger.GO: State.RUNNING, Trigger.RESET: State.STARTING, Trigger.FAIL: State.FAILED,
            Trigger.STOP: State.STOPPED,
        },
        State.RUNNING: {
            Trigger.SAMPLED: State.WAITING, Trigger.ENDED: State.ENDED, Trigger.FAIL: State.FAILED,
            Trigger.STOP: State.STOPPED,
        },
        State.ENDED: {Trigger.RESET: State.STARTING, Trigger.STOP: State.STOPPED},
        State.FAILED: {Trigger.RESET: State.STARTING, Trigger.STOP: State.STOPPED},
        State.STOPPED: {},
    }  # fmt: skip
    assert {(state, what): to for state, row in drawn.items() for what, to in row.items()} == TRANSITIONS


def test_step_exchange__illegal_call_changes_nothing() -> None:
    at, other = exchange(), exchange()
    other.intake.write("heat", Write(value=20.0), 0.0)
    captured = other.capture()
    for call in (lambda: at.finish_step([False], 0.0), lambda: at.ready(0.0), lambda: at.ready(0.0, commands=captured)):
        with pytest.raises(IllegalTransition):
            call()
    assert (at.state, at.step) == (State.WAITING, [0])
    assert same(ruling(at)[0], [NAN, NAN])
    claim(at, "a")
    answer(at, "a", [20.0, 25.0])
    at.begin_step(0.0)
    for call in (lambda: at.begin_step(0.0), at.reset, lambda: at.ready(0.0)):
        with pytest.raises(IllegalTransition):
            call()
    assert (at.state, at.step, at.episode) == (State.RUNNING, [0], [0])


# Lockstep


@pytest.mark.parametrize("steps", [1, 2, 24])
def test_step_exchange__episode_of_n_timesteps_has_n_commands_and_n_plus_1_samples(steps: int) -> None:
    # node@0 -> agent@0 -> node@1 -> agent@1 -> ... -> node@N
    at = exchange()
    claim(at, "agent")
    samples, applied = [at.step[0]], []
    while at.state is State.WAITING:
        k = at.step[0]
        assert answer(at, "agent", [20.0, 25.0 + k / 100]) is None
        applied.append(advance(at, last=k + 1 == steps))
        samples.append(at.step[0])
    assert samples == list(range(steps + 1))
    assert applied == [([20.0, 25.0 + k / 100], ["agent", "agent"]) for k in range(steps)]
    assert at.counts.accepted == steps
    assert at.state is State.ENDED
    assert not at.ready_to_step()


def test_step_exchange__nothing_goes_on_without_a_required_controller() -> None:
    at = exchange()
    assert not at.ready_to_step()
    claim(at, "helper", 12, required=False)
    assert answer(at, "helper", [20.0, 25.0]) is None
    assert not at.ready_to_step()


def test_step_exchange__each_required_controller_is_waited_for() -> None:
    # node@0 -> heater@0 -> (waits) -> cooler@0 -> node@1 -> cooler@1 -> (waits) -> heater@1 -> node@2
    at = exchange()
    claim(at, "heater", actuators=["heat"])
    claim(at, "cooler", actuators=["cool"])
    assert at.awaiting() == ["cooler", "heater"]
    assert answer(at, "heater", [20.0, 0.0], [SET, KEEP]) is None
    assert not at.ready_to_step()
    assert at.awaiting() == ["cooler"]
    assert answer(at, "cooler", [0.0, 25.0], [KEEP, SET]) is None
    assert advance(at) == ([20.0, 25.0], ["heater", "cooler"])
    assert answer(at, "cooler", [0.0, 26.0], [KEEP, SET]) is None
    assert not at.ready_to_step()
    assert at.awaiting() == ["heater"]
    assert answer(at, "heater", [0.0, 0.0], [KEEP, KEEP]) is None
    assert advance(at) == ([20.0, 26.0], ["heater", "cooler"])


def test_step_exchange__one_that_is_not_required_is_heard_but_not_waited_for() -> None:
    # node@0 -> agent@0 -> node@1 -> helper@1 -> agent@1 -> node@2
    at = exchange()
    claim(at, "agent", 10)
    claim(at, "helper", 9, required=False)
    answer(at, "agent", [20.0, 25.0])
    assert advance(at) == ([20.0, 25.0], ["agent", "agent"])
    assert answer(at, "helper", [16.0, 29.0]) is None
    answer(at, "agent", [20.0, 25.0])
    assert advance(at) == ([16.0, 29.0], ["helper", "helper"])


def test_step_exchange__command_rules_until_the_next_one() -> None:
    at = exchange()
    claim(at, "agent")
    answer(at, "agent", [20.0, 25.0])
    advance(at)
    answer(at, "agent", [0.0, 0.0], [KEEP, KEEP])
    assert advance(at) == ([20.0, 25.0], ["agent", "agent"])


def test_step_exchange__mask_sets_keeps_and_releases() -> None:
    at = exchange(actuator("a"), actuator("b"), actuator("c"))
    claim(at, "agent")
    answer(at, "agent", [1.0, 2.0, 3.0])
    advance(at)
    answer(at, "agent", [10.0, 20.0, 30.0], [SET, KEEP, RELEASE])
    values, sources = advance(at)
    assert same(values, [10.0, 2.0, NAN])
    assert sources == ["agent", "agent", ""]


def test_step_exchange__what_a_mask_does_not_set_is_not_looked_at() -> None:
    at = exchange()
    claim(at, "agent")
    assert answer(at, "agent", [math.inf, 25.0], [KEEP, SET]) is None
    values, _ = advance(at)
    assert same(values, [NAN, 25.0])


def test_step_exchange__slots_are_commanded_apart() -> None:
    at = exchange(slots=2)
    claim(at, "agent")
    assert at.intake.command("agent", command([16.0, 23.0, 17.0, 24.0], step=[0, 0], episode=[0, 0]), 0.0) is None
    assert advance(at) == ([16.0, 23.0, 17.0, 24.0], ["agent"] * 4)
    assert at.step == [1, 1]
    operations = [KEEP, KEEP, RELEASE, SET]
    assert (
        at.intake.command("agent", command([0, 0, 0, 28.0], step=[1, 1], episode=[0, 0], operations=operations), 0.0)
        is None
    )
    values, sources = advance(at)
    assert same(values, [16.0, 23.0, NAN, 28.0])
    assert sources == ["agent", "agent", "", "agent"]


def test_step_exchange__slot_that_is_over_keeps_the_others_from_being_forked() -> None:
    at = exchange(slots=2)
    claim(at, "agent")
    require_episodes(at, "fork")
    for only, text in (([0, None], "the episode of slot 0 is over"), ([None, 0], "the episode is over")):
        assert at.intake.command("agent", command([16.0, 23.0] * 2, step=only, episode=[0, 0]), 0.0) is None
        advance(at, last=True)
        with pytest.raises(RequestRejected, match=f"there is nothing to fork: {text}; reset it first"):
            require_episodes(at, "fork")


def test_step_exchange__bounds_themselves_are_within() -> None:
    at = exchange()
    claim(at, "agent")
    assert answer(at, "agent", [15.0, 30.0]) is None
    advance(at)
    assert answer(at, "agent", [22.5, 22.5]) is None
    assert advance(at) == ([22.5, 22.5], ["agent", "agent"])


# What is not taken changes nothing


@pytest.mark.parametrize("step", [0, 1])
def test_step_exchange__answer_to_a_step_that_is_over_is_late(step: int) -> None:
    at = running()
    event = unchanged(at, lambda: at.intake.command("agent", command([21.0, 26.0], step=step), 0.0), count="late")
    check_event(event, EventKind.LATE, f"[{step}]", "[2]")
    assert (event.source, event.episode, event.step) == ("agent", 0, 2)


def test_step_exchange__answer_to_an_episode_that_is_over_is_late() -> None:
    at = running()
    at.reset()
    at.ready(0.0)
    event = unchanged(
        at, lambda: at.intake.command("agent", command([21.0, 26.0], step=2, episode=0), 0.0), count="late"
    )
    check_event(event, EventKind.LATE, "episode [0] step [2]", "episode [1] step [0]")


def test_step_exchange__second_answer_is_a_duplicate() -> None:
    at = running()
    claim(at, "second", 11)  # is waited for, so that the node stays at sample 2
    answer(at, "agent", [20.0, 25.0])
    event = unchanged(at, lambda: answer(at, "agent", [21.0, 26.0]), count="duplicate")
    check_event(event, EventKind.DUPLICATE, "already answered")
    assert event.source == "agent"


def test_step_exchange__second_answer_of_one_that_is_not_required_is_a_duplicate_too() -> None:
    at = running()
    assert answer(at, "helper", [0.0, 28.0], [KEEP, SET]) is None
    event = unchanged(at, lambda: answer(at, "helper", [0.0, 29.0], [KEEP, SET]), count="duplicate")
    check_event(event, EventKind.DUPLICATE)


def test_step_exchange__answer_to_the_last_sample_is_a_duplicate_of_nothing_that_rules() -> None:
    at = running()
    answer(at, "agent", [20.0, 25.0])
    advance(at, last=True)
    event = unchanged(at, lambda: answer(at, "agent", [21.0, 26.0]), count="duplicate")
    check_event(event, EventKind.DUPLICATE, "episode is over")
    assert at.state is State.ENDED


WRONG = {
    "by a stranger": ("stranger", command([20.0, 25.0], step=2), ["'stranger'", "claim first"]),
    "to a step to come": ("agent", command([20.0, 25.0], step=3), ["step [3]", "step [2]"]),
    "to an episode to come": ("agent", command([20.0, 25.0], step=2, episode=1), ["episode [1]", "episode [0]"]),
    "for two slots": ("agent", command([20.0, 25.0] * 2, step=[2, 2], episode=[0, 0]), ["[2, 2]", "[2]"]),
    "for no slot": ("agent", command([], step=[], episode=[]), ["[]"]),
    "with too few values": ("agent", command([20.0], step=2), ["8 bytes", "16 expected"]),
    "with too many values": ("agent", command([20.0, 25.0, 1.0], step=2), ["24 bytes", "16 expected"]),
    "with a value below its bounds": ("agent", command([14.9, 25.0], step=2), ["heat = 14.9", "15 to 22.5 degC"]),
    "with a value above its bounds": ("agent", command([20.0, 30.5], step=2), ["cool = 30.5", "22.5 to 30 degC"]),
    "with a NaN": ("agent", command([20.0, NAN], step=2), ["cool = nan"]),
    "with an infinity": ("agent", command([-math.inf, 25.0], step=2), ["heat = -inf"]),
    "with a short mask": (
        "agent", command([20.0, 25.0], step=2, operations=[SET]), ["operations has 1 bytes", "2 expected"]
    ),
    "with a long mask": (
        "agent", command([20.0, 25.0], step=2, operations=[SET] * 3), ["operations has 3 bytes", "2 expected"]
    ),
    "with an unknown mask": (
        "agent", command([20.0, 25.0], step=2, operations=[SET, 3]), ["operations has 3;", "relinquishes"]
    ),
    "of an actuator of another": ("helper", command([20.0, 25.0], step=2), ["'heat'", "claimed"]),
    "releasing another's": ("helper", command([0.0, 25.0], step=2, operations=[RELEASE, SET]), ["'heat'", "claimed"]),
    "out of bounds under a mask": ("helper", command([0.0, 99.0], step=2, operations=[KEEP, SET]), ["cool = 99"]),
}  # fmt: skip


@pytest.mark.parametrize(("controller", "sent", "words"), WRONG.values(), ids=WRONG)
def test_step_exchange__wrong_command_is_rejected_in_words(controller: str, sent: Command, words: list[str]) -> None:
    at = running()
    event = unchanged(at, lambda: at.intake.command(controller, sent, 0.0), count="rejected")
    check_event(event, EventKind.REJECTED, *words)
    assert event.source == controller
    assert answer(at, "agent", [20.0, 25.0]) is None  # the right answer is still taken
    assert at.ready_to_step()


@pytest.mark.parametrize("payload", [b"", b"\xc1", b"\x80", wire(command([20.0, 25.0], step=2))[:-1]])
def test_step_exchange__bytes_that_are_no_command_are_rejected(payload: bytes) -> None:
    at = running()
    assert unchanged(at, lambda: at.intake.accept_fast("agent", payload, 0.0), count="") is False
    check_event(
        unchanged(at, lambda: at.intake.receive_command("agent", payload, 0.0), count="rejected"), EventKind.REJECTED
    )


def test_step_exchange__command_of_another_version_is_rejected_by_name() -> None:
    at = running()
    payload, other = wire(command([20.0, 25.0], step=2)), "application/msgpack;zenostat/1.Command"
    assert unchanged(at, lambda: at.intake.accept_fast("agent", payload, 0.0, other), count="") is False
    event = unchanged(at, lambda: at.intake.receive_command("agent", payload, 0.0, other), count="rejected")
    check_event(event, EventKind.REJECTED, "zenostat/1.Command", "zenostat/3.Command")


def test_step_exchange__every_message_is_counted_once() -> None:
    at = running()
    before = at.counts.accepted
    claim(at, "second", 11)
    sent = [*([command([20.0, 25.0], step=2)] * 3), *([command([20.0, 25.0], step=1)] * 2)]
    sent += [command([20.0, NAN], step=2)] * 4
    for one in sent:
        at.intake.command("agent", one, 0.0)
    counts = at.counts
    # After its answer, whatever else the agent says of this step is a duplicate, right or wrong.
    assert (counts.accepted - before, counts.duplicate, counts.late, counts.rejected) == (1, 6, 2, 0)


# Free mode


def test_step_exchange__in_free_mode_nobody_is_waited_for() -> None:
    at = exchange(mode=Mode.FREE)
    assert at.ready_to_step()
    claim(at, "agent")
    values, sources = advance(at)
    assert same(values, [NAN, NAN])
    assert sources == ["", ""]
    assert answer(at, "agent", [20.0, 25.0]) is None
    assert advance(at) == ([20.0, 25.0], ["agent", "agent"])
    assert advance(at) == ([20.0, 25.0], ["agent", "agent"])  # held
    check_event(at.intake.command("agent", command([21.0, 26.0], step=1), 0.0), EventKind.LATE)
    assert advance(at) == ([20.0, 25.0], ["agent", "agent"])


def test_step_exchange__in_free_mode_the_end_is_the_end() -> None:
    at = exchange(mode=Mode.FREE)
    advance(at, last=True)
    assert not at.ready_to_step()


# Reset


@pytest.mark.parametrize("ended", [False, True])
def test_step_exchange__reset_releases_everything_and_keeps_the_claims(ended: bool) -> None:
    at = exchange()
    claim(at, "agent")
    at.intake.write("cool", Write(value=28.0, duration_s=3600.0, source="wall"), 0.0)
    answer(at, "agent", [20.0, 25.0])
    assert advance(at, last=ended)[1] == ["agent", "wall"]
    at.reset()
    assert (at.state, at.episode) == (State.STARTING, [1])
    assert not at.ready_to_step()
    at.ready(0.0)
    assert (at.state, at.step) == (State.WAITING, [0])
    assert not at.commands.has_expiries
    values, sources = ruling(at)
    assert same(values, [NAN, NAN])
    assert sources == ["", ""]
    assert at.awaiting() == ["agent"]
    assert answer(at, "agent", [21.0, 26.0]) is None
    assert advance(at) == ([21.0, 26.0], ["agent", "agent"])


def test_step_exchange__names_are_right_after_a_reset() -> None:
    at = exchange()
    at.intake.write("cool", Write(value=28.0, source="wall"), 0.0)  # the first name of this episode, not of the next
    claim(at, "agent", 10)
    claim(at, "guard", 5)
    at.reset()
    at.ready(0.0)
    answer(at, "guard", [16.0, 0.0], [SET, KEEP])
    answer(at, "agent", [20.0, 25.0])
    assert advance(at) == ([16.0, 25.0], ["guard", "agent"])


def test_step_exchange__counts_are_of_the_nodes_life() -> None:
    at = running()
    at.intake.command("agent", command([20.0, 25.0], step=0), 0.0)
    at.intake.command("agent", command([20.0, NAN], step=2), 0.0)
    at.reset()
    at.ready(0.0)
    assert (at.counts.accepted, at.counts.late, at.counts.rejected) == (2, 1, 1)


def test_step_exchange__touched_tells_whether_sample_0_is_still_that_of_a_fresh_start() -> None:
    at = exchange()
    claim(at, "agent")
    assert at.modified == [False]
    answer(at, "agent", [20.0, 25.0])
    advance(at)
    assert at.modified == [True]
    at.reset()
    at.ready(0.0)
    assert at.modified == [False]


def test_step_exchange__write_without_a_name_has_an_anonymous_source() -> None:
    at = exchange(mode=Mode.FREE)
    at.intake.write("cool", Write(value=28.0, source=""), 0.0)
    assert advance(at)[1] == ["", "anonymous"]


def test_step_exchange__write_after_a_failure_is_refused() -> None:
    at = exchange(mode=Mode.FREE)
    at.transition(Trigger.FAIL)
    assert at.intake.write("cool", Write(value=28.0, source="wall"), 0.0).kind is EventKind.REJECTED
