"""The step exchange: messages in, decisions out. No Zenoh, no EnergyPlus, no clock in here.

An episode of N timesteps has N commands and N + 1 samples. Sample 0 is the state after warm-up; command k
answers sample k and rules timestep k + 1; the last sample needs no answer.

    STARTING ──ready──▶ WAITING ──go──▶ RUNNING ──sampled──▶ WAITING … ──ended──▶ ENDED
        ▲                  │                                                       │
        └──────reset───────┴───────────────────────────────────────────────reset───┘

Slots are engines that step together, each in an episode of its own. A slot that no required controller answers
stands still, as does one whose episode is over; the exchange has ended when all of them have.

In lockstep the exchange goes on when each required controller has answered the present sample, and there
is at least one. In free and paced mode it goes on without them. A controller that vanished keeps its claim: by
policy the node waits until it is back or another takes its level over, or goes on without it, holding or releasing
what it commanded, or the episode is aborted. So it is with one that does not answer by the deadline.

Three kinds of messages change nothing and are counted and named in an event: `late` (answers a step that is
over), `duplicate` (answers the present step again), `rejected` (everything else that is wrong). Under the policy to
wait, a command that comes after the deadline still answers the present step: it is taken, and `accepted_late` says so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from bridge.exchange.actuator_commands import CommandSnapshot
from bridge.exchange.fallback import FallbackRules
from bridge.exchange.intake import MAX_MESSAGES_PER_STEP, Intake
from bridge.exchange.state import MAX_SOURCE_NAME, TRANSITIONS, IllegalTransition, Trigger
from topics import codec
from topics.messages import Claim, ControllerStatus, Event, EventKind, Mode, State

__all__ = [
    "MAX_MESSAGES_PER_STEP",
    "MAX_SOURCE_NAME",
    "TRANSITIONS",
    "IllegalTransition",
    "StepExchange",
    "Trigger",
]

# For each timestep: Python 3.11 looks at an enum's member by raising and catching an error.
_GO, _SAMPLED, _OVER, _WAITING, _LOCKSTEP = Trigger.GO, Trigger.SAMPLED, Trigger.ENDED, State.WAITING, Mode.LOCKSTEP


@dataclass(slots=True)
class StepExchange(Intake, FallbackRules):
    """The step exchange of one node."""

    def ready(self, begun: Mapping[int, int] | None = None) -> None:
        """Note that the engines wait: those of `begun` (slot to sample; None: all, at 0) at a first sample."""
        self.transition(Trigger.READY)
        self.step, self.modified, self.done = [*self.step], [*self.modified], [*self.done]
        for slot, step in (begun if begun is not None else dict.fromkeys(self._all, 0)).items():
            self.step[slot] = step
            self.modified[slot] = step > 0
            self.done[slot] = False
        self.open_intake()

    def finish_step(self, last: Sequence[bool]) -> None:
        """The engines have simulated a timestep; `last` of each slot that moved. Call `listen` once it is published."""
        if self.active_slots is self._all:
            steps, ended = [step + 1 for step in self.step], [*last]
        else:
            steps, ended = [*self.step], [*self.done]
            for slot, over in zip(self.active_slots, last, strict=True):
                steps[slot] += 1
                ended[slot] = over
        self.transition(_OVER if all(ended) else _SAMPLED)
        self.step, self.done = steps, ended
        self.commands.timesteps += 1

    def open_intake(self) -> None:
        """Gets ready for the answers to the present sample; apart from `sampled` so that the sample goes first."""
        waived: set[str] = set()
        self._pending = set()
        for claimant in self.claims.by_name.values():
            if claimant.required:
                (waived if claimant.bypassed else self._pending).add(claimant.name)
        self._falls = bool(waived)
        if waived and not self._pending and self.deadline_s is not None:
            self._pending = waived  # nobody is there: the deadline sets the pace
        self._told_s, self._overdue_s = self.now_s, None
        if self._heard:
            self._heard = {}
        self._answered = set()
        self._answers = set()
        self._head = b"" if any(self.done) else codec.command_head(self.episode, self.step, self.commands.size)

    def reset(self, slots: Sequence[int] | None = None) -> None:
        """A new episode begins, in all slots or in some: what was set there is released.

        Claims of controllers that are there stay; those that are gone are forgotten once all slots begin anew.
        """
        self.transition(Trigger.RESET)
        if slots is None or len(set(slots)) == self.slots:
            self.episode = [episode + 1 for episode in self.episode]
            self.commands.clear()
            self.claims.begin_episode()
            return
        self.episode = [episode + (slot in slots) for slot, episode in enumerate(self.episode)]
        self.commands.array.relinquish_slots(slots)

    def capture(self) -> CommandSnapshot:
        """What holds at the present sample."""
        return self.commands.capture()

    def restore(self, held: CommandSnapshot) -> None:
        """Has that hold again; between `reset` and `ready`, or at the very beginning."""
        self.commands.restore(held)
        self.claims.begin_episode()

    def ready_to_step(self) -> bool:
        """Whether the next timestep may be simulated now."""
        if self.state is not _WAITING:
            return False
        if self.mode is not _LOCKSTEP:
            return True
        if self._pending:
            return False
        for claimant in self.claims.by_name.values():  # noqa: SIM110  # a generator costs more than the usual one
            if claimant.required:
                return True
        return False

    def begin_step(self) -> tuple[bytes, bytes]:
        """Starts the timestep: the values that rule it (float64, NaN: the building's own) and who set them (uint16)."""
        self.transition(_GO)
        self.fallback_active = self._falls and self._missed()
        self._went.append((self.episode, self.step, self.now_s))
        if not self._answers or len(self._answers) == self.slots or self.mode is not _LOCKSTEP:
            self.active_slots = self._all
        else:
            self.active_slots = sorted(self._answers)
        if any(self.done):
            self.active_slots = [slot for slot in self.active_slots if not self.done[slot]]
        if self.active_slots is self._all:
            self.modified = self._moved
        else:
            self.modified = [was or slot in self.active_slots for slot, was in enumerate(self.modified)]
        return self.commands.array.resolve()

    def _missed(self) -> bool:
        """Counts the required controllers without which the timestep goes on; whether there are any."""
        lockstep = self.mode is _LOCKSTEP
        missed = [
            c
            for c in self.claims.by_name.values()
            if c.required and (c.name not in self._answered if lockstep else c.bypassed)
        ]
        for claimant in missed:
            claimant.stats.missed += 1
        self.counts.missed += bool(missed)
        return bool(missed)

    def claim(self, claim: Claim) -> list[Event]:
        """Takes or renews a claim; a renewed one answers the present sample again.

        Raises:
            RequestRejected: unknown actuators, or another present controller holds the level on one of them.
        """
        renewed = claim.controller in self.claims.by_name
        claimant, gone = self.claims.claim(claim, self.now_s)
        self.commands.drop_superseded_expiries(claimant)
        for name in (*gone, claim.controller):
            self._pending.discard(name)
            self._answered.discard(name)
        if claim.required and self.state is State.WAITING:
            # Who was waited for only so that the deadline sets the pace is not any more.
            self._pending -= {other.name for other in self.claims.by_name.values() if other.bypassed}
            self._pending.add(claim.controller)
        how = "again" if renewed else f"at level {claim.priority}"
        left = [self.event(EventKind.DISCONNECTED, f"{claim.controller} takes over from {name}", name) for name in gone]
        return [*left, self.event(EventKind.CONNECTED, f"{claim.controller} controls {how}", claim.controller)]

    def controllers(self) -> list[ControllerStatus]:
        """All claims, for the status."""
        return [
            ControllerStatus(
                controller=c.name,
                priority=c.priority,
                actuators=int(c.mask.sum()),
                required=c.required,
                connected=c.connected,
                accepted=c.stats.accepted,
                late=c.stats.late,
                rejected=c.stats.rejected,
                duplicate=c.stats.duplicate,
                missed=c.stats.missed,
                bypassed=c.bypassed,
                unresponsive=c.unresponsive,
                accepted_late=c.stats.accepted_late,
                response=c.stats.response.summary(),
            )
            for c in [*self.claims.by_name.values()]
        ]
