"""The exchange of a trial decides a timestep as the node's own would, and changes nothing of it."""

from typing import Any

import numpy as np
import pytest

from zenostat.bridge.exchange.step_exchange import StepExchange
from zenostat.bridge.exchange.trial import TrialExchange
from zenostat.bridge.node.sample_encoding import SampleHead
from zenostat.topics.errors import BadMessage, RequestRejected
from zenostat.topics.messages import Actuator, Claim, Command, CommandOp, Mode, Policy, Write

STEP_S = 60.0
ACTUATORS = tuple(Actuator(name=name, unit="W", low=0.0, high=10.0) for name in ("heater", "fan"))


def exchange_of(*claims: Claim, **settings: Any) -> StepExchange:
    exchange = StepExchange(ACTUATORS, **settings)
    exchange.ready(0.0)
    for claim in claims:
        exchange.claim(claim, 0.0)
    return exchange


def command(exchange: StepExchange, *values: float, operations: bytes | None = None) -> Command:
    return Command(
        episode=exchange.episode, step=exchange.step, operations=operations, values=np.array(values).tobytes()
    )


def step(exchange: StepExchange, **commands: Command) -> bytes:
    """A timestep of the node: what the plant receives."""
    for controller, answer in commands.items():
        assert exchange.intake.command(controller, answer, 0.0) is None
    exchange.intake.expire(exchange.commands.timesteps * STEP_S)
    assert exchange.ready_to_step()
    values = exchange.begin_step(0.0)
    exchange.finish_step([False] * len(exchange.active_slots), 0.0)
    return values


def tried(
    exchange: StepExchange, sender: str, *commands: Command, priority: int = 10
) -> tuple[list[bytes], SampleHead]:
    trial = TrialExchange(exchange, sender, priority)
    rows = []
    for answer in commands:
        rows.append(trial.begin_step(trial.command(answer.values, answer.operations), STEP_S))
        trial.finish_step([False] * exchange.slots)
    return rows, SampleHead.of(trial.exchange)


def test_trial_exchange__write_expires_within_a_trial() -> None:
    exchange = exchange_of(Claim(controller="agent"))
    exchange.intake.write("fan", Write(value=9.0, priority=4, duration_s=2 * STEP_S, source="operator"), 0.0)
    answers = [command(exchange, 1.0, float(k)) for k in range(3)]
    rows, head = tried(exchange, "agent", *answers)
    assert [np.frombuffer(row).tolist() for row in rows] == [[1.0, 9.0], [1.0, 9.0], [1.0, 2.0]]
    committed = [step(exchange, agent=command(exchange, 1.0, float(k))) for k in range(3)]
    assert rows == committed
    assert head == SampleHead.of(exchange)


@pytest.mark.parametrize("policy", [Policy.HOLD, Policy.RELINQUISH])
def test_trial_exchange__has_the_fallback_of_a_controller_that_has_left(policy: Policy) -> None:
    exchange = exchange_of(Claim(controller="agent", actuators=["heater"]), Claim(controller="gone", actuators=["fan"]),
                           policy=policy)  # fmt: skip
    sets = [bytes([CommandOp.SET, CommandOp.KEEP]), bytes([CommandOp.KEEP, CommandOp.SET])]
    step(exchange, agent=command(exchange, 1.0, 0.0, operations=sets[0]),
         gone=command(exchange, 0.0, 7.0, operations=sets[1]))  # fmt: skip
    exchange.fallback.on_disconnect("gone", 0.0)
    exchange.fallback.bypass("gone", 0.0)
    answers = [command(exchange, float(k), 0.0, operations=sets[0]) for k in (2, 3)]
    rows, head = tried(exchange, "agent", *answers)
    assert np.frombuffer(rows[0]).tolist()[0] == 2.0
    np.testing.assert_equal(np.frombuffer(rows[0])[1], 7.0 if policy is Policy.HOLD else np.nan)
    committed = [step(exchange, agent=command(exchange, float(k), 0.0, operations=sets[0])) for k in (2, 3)]
    assert rows == committed
    assert head == SampleHead.of(exchange)
    assert head.fallback_active


def test_trial_exchange__controllers_that_have_not_answered_keep_their_values() -> None:
    exchange = exchange_of(Claim(controller="agent", actuators=["heater"]), Claim(controller="slow", actuators=["fan"]))
    sets = [bytes([CommandOp.SET, CommandOp.KEEP]), bytes([CommandOp.KEEP, CommandOp.SET])]
    step(exchange, agent=command(exchange, 1.0, 0.0, operations=sets[0]),
         slow=command(exchange, 0.0, 7.0, operations=sets[1]))  # fmt: skip
    answer = command(exchange, 2.0, 0.0, operations=sets[0])
    rows, head = tried(exchange, "agent", answer)
    assert exchange.awaiting() == ["agent", "slow"]
    keeps = command(exchange, 0.0, 0.0, operations=bytes(2))
    assert rows == [step(exchange, agent=answer, slow=keeps)]
    assert head == SampleHead.of(exchange)
    assert not head.fallback_active


@pytest.mark.parametrize("mode", [Mode.LOCKSTEP, Mode.FREE, Mode.PACED])
@pytest.mark.parametrize("sender", ["agent", "guest"])
def test_trial_exchange__changes_nothing(mode: Mode, sender: str) -> None:
    """A guest has no claim: its values act at the given priority, and its name stays unknown to the node."""
    exchange = exchange_of(Claim(controller="agent"), mode=mode)
    exchange.intake.write("fan", Write(value=9.0, priority=4, duration_s=STEP_S, source="operator"), 0.0)
    before = (SampleHead.of(exchange), exchange.counts, exchange.controllers(), exchange.awaiting())
    before_array = [part.tolist() for part in exchange.commands.array.table()]
    rows, head = tried(exchange, sender, *[command(exchange, 5.0, 5.0)] * 3, priority=3)
    assert np.frombuffer(rows[0]).tolist() == ([5.0, 9.0] if sender == "agent" else [5.0, 5.0])
    assert sender in head.source_names
    assert before == (SampleHead.of(exchange), exchange.counts, exchange.controllers(), exchange.awaiting())
    np.testing.assert_equal(before_array, [part.tolist() for part in exchange.commands.array.table()])
    assert "guest" not in exchange.source_names


def test_trial_exchange__invalid_command_is_refused() -> None:
    exchange = exchange_of(Claim(controller="agent", actuators=["heater"]))
    trial = TrialExchange(exchange, "agent", 10)
    for answer, text in (
        (command(exchange, 11.0, 0.0, operations=bytes([1, 0])), "heater = 11"),
        (command(exchange, np.nan, 0.0, operations=bytes([1, 0])), "heater = nan"),
        (command(exchange, 1.0, 1.0), "'fan' is not among the actuators that it claimed"),
    ):
        with pytest.raises(BadMessage, match=text):
            trial.check(answer)


def test_trial_exchange__too_many_sources_are_refused() -> None:
    exchange = exchange_of()
    array = exchange.commands.array

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(array), "has_room", lambda *_: False)
        with pytest.raises(RequestRejected, match="sources command actuators"):
            TrialExchange(exchange, "guest", 10)
