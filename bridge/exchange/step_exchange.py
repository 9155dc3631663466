"""The step exchange: messages in, decisions out, without Zenoh, EnergyPlus or a clock.

An episode of N timesteps has N commands and N + 1 samples. Sample 0 is the state after warm-up. Command k answers
sample k and takes effect in timestep k + 1. The last sample needs no answer.

    STARTING ──ready──▶ WAITING ──go──▶ RUNNING ──sampled──▶ WAITING … ──ended──▶ ENDED
        ▲                  │                                                       │
        └──────reset───────┴───────────────────────────────────────────────reset───┘

Slots are engines that step together, each with its own episode. A slot that no required controller answers does not
step, nor does one whose episode is over. The exchange has ended once all slots have.

In lockstep, a timestep starts once each required controller has answered the current sample, and there is at least one
such controller. In free and paced mode, timesteps do not wait for controllers. A controller that disconnects keeps its
claim. Depending on the fallback policy, the node waits until it reconnects or another one takes over its priority, or
continues without it (holding or relinquishing what it commanded), or aborts the episode. The same applies to a
controller that does not answer by the deadline.

Three kinds of messages change nothing and are counted and reported by an event: `late` (answers a step that is over),
`duplicate` (answers the current step again) and `rejected` (any other error). Under the policy `wait`, a command that
arrives after the deadline still answers the current step; it is accepted and reported as `accepted_late`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from zenostat.bridge.exchange.actuator_commands import CommandSnapshot
from zenostat.bridge.exchange.fallback import FallbackRules
from zenostat.bridge.exchange.intake import MAX_MESSAGES_PER_STEP, Intake
from zenostat.bridge.exchange.state import MAX_SOURCE_NAME, ExchangeState
from zenostat.bridge.exchange.transitions import TRANSITIONS, IllegalTransition, Trigger
from zenostat.topics import codec
from zenostat.topics.messages import Claim, ControllerState, ControllerStatus, Event, EventKind, Mode, State

__all__ = ["MAX_MESSAGES_PER_STEP", "MAX_SOURCE_NAME", "TRANSITIONS", "IllegalTransition", "StepExchange", "Trigger"]

# Used in each timestep: access to an enum's member raises and catches an error in Python 3.11.
_GO, _SAMPLED, _OVER, _WAITING, _LOCKSTEP = Trigger.GO, Trigger.SAMPLED, Trigger.ENDED, State.WAITING, Mode.LOCKSTEP
_BYPASSED = ControllerState.BYPASSED


@dataclass(slots=True)
class StepExchange(ExchangeState):
    """The step exchange of one node; see the module, and `ExchangeState` for the other attributes.

    Attributes:
        intake: accepts or rejects commands and writes.
        fallback: applies the fallback policy.
    """

    intake: Intake = field(init=False, repr=False, compare=False)
    fallback: FallbackRules = field(init=False, repr=False, compare=False)
    _heads: codec.CommandHead = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        ExchangeState.__post_init__(self)  # `super()` needs the class that `slots=True` replaces
        self.intake, self.fallback = Intake(self), FallbackRules(self)

    def ready(
        self, now_s: float, starts: Mapping[int, int] | None = None, commands: CommandSnapshot | None = None
    ) -> None:
        """Mark the engines as ready, and open the intake of answers to their samples.

        Args:
            now_s: wall time.
            starts: first step by slot with a new episode (None: all slots at 0).
            commands: captured commands to restore (None: the present ones stay).
        """
        self.transition(Trigger.READY)
        if commands is not None:
            self.commands.restore(commands)
            self.commanded, self.source_index = commands.commanded, commands.source_index
            self.claims.return_to(commands.holders)
        self.step, self.modified, self.done = [*self.step], [*self.modified], [*self.done]
        for slot, step in (starts if starts is not None else dict.fromkeys(self.all_slots, 0)).items():
            self.step[slot] = step
            self.modified[slot] = step > 0
            self.done[slot] = False
        self._heads = codec.CommandHead(self.episode, self.commands.size)
        head = b"" if True in self.done else self._heads.at(self.step)
        self.answers.open(self.claims.required, self.deadline_s, head, now_s)

    def finish_step(self, last: Sequence[bool], now_s: float) -> None:
        """Finish a timestep, and open the intake of answers to its sample.

        The sample is published after this call. To open the intake only then would publish it a microsecond earlier,
        but would need a second call after the publication.

        Args:
            last: of each active slot, whether it was its last timestep.
            now_s: wall time, from which response times count.
        """
        if self.active_slots is self.all_slots:
            steps, done = [step + 1 for step in self.step], [*last]
        else:
            steps, done = [*self.step], [*self.done]
            for slot, is_last in zip(self.active_slots, last, strict=True):
                steps[slot] += 1
                done[slot] = is_last
        self.transition(_SAMPLED if False in done else _OVER)
        self.step, self.done = steps, done
        self.commands.timesteps += 1
        head = b"" if True in done else self._heads.at(steps)
        self.answers.open(self.claims.required, self.deadline_s, head, now_s)

    def reset(self, slots: Sequence[int] | None = None) -> None:
        """Begin a new episode in all slots or in some, and relinquish everything there.

        Connected controllers keep their claims. When all slots are reset, the claims of disconnected ones are dropped.
        """
        self.transition(Trigger.RESET)
        if slots is None or len(set(slots)) == self.slots:
            self.episode = [episode + 1 for episode in self.episode]
            self.commands.clear()
            self.claims.begin_episode()
            self.clear_commanded()
            return
        self.episode = [episode + (slot in slots) for slot, episode in enumerate(self.episode)]
        self.commands.array.relinquish_slots(slots)
        self._merge(codec.RELINQUISHED * (len(self.commanded) // 8), bytes(len(self.source_index)), slots)

    def capture(self) -> CommandSnapshot:
        """Return the commands in effect at the current sample."""
        return replace(
            self.commands.capture(),
            commanded=self.commanded,
            source_index=self.source_index,
            holders=self.claims.copies(),
        )

    def copy(self) -> StepExchange:
        """Return an exchange at the same sample that changes independently; it counts no accepted messages."""
        copy = StepExchange(self.actuators, self.slots, self.mode, self.policy, self.deadline_s, self.state,
                            [*self.episode], [*self.step], replace(self.counts), self.connected)  # fmt: skip
        copy.commands.restore(self.commands.capture())
        copy.claims.restore(self.claims)
        copy.commanded, copy.source_index = self.commanded, self.source_index
        copy.modified, copy.done, copy.fallback_active = [*self.modified], [*self.done], self.fallback_active
        copy.answers.needs_fallback = self.answers.needs_fallback
        copy.answers.controllers = {**self.answers.controllers}
        copy._heads = self._heads
        return copy

    def ready_to_step(self) -> bool:
        """Return whether the next timestep may be simulated now."""
        if self.state is not _WAITING:
            return False
        if self.mode is not _LOCKSTEP:
            return True
        return not self.answers.pending and bool(self.claims.required)

    def begin_step(self, now_s: float) -> bytes:
        """Begin a timestep; return its commands (float64, NaN: baseline control)."""
        self.transition(_GO)
        answers, done, all_slots = self.answers, self.done, self.all_slots
        self.fallback_active = answers.needs_fallback and self._count_missed()
        self.step_starts.append((self.episode, self.step, now_s))
        active = all_slots
        if answers.slots and len(answers.slots) < self.slots and self.mode is _LOCKSTEP:
            active = sorted(answers.slots)
        if True in done:
            active = [slot for slot in active if not done[slot]]
        self.active_slots = active
        values, source_index = self.commands.array.resolve()
        if active is all_slots:
            self.modified = self.all_modified
            self.commanded, self.source_index = values, source_index
        else:
            self.modified = [was or slot in active for slot, was in enumerate(self.modified)]
            self._merge(values, source_index, active)
        return values

    def _merge(self, commanded: bytes, source_index: bytes, slots: Sequence[int]) -> None:
        """Replace the commands and their sources in some slots."""
        self.commanded = _with_rows(self.commanded, commanded, slots, self.slots)
        self.source_index = _with_rows(self.source_index, source_index, slots, self.slots)

    def _count_missed(self) -> bool:
        """Count the required controllers without a command for this timestep; return whether there are any."""
        is_lockstep = self.mode is _LOCKSTEP
        missed = [
            c
            for c in self.claims.required
            if (c.name not in self.answers.controllers if is_lockstep else c.state is _BYPASSED)
        ]
        for claimant in missed:
            claimant.stats.missed += 1
        self.counts.missed += bool(missed)
        return bool(missed)

    def claim(self, claim: Claim, now_s: float) -> list[Event]:
        """Add or renew a claim; after a renewal, the controller has to answer the current sample again.

        Raises:
            RequestRejected: unknown actuators, a priority that another connected controller has claimed, or too many
                claims.
        """
        former = self.claims.by_name.get(claim.controller)
        claimant, replaced = self.claims.claim(claim, now_s)
        self.commands.drop_own_expiries(claimant)
        for name in (*replaced, claim.controller):
            self.answers.forget(name)
        self.await_answer(claimant)
        is_same = former is not None and former.priority == claim.priority
        priority = "again" if is_same else f"at priority {claim.priority}"
        return [
            *(
                self.event(EventKind.DISCONNECTED, f"{claim.controller} takes over from {name}", name)
                for name in replaced
            ),
            self.event(EventKind.CONNECTED, f"{claim.controller} controls {priority}", claim.controller),
        ]

    def controllers(self) -> list[ControllerStatus]:
        """Return the status of all controllers with a claim."""
        return [
            ControllerStatus(
                controller=c.name,
                priority=c.priority,
                actuators=int(c.mask.sum()),
                required=c.required,
                state=c.state,
                accepted=c.stats.accepted,
                late=c.stats.late,
                rejected=c.stats.rejected,
                duplicate=c.stats.duplicate,
                missed=c.stats.missed,
                accepted_late=c.stats.accepted_late,
                response=c.stats.response.summary(),
            )
            for c in [*self.claims.by_name.values()]
        ]


def _with_rows(table: bytes, other: bytes, rows: Sequence[int], count: int) -> bytes:
    """Return a table of `count` rows, some of them those of another table."""
    width = len(table) // count
    own = [table[row * width : (row + 1) * width] for row in range(count)]
    for row in rows:
        own[row] = other[row * width : (row + 1) * width]
    return b"".join(own)
