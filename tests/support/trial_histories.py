"""Random histories of a node: steps, writes, faults, snapshots and resets, with or without trials between them."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

from zenostat import Bus, SampleView
from zenostat.bridge.client.controller_link import ControllerLink
from zenostat.bridge.client.trials import CommandValues
from zenostat.topics import codec, keys
from zenostat.topics.errors import RequestRejected
from zenostat.topics.messages import Ack, Actuator, Claim, Command, CommandOp, Sample, StepsTried, TrySteps

FAULTS = ("none", "noise", "delay", "drift", "freeze", "held actuator", "slow actuator")

Operation = tuple[Any, ...]


def histories(longest: int) -> st.SearchStrategy[list[Operation]]:
    """Strategy of histories: for each operation its name and the numbers that it needs."""
    share = st.floats(0.0, 1.0)
    command = st.tuples(share, share, st.sampled_from(["set", "set", "partly", "relinquish"]))
    commands = st.lists(command, min_size=1, max_size=3)
    operation = st.one_of(
        st.tuples(st.just("step"), command),
        st.tuples(st.just("tried"), commands, command),
        st.tuples(st.just("trial"), commands, st.integers(1, 3), st.booleans()),
        st.tuples(st.just("bad trial"), st.sampled_from(["value", "step", "size"])),
        st.tuples(st.just("write"), st.integers(0, 1), st.none() | share, st.sampled_from([4, 12]), st.integers(0, 3)),
        st.tuples(st.just("other"), share),
        st.tuples(st.just("faults"), st.sampled_from(FAULTS)),
        st.sampled_from([("snapshot",), ("restore",)]),
        st.tuples(st.just("reset"), st.integers(0, 5), st.booleans()),
    )
    return st.lists(operation, min_size=1, max_size=longest)


class Player:
    """Plays histories on a node; `trials`: whether with their trials.

    Two controllers have claims: `main` answers each sample, `other` has the first actuator at a higher priority.
    """

    def __init__(self, bus: Bus, node: str, *, trials: bool) -> None:
        self.bus, self.node, self.trials = bus, node, trials
        self.main = ControllerLink(bus, node, Claim(controller="main"), bus.affinity)
        self.actuators = self.main.manifest.actuators
        names = [self.actuators[0].name]
        bus.claim(node, Claim(controller="other", priority=6, actuators=names, required=False))

    def close(self) -> None:
        self.main.close()

    def play(self, history: Sequence[Operation]) -> list[bytes]:
        """The samples of a history, in a new episode whose number and whose counts begin at 0."""
        self.bus.faults(self.node, None)
        self.snapshot = ""
        self.sample = self.main.reset(seed=0)
        self._first = self.sample.message
        self.seen: list[bytes] = [self._seen(self.sample.message)]
        try:
            for name, *numbers in history:
                if not self.sample.truncated or name in ("reset", "restore"):
                    getattr(self, f"_{name.replace(' ', '_')}")(*numbers)
        finally:
            if self.snapshot:
                self.bus.drop(self.node, self.snapshot)
        return self.seen

    def _seen(self, message: Sample) -> bytes:
        first = self._first
        episode = [now - then for now, then in zip(message.episode, first.episode, strict=True)]
        late, rejected = message.late - first.late, message.rejected - first.rejected
        return codec.encode(message.model_copy(update={"episode": episode, "late": late, "rejected": rejected}))

    def _keep(self, sample: SampleView) -> None:
        self.sample = sample
        self.seen.append(self._seen(sample.message))

    def _command(self, shares: tuple[float, float, str]) -> CommandValues:
        *pair, how = shares
        row = [value(actuator, pair[number % 2]) for number, actuator in enumerate(self.actuators)]
        if how == "set":
            slots = self.main.manifest.slots
            return np.array(row) if slots == 1 else np.stack([row, row[::-1] if len(row) == 2 else row])[:slots]
        named: dict[str, float | None] = {a.name: number for a, number in zip(self.actuators, row, strict=True)}
        if how == "partly":
            return {self.actuators[-1].name: row[-1]}
        return named | {self.actuators[0].name: None}

    # Operations

    def _step(self, shares: Any) -> None:
        self.main.send(self._command(shares))
        self._keep(self.main.receive())

    def _tried(self, sequence: Any, alternative: Any) -> None:
        """Try a sequence beside an alternative, then take these steps: the samples are those of the trial."""
        commands = [self._command(shares) for shares in sequence]
        expected: list[SampleView] = []
        if self.trials:
            _, expected = self.main.try_steps([[self._command(alternative)] * len(commands), commands])
        for number, shares in enumerate(sequence):
            if any(flag & 2 for flag in self.sample.message.flags) or self._is_over():
                assert not self.trials or len(expected) == number
                return
            self._step(shares)
            if self.trials:
                assert codec.encode(expected[number].message) == codec.encode(self.sample.message)

    def _is_over(self) -> bool:
        return max(self.sample.message.step) >= self.main.manifest.steps

    def _trial(self, commands: Any, timesteps: int, is_main: bool) -> None:
        if not self.trials or self._is_over():
            return
        sequences = [[self._command(shares)] * timesteps for shares in commands]
        tried = self.main.try_steps(sequences) if is_main else self.bus.try_steps(self.node, sequences, name="guest")
        steps = [sample.message.step for sample in tried[0]]
        assert len(tried) == len(sequences)
        assert steps[0] == [step + 1 for step in self.sample.message.step]

    def _bad_trial(self, what: str) -> None:
        if not self.trials or self._is_over():
            return
        values = np.full((self.main.manifest.slots, len(self.actuators)), 1e6)
        fields = {"controller": "main", "alternatives": 1, "values": values.tobytes()}
        if what == "step":
            fields["step"] = [step + 1 for step in self.sample.message.step]
        if what == "size":
            fields["values"] = values.tobytes()[1:]
        with pytest.raises(RequestRejected):
            self.bus.ask(keys.TRY, self.node, TrySteps(**fields), StepsTried)

    def _write(self, index: int, share: float | None, priority: int, timesteps: int) -> None:
        actuator = self.actuators[index]
        number = None if share is None else value(actuator, share)
        duration_s = timesteps * self.main.manifest.step_s if timesteps and number is not None else None
        self.bus.write(self.node, actuator.name, number, priority=priority, duration_s=duration_s, source="operator")

    def _other(self, share: float) -> None:
        slots, message = self.main.manifest.slots, self.sample.message
        codes, row = np.zeros((slots, len(self.actuators)), np.uint8), np.zeros((slots, len(self.actuators)))
        codes[:, 0], row[:, 0] = CommandOp.SET, value(self.actuators[0], share)
        command = Command(episode=message.episode, step=message.step, operations=codes.tobytes(), values=row.tobytes())
        with suppress(RequestRejected):  # a second command at the same sample
            self.bus.ask(keys.COMMAND_REQUEST, self.node, command, Ack, name="other")

    def _faults(self, name: str) -> None:
        points, actuators = self.main.manifest.sensors[0].name, self.actuators[-1].name
        plans = {
            "noise": {"kind": "noise", "points": points, "sigma": 0.5},
            "delay": {"kind": "delay", "points": points, "steps": 2},
            "drift": {"kind": "drift", "points": points, "rate_per_h": 0.2},
            "freeze": {"kind": "freeze", "points": points, "when": {"probability": 0.5, "lasts_steps": 2}},
            "held actuator": {"kind": "freeze", "actuators": actuators},
            "slow actuator": {"kind": "delay", "actuators": actuators, "steps": 2},
        }
        self.bus.faults(self.node, {"seed": 3, "faults": [plans[name]]} if name in plans else None)

    def _snapshot(self) -> None:
        if self._is_over():
            return
        if self.snapshot:
            self.bus.drop(self.node, self.snapshot)
        self.snapshot = self.bus.snapshot(self.node, self.main.name).snapshot

    def _restore(self) -> None:
        if self.snapshot:
            self._keep(self.main.reset(snapshot=self.snapshot))

    def _reset(self, seed: int, is_partial: bool) -> None:
        slots = [1] if is_partial and self.main.manifest.slots > 1 else None
        self._keep(self.main.reset(seed=seed, slots=slots))


def value(actuator: Actuator, share: float) -> float:
    """A value within the bounds; heating setpoints are below cooling setpoints."""
    for part, low in (("heating", 15.0), ("cooling", 23.0)):
        if part in actuator.name:
            return low + 6.0 * share
    assert actuator.low is not None
    assert actuator.high is not None
    return actuator.low + share * (actuator.high - actuator.low)
