"""The episodes of a node: reset, go back to a snapshot, branch."""

from __future__ import annotations

from collections.abc import Sequence
from time import monotonic

from zenostat.bridge.exchange.step_exchange import StepExchange
from zenostat.bridge.node.branches import BranchManager, Snapshot
from zenostat.bridge.node.manifest import site_fields
from zenostat.bridge.node.plant import AbandonablePlant, Plant
from zenostat.bridge.node.recording import RecordingManager
from zenostat.bridge.node.server import NodeServer, Stopped
from zenostat.topics import keys
from zenostat.topics.errors import RequestRejected, ZenostatError
from zenostat.topics.messages import (
    ANONYMOUS,
    Ack,
    BranchCreated,
    CreateBranch,
    DropSnapshot,
    EventKind,
    Message,
    Reset,
    SnapshotTaken,
    State,
    TakeSnapshot,
)
from zenostat.topics.plurals import counted
from zenostat.topics.seed_validation import MAX_SEED

_PATIENCE_S = 10.0
"""Time that a reset waits at most for the end of a timestep; clients wait for their replies for longer."""


class EpisodeManager:
    """Resets, snapshots and branches of a node. Its methods are for the server's thread.

    A reset is answered before the plant starts, which may take seconds; `_start_episodes` then starts it and publishes
    sample 0.

    Args:
        server: the node on the bus.
        plant: that it simulates.
        branches: the node's snapshots and branches.
        recordings: the node's recordings.
        patience_s: time that a reset waits for a timestep that is being simulated; after that, or after 10 s if that
            is less, the timestep is given up.
    """

    def __init__(
        self,
        server: NodeServer,
        plant: Plant,
        branches: BranchManager,
        recordings: RecordingManager,
        *,
        patience_s: float = _PATIENCE_S,
    ) -> None:
        self._server, self._plant, self._branches, self._recordings = server, plant, branches, recordings
        self._slots = server.manifest.slots
        self._patience_s = min(patience_s, _PATIENCE_S)
        self._received = self._handled = 0
        self._is_watching = False

    @property
    def _exchange(self) -> StepExchange:
        return self._server.exchange

    def declare(self) -> None:
        """Answer requests about episodes, snapshots and branches."""
        subscriptions = self._server.subscriptions
        subscriptions.request(keys.RESET, Reset, self._reset, on_receipt=self._on_receipt)
        subscriptions.request(keys.SNAPSHOT, TakeSnapshot, self._snapshot)
        subscriptions.request(keys.DROP_SNAPSHOT, DropSnapshot, self._drop)
        subscriptions.request(keys.BRANCH, CreateBranch, self._branch)

    def begin_first(self) -> None:
        """Begin the first episodes; the plant is at sample 0. The caller publishes it."""
        self._exchange.ready(monotonic())
        self._server.begin_episodes([*range(self._slots)], [None] * self._slots)
        self._recordings.begin_episodes(dict.fromkeys(range(self._slots), 0), [None] * self._slots, "")
        self._publish_start("", range(self._slots))

    # Resets

    def _on_receipt(self, _: Reset) -> None:
        """Limit the time that a reset waits; in the thread that receives it."""
        self._received += 1
        if not self._is_watching:
            self._watch()

    def _watch(self) -> None:
        self._is_watching, number = True, self._received
        self._server.timer.at(monotonic() + self._patience_s, lambda: self._check(number))

    def _check(self, number: int) -> None:
        self._is_watching = False
        if self._handled < number:
            self._abandon()
        if self._handled < self._received:
            self._watch()

    def _abandon(self) -> None:
        """Give up the timestep, or the start, behind which a reset is still waiting."""
        state = self._server.exchange.state
        if self._server.stopping:
            return
        waited = f"a reset had waited for {self._patience_s:g} s for the end of"
        self._server.trials.interrupt(f"{waited} a trial")
        self._branches.cancel_copying(f"{waited} a copy")
        if state not in (State.RUNNING, State.STARTING):
            return
        if not isinstance(self._plant, AbandonablePlant):
            self._plant.interrupt()
            return
        what, is_starting = ("start", True) if state is State.STARTING else ("timestep", False)
        reason = f"{waited} its {what}"
        self._plant.abandon(reason, is_starting=is_starting)

    def _reset(self, reset: Reset) -> Message:
        self._handled += 1
        requested = reset.slots if reset.slots is not None else [*range(self._slots)]
        if len({*requested}) < len(requested):
            raise RequestRejected(f"slots {requested} name a slot twice")
        by_slot = dict(sorted(zip(requested, seeds_of(reset, len(requested)), strict=True)))
        slots, seeds = [*by_slot], [*by_slot.values()]
        self._server.check_slot(slots[-1])
        if reset.snapshot:
            return self._restore(reset, slots)
        exchange = self._exchange
        if exchange.state is State.FAILED and len(slots) < self._slots:
            raise RequestRejected("the engines have ended; reset all slots")
        untouched = [exchange.state is State.WAITING and not exchange.modified[slot] for slot in slots]
        exchange.reset(slots)
        self._server.failure = self._server.failure_error = ""
        try:
            starts = self._plant.next_episode(slots, seeds, exchange.episode, untouched)
        except ZenostatError as error:
            self._server.fail(error)
            raise
        self._server.subscriptions.post_first(lambda: self._start_episodes(slots, seeds, reset.controller))
        return Ack(episode=exchange.episode, episode_starts=starts)

    def _start_episodes(self, slots: list[int], seeds: list[int | None], source: str) -> None:
        server = self._server
        if server.exchange.state is State.FAILED:  # by an error of this program in between
            return
        try:
            self._plant.start(slots)
        except ZenostatError as error:
            if server.stopping:
                raise Stopped from None
            server.fail(error)
            return
        except Exception as error:  # one of this program shall not end the node
            server.subscriptions.on_error(keys.RESET, source, error)
            return
        self._begin(dict.fromkeys(slots, 0), seeds, source)
        self._plant.clean_up()

    def _begin(
        self, steps: dict[int, int], seeds: list[int | None], source: str, snapshot: Snapshot | None = None
    ) -> None:
        """Begin episodes whose first samples the plant has reached, and publish these.

        Args:
            steps: the first sample of each slot.
            seeds: by slot, for injected faults.
            source: the controller that asked for the reset.
            snapshot: to which the plant has returned.
        """
        server = self._server
        server.exchange.ready(monotonic(), steps, None if snapshot is None else snapshot.commands)
        server.begin_episodes([*steps], seeds)
        previous = server.manifest
        if snapshot is not None:
            server.restore(snapshot.faults, snapshot.received, snapshot.alarms)
        site = self._plant.site(0)
        if previous.weather != site.weather:
            server.describe(site_fields(site))
        if server.manifest != previous:
            server.publications.manifest(server.manifest)
        self._recordings.begin_episodes(steps, seeds, source, "" if snapshot is None else snapshot.name)
        self._publish_start(source, sorted(steps))
        if snapshot is not None:
            server.revoke_again()
        server.publish()

    def _publish_start(self, source: str, slots: Sequence[int]) -> None:
        for warning in self._plant.drain_warnings():
            self._server.event(self._exchange.event(EventKind.WARNING, warning))
        exchange, manifest, first = self._exchange, self._server.manifest, slots[0]
        begins = f"episode {exchange.episode[first]} of {manifest.building} begins"
        if len(slots) < manifest.slots:
            begins += f" in slot{'s' if len(slots) > 1 else ''} {', '.join(map(str, slots))}"
        text = "; ".join([begins, *self._plant.notes(first)])
        numbers = {"episode": exchange.episode[first], "step": exchange.step[first]}
        self._server.event(exchange.event(EventKind.STARTED, text, source).model_copy(update=numbers))
        self._server.publish_warnings()

    # Snapshots and branches

    def _snapshot(self, request: TakeSnapshot) -> Message:
        snapshot = self._branches.snapshot(request)
        self._expect(request.controller)
        self._recordings.snapshot(snapshot.name, snapshot.episode, snapshot.step)
        text = f"snapshot {snapshot.name} at step {snapshot.step[0]}"
        self._server.event(self._exchange.event(EventKind.SNAPSHOT, text, request.controller))
        return SnapshotTaken(snapshot=snapshot.name, episode=snapshot.episode, step=snapshot.step)

    def _expect(self, owner: str) -> None:
        """End the copies of an owner whose end nothing would tell; those without a named owner stay."""
        if owner != ANONYMOUS:
            self._server.subscriptions.expect_presence(owner, self._server.timer)

    def _drop(self, request: DropSnapshot) -> Message:
        access, owner = self._server.access, self._branches.find(request.snapshot).owner
        sender = request.controller
        if access is not None and not (access.is_same_holder(sender, owner) or access.operates(sender)):
            reason = f"snapshot {request.snapshot} is that of {owner!r}"
            self._server.subscriptions.deny(keys.DROP_SNAPSHOT, sender, reason)
        self._branches.drop(request.snapshot)
        return Ack(episode=self._exchange.episode)

    def _branch(self, request: CreateBranch) -> Message:
        branch = self._branches.branch(request)
        self._expect(request.controller)
        self._server.event(self._exchange.event(EventKind.BRANCH_CREATED, f"branch {branch.name}", request.controller))
        return BranchCreated(node=branch.name)

    def _restore(self, reset: Reset, slots: list[int]) -> Message:
        """Go back to a snapshot; if the plant cannot be restored, the present episode continues."""
        exchange = self._exchange
        if len(slots) != self._slots:
            raise RequestRejected("a snapshot contains all slots; reset all of them to it")
        snapshot = self._branches.find(reset.snapshot)
        starts = self._plant.restore(snapshot.plant, [number + 1 for number in exchange.episode])
        exchange.reset()
        self._begin(dict(enumerate(snapshot.step)), [None] * len(slots), reset.controller, snapshot)
        self._plant.clean_up()
        return Ack(episode=exchange.episode, episode_starts=starts)


def seeds_of(reset: Reset, slots: int) -> list[int | None]:
    """Return a seed for each of the slots to reset."""
    if isinstance(reset.seed, list):
        if len(reset.seed) != slots:
            raise RequestRejected(
                f"{counted(len(reset.seed), 'seed')} for {counted(slots, 'slot')}; one each, or a single one"
            )
        return reset.seed
    if reset.seed is None:
        return [None] * slots
    if reset.seed + slots - 1 > MAX_SEED:
        raise RequestRejected(
            f"seed {reset.seed}: slot {slots - 1} would have {reset.seed + slots - 1}, above 2**64 - 1"
        )
    return [reset.seed + index for index in range(slots)]
