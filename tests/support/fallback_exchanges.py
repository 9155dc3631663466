"""Exchanges with controllers that a fallback policy applies to."""

import numpy as np

from support.builders import NAN, advance, answer, claim, exchange
from zenostat.bridge.exchange.step_exchange import StepExchange
from zenostat.topics.messages import CommandOp, ControllerState, ControllerStatus, Event, EventKind, Mode, Policy

KEEP, SET = CommandOp.KEEP, CommandOp.SET
GO_ON = [Policy.HOLD, Policy.RELINQUISH]


def node(
    policy: Policy, deadline_s: float | None = None, *, mode: Mode = Mode.LOCKSTEP, slots: int = 1
) -> StepExchange:
    """A node at sample 0, with a heating and a cooling setpoint."""
    at = exchange(mode=mode, slots=slots)
    at.policy, at.deadline_s = policy, deadline_s
    return at


def with_agent(policy: Policy, deadline_s: float | None = None, *, mode: Mode = Mode.LOCKSTEP) -> StepExchange:
    """At sample 1, published at 1 s; the agent commanded 20 and 25."""
    at = node(policy, deadline_s, mode=mode)
    claim(at, "agent")
    answer(at, "agent", [20.0, 25.0])
    assert advance(at, now_s=1.0) == ([20.0, 25.0], ["agent", "agent"])
    return at


def with_two(policy: Policy, deadline_s: float | None = None) -> StepExchange:
    """At sample 1, published at 1 s; each of two commanded one setpoint: 20 and 25."""
    at = node(policy, deadline_s)
    claim(at, "heater", actuators=["heat"])
    claim(at, "cooler", actuators=["cool"])
    both(at, 20.0, 25.0)
    assert advance(at, now_s=1.0) == ([20.0, 25.0], ["heater", "cooler"])
    return at


def both(at: StepExchange, heat: float, cool: float) -> None:
    assert answer(at, "heater", [heat, 0.0], [SET, KEEP]) is None
    assert answer(at, "cooler", [0.0, cool], [KEEP, SET]) is None


def status(at: StepExchange, name: str) -> ControllerStatus:
    return next(c for c in at.controllers() if c.controller == name)


def state(at: StepExchange, name: str) -> ControllerState:
    return status(at, name).state


def disconnect(at: StepExchange, name: str, now_s: float = 1.0) -> None:
    """Let a controller disconnect, without a time of grace."""
    at.fallback.on_disconnect(name, now_s)
    at.fallback.bypass(name, now_s)


def kinds_and_sources(events: list[Event]) -> list[tuple[EventKind, str]]:
    return [(event.kind, event.source) for event in events]


def expected_under(policy: Policy) -> tuple[list[float], list[str]]:
    """Values and sources where the agent alone commanded 20 and 25, and the policy goes on without it."""
    return ([20.0, 25.0], ["agent", "agent"]) if policy is Policy.HOLD else ([NAN, NAN], ["", ""])


def check_ruled(
    at: StepExchange, expected: tuple[list[float], list[str]], *, now_s: float = 1.0, fallback: bool | None = None
) -> None:
    """Advance by a timestep that these values and sources rule, with or without a fallback if that is given."""
    values, sources = advance(at, now_s=now_s)
    assert np.array_equal(values, expected[0], equal_nan=True), values
    assert sources == expected[1]
    assert fallback in (None, at.fallback_active)
