"""Trial steps: timesteps from the present sample under alternative commands, on copies of the plant that then end.

A trial has the machinery of a plan, but no branch: its samples are those that the node would publish if it were given
the same commands, to the bit, and the node stays at its sample. The step exchange, the injected point faults and the
plant are copied for each alternative; faults of the link do not delay or lose a request.
"""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, cast

from zenostat.bridge.exchange.trial import TrialExchange
from zenostat.bridge.node.fault_injection import FaultInjection
from zenostat.bridge.node.planning import require_episodes, simulate, split_commands, steps_left
from zenostat.bridge.node.plant import AbandonablePlant, ClosingPlant, PlantDescription, RunningPlant, TryingPlant
from zenostat.bridge.node.sample_encoding import SampleEncoder, SampleHead
from zenostat.bridge.node.served_node import ServedNode
from zenostat.bridge.node.subscriptions import Request
from zenostat.topics import codec, keys
from zenostat.topics.errors import BadMessage, PlantFailed, RequestRejected, SimulatorError
from zenostat.topics.messages import Command, StepsTried, TrySteps

MAX_COPIES = 8
"""Copies of a slot that simulate at the same time, which limits their memory; further alternatives follow these."""

MAX_SAMPLES = 2000
"""Largest number of samples in a reply."""

_SAMPLE_MARGIN = 256
"""Bytes that a sample of a trial may have more than the present one: the name of its sender."""


class _ClosingCopy(ClosingPlant, RunningPlant, Protocol):
    """A copy whose processes take a while to end."""


class TrialSteps:
    """Answers the requests for trials of one node server, in its thread.

    Args:
        server: that answers.
        folder: for the files of the copies; it need not exist.
    """

    def __init__(self, server: ServedNode, folder: Path) -> None:
        self._server, self._folder = server, folder
        self._numbers = itertools.count(1)
        self._copy: RunningPlant | None = None
        self._ending: list[tuple[_ClosingCopy, Path]] = []

    def declare(self) -> None:
        """Answer requests. They are not recorded: a trial changes nothing that a replay would need."""
        self._server.subscriptions.request_undecoded(keys.TRY, self._on_request)

    def _on_request(self, request: Request) -> None:
        def answer() -> StepsTried:
            trial = codec.decode(TrySteps, request.payload, request.encoding)
            return self.simulate(self._server.subscriptions.checked(keys.TRY, request.sender, trial))

        request.answer(answer, is_recorded=False)

    def interrupt(self, reason: str) -> None:
        """Give up the trial that is being simulated, if any; thread-safe."""
        copy = self._copy
        if isinstance(copy, AbandonablePlant):
            copy.abandon(reason, is_starting=False)
        elif copy is not None:
            copy.interrupt()

    def simulate(self, request: TrySteps) -> StepsTried:
        """Simulate all alternatives of a controller, at most until the episode of a slot ends.

        Raises:
            RequestRejected: no episode is running, it is not the present sample, or a command is not valid; nothing was
                simulated.
            ForkFailed: the plant cannot be copied.
            SimulatorError: a copy failed; the plant is as it was.
        """
        self._check(request)
        timesteps = min(request.timesteps, steps_left(self._server))
        alternatives = self._alternatives(request)
        self.collect()
        together = max(1, MAX_COPIES // self._server.exchange.slots)
        for first in range(0, len(alternatives), together):
            self._simulate(alternatives[first : first + together], timesteps)
        return StepsTried(samples=[sample for alternative in alternatives for sample in alternative.samples])

    def _check(self, request: TrySteps) -> None:
        server, exchange = self._server, self._server.exchange
        require_episodes(exchange, "try")
        for name, asked, present in (
            ("episode", request.episode, exchange.episode),
            ("step", request.step, exchange.step),
        ):
            if asked is not None and asked != present:
                raise RequestRejected(f"it tries from {name} {asked}; the present {name} is {present}")
        samples = request.alternatives * request.timesteps
        largest = min(MAX_SAMPLES, codec.MAX_BYTES // (len(server.latest_sample) + _SAMPLE_MARGIN))
        if samples > largest:
            raise RequestRejected(
                f"{request.alternatives} alternatives of {request.timesteps} timesteps; "
                f"a reply has room for {largest} samples"
            )

    def _alternatives(self, request: TrySteps) -> list[_Alternative]:
        """Return the alternatives; `RequestRejected` if the exchange would not accept one of their commands."""
        count, timesteps = request.alternatives * request.timesteps, request.timesteps
        commands = split_commands(request, count, self._server.exchange.commands.size)
        alternatives = []
        for number in range(request.alternatives):
            alternative = _Alternative(self._server, request.controller, request.priority)
            for timestep, command in enumerate(commands[number * timesteps : (number + 1) * timesteps]):
                try:
                    alternative.add(*command)
                except BadMessage as error:
                    raise RequestRejected(f"alternative {number}, timestep {timestep}: {error}") from None
            alternatives.append(alternative)
        return alternatives

    def _simulate(self, alternatives: Sequence[_Alternative], timesteps: int) -> None:
        """Simulate some alternatives at the same time, on copies that end with it."""
        plant, slots = self._server.plant, self._server.exchange.slots
        folder = self._folder / str(next(self._numbers))
        copy: RunningPlant | None = None
        try:
            copies = [*range(slots)] * len(alternatives)
            if isinstance(plant, TryingPlant):
                copy = plant.fork_for_trial(copies, folder, timesteps, baseline=plant.has_baseline)
            else:
                copy = plant.fork(copies, folder, baseline=plant.has_baseline)
            self._copy = copy
            self._run(copy, alternatives, timesteps)
        except SimulatorError as error:
            steps = ", ".join(map(str, self._server.exchange.step))
            raise type(error)(f"trial from step {steps}: {error}") from None
        finally:
            self._copy = None
            self._end(copy, folder)

    def _end(self, copy: RunningPlant | None, folder: Path) -> None:
        """Let a copy end; the reply need not wait until it has released its memory."""
        if isinstance(copy, ClosingPlant):
            copy.order_close()
            self._ending.append((cast("_ClosingCopy", copy), folder))
            return
        if copy is not None:
            copy.close()
        shutil.rmtree(folder, ignore_errors=True)

    def collect(self, *, wait: bool = False) -> None:
        """Release what copies held that have ended; with `wait`, that of all copies."""
        for ending in [*self._ending]:
            copy, folder = ending
            if wait or copy.has_ended:
                self._ending.remove(ending)
                copy.close()
                shutil.rmtree(folder, ignore_errors=True)

    def _run(self, copy: RunningPlant, alternatives: Sequence[_Alternative], timesteps: int) -> None:
        """Simulate the alternatives of a copy, each in slots of its own."""
        count, width = len(alternatives), self._server.exchange.slots
        slots = range(width * count)
        # A fault that acts on commands and on sensors has one state, which the samples change as well.
        at_once = timesteps if self._server.injection is None else 1
        for first in range(0, timesteps, at_once):
            numbers = range(first, first + at_once)
            orders = [b"".join([alternative.begin_step(number) for alternative in alternatives]) for number in numbers]
            for number, last in zip(numbers, simulate(copy, orders, slots), strict=True):
                for position, alternative in enumerate(alternatives):
                    alternative.finish_step(
                        number, _CopyPart(copy, position, count), last[position * width : (position + 1) * width]
                    )


class _CopyPart:
    """The slots of one alternative, of a copy with equally many for each; see `SampleSource`."""

    def __init__(self, copy: RunningPlant, position: int, count: int) -> None:
        self._copy, self._position, self._count = copy, position, count

    def _part(self, raw: bytes) -> bytes:
        width = len(raw) // self._count
        return raw[self._position * width : (self._position + 1) * width]

    @property
    def description(self) -> PlantDescription:
        return self._copy.description

    @property
    def effective(self) -> bytes:
        return self._part(self._copy.effective)

    @property
    def has_baseline(self) -> bool:
        return self._copy.has_baseline

    def values(self) -> bytes:
        return self._part(self._copy.values())

    def baseline_values(self) -> bytes:
        return self._part(self._copy.baseline_values())

    def baseline_effective(self) -> bytes:
        return self._part(self._copy.baseline_effective())


class _Alternative:
    """The commands of one alternative, and their samples.

    Attributes:
        samples: encoded, as far as they have been simulated.
    """

    def __init__(self, server: ServedNode, sender: str, priority: int) -> None:
        self._trial = TrialExchange(server.exchange, sender, priority)
        self._commands: list[Command] = []
        self._heads: list[SampleHead] = []
        self._period = server.plant.description.run_period
        self._injection: FaultInjection | None = None
        if server.injection is not None:
            state = server.injection.state()
            self._injection = FaultInjection(state[0], server.plant.description, server.exchange.slots)
            self._injection.restore(state)
        self.samples: list[bytes] = []

    def add(self, values: bytes, operations: bytes | None) -> None:
        """Add the command of another timestep; `BadMessage` if it is not valid."""
        command = self._trial.command(values, operations)
        self._trial.check(command)
        self._commands.append(command)

    def begin_step(self, number: int) -> bytes:
        """Return what the plant receives in a timestep; the exchange is at its sample then."""
        trial, steps = self._trial, self._trial.exchange.step
        commands = trial.begin_step(self._commands[number], self._period.step_s)
        if self._injection is not None:
            commands = self._injection.apply_to_commands(commands, steps)
        trial.finish_step([step + 1 >= self._period.steps for step in steps])
        self._heads.append(SampleHead.of(trial.exchange))
        return commands

    def finish_step(self, number: int, plant: _CopyPart, last: Sequence[bool]) -> None:
        """Add the sample of a timestep that has been simulated."""
        head = self._heads[number]
        if [*last] != head.done:
            raise PlantFailed(f"the plant's last sample is not that of its run period, {self._period.steps}")
        values, fault_free_values = plant.values(), b""
        if self._injection is not None:
            fault_free_values, values = values, self._injection.apply_to_sensors(values, head.step)
        encoder = SampleEncoder(plant, self._trial.exchange)
        self.samples.append(encoder.encode(head, values, fault_free_values))
