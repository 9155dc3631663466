"""The connection of one controller to one node: samples in, commands out."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from types import TracebackType
from typing import Any

import zenoh
from zenoh.handlers import RingChannel

from zenostat.bridge.client.command_publisher import CommandPublisher
from zenostat.bridge.client.connection import Connection, build
from zenostat.bridge.client.presence import NodeWatch, check_interface, undeclare
from zenostat.bridge.client.receive_watchdog import ReceiveWatchdog, query_sample
from zenostat.bridge.client.sample import SampleView, is_after
from zenostat.bridge.client.thread_guard import one_thread
from zenostat.bridge.client.trials import CommandValues, PendingTrial, trial_request, tried_samples
from zenostat.bridge.runtime import affinity
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.bridge.runtime.polling import Polling
from zenostat.bridge.transport.wakeup import Wake, stream_wake
from zenostat.topics import codec, keys
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import (
    EpisodeChanged,
    InvalidConfig,
    NodeLost,
    NodeNotFound,
    RequestRejected,
    UsageError,
    ZenostatError,
    from_wire,
)
from zenostat.topics.messages import (
    Ack,
    Claim,
    Event,
    EventKind,
    Flag,
    Manifest,
    Mode,
    Reset,
    Sample,
    State,
    TrySteps,
    WeatherSeries,
)
from zenostat.topics.points import value_index
from zenostat.topics.seed_validation import check_seed

_numbers = itertools.count()
_TRUNCATED = int(Flag.TRUNCATED)
_INBOX = 1024
"""Messages that wait for `receive`. Beyond them the oldest is dropped; else Zenoh would deliver no reply either."""

_one_receiver = one_thread(
    "another thread is in receive() or reset() of this controller; one thread at a time, or a controller for each"
)


class ControllerLink:
    """The connection of one controller to one node. Iterate over it, or call `receive` and `send` in turn.

    Only one thread at a time may wait for samples; other threads may send or close.

    A sample or command of a node with several slots contains all of them: see `SampleView.message`.

    Attributes:
        manifest: The node's manifest.
        name: This controller's name on the bus.
        accepted: The node's answer to the latest reset.
        paced_by: Who has set the node's mode, or paused or resumed it, since this controller is connected; empty if
            unknown.
        on_wait: Called by `receive` and `reset` where they have waited for a second, and again every few seconds.
    """

    accepted: Ack

    def __init__(self, bus: Connection, node: str, claim: Claim, placement: Affinity) -> None:
        self.bus = bus
        self.name = claim.controller
        self._claim, self._claimed = claim, False
        self._close = ExitStack()
        self._wake = stream_wake(bus.session, node)
        self._busy = False
        self._ended: ZenostatError | None = None
        self._closed: ZenostatError | None = None
        self._latest: SampleView | None = None
        self._answered, self._done = True, False
        self.on_wait: Callable[[], None] = lambda: None
        self._watchdog = ReceiveWatchdog(bus.timer, lambda: self._busy and self._latest, self._wake)
        self._close.callback(self._watchdog.close)
        with ExitStack() as undo:
            undo.callback(self.close)
            self.manifest = bus.manifest(node)
            self._mode, self._described, self.paced_by = self.manifest.mode, b"", ""
            self._open(bus.session)
            undo.pop_all()
        self._placement = bus.placement
        same_host = self.manifest.host == affinity.host()
        self._polling = Polling(enabled=same_host and placement is Affinity.NODE)

    def _open(self, session: zenoh.Session) -> None:
        """Subscribe first and claim last, so that no message after the claim is missed."""
        manifest, claim = self.manifest, self._claim
        self._names = value_index(manifest)
        self._sample_key = keys.SAMPLE.at(manifest.node)
        declare = self._close.enter_context
        self._inbox = session.declare_subscriber(keys.stream(manifest.node), RingChannel(_INBOX))
        self._close.callback(undeclare, self._inbox)
        self._recv, self._try_recv = self._inbox.recv, self._inbox.try_recv
        self._node = NodeWatch(session, manifest.node, self._on_loss)
        self._close.callback(self._node.close)
        self._node.watch(manifest.instance)
        declare(session.liveliness().declare_token(keys.CONTROLLER_TOKEN.at(manifest.node, sender=claim.controller)))
        commands = CommandPublisher(session, manifest, claim.controller)
        self._close.callback(commands.close)
        self._encode_command, self._put_command = commands.encode, commands.put
        self._take_claim()

    @property
    def mode(self) -> Mode:
        """Mode of the node, as far as its messages have been received.

        Raises:
            BadMessage: Its latest manifest is not valid.
        """
        described, self._described = self._described, b""
        if described:
            self._mode = codec.decode(Manifest, described).mode
        return self._mode

    @property
    def lost(self) -> bool:
        """Whether the node has left the bus since this controller last claimed its actuators."""
        return self._node.lost

    def _on_loss(self) -> None:
        self._claimed = False
        self._wake()

    def _take_claim(self) -> None:
        if not self._node.wait():
            raise NodeNotFound(f"node {self.manifest.node!r} is not on the bus")
        self.bus.claim(self.manifest.node, self._claim)
        self._claimed = True

    def _claim_again(self) -> None:
        """Claim again after the connection was lost; the node may have dropped the claim, or was restarted.

        Raises:
            NodeNotFound: The node is not on the bus.
            NodeLost: The node was restarted with other points.
        """
        manifest = self.bus.manifest(self.manifest.node)
        self._mode, self._described = manifest.mode, b""
        self._node.lost = False  # first, so that a second loss from here on is noticed
        if manifest.instance != self.manifest.instance:
            check_interface(manifest, self.manifest)
            self.manifest = manifest
            self._node.watch(manifest.instance)
        self._take_claim()

    def __enter__(self) -> ControllerLink:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Disconnect from the node; idempotent. Pending calls in other threads raise `EpisodeChanged`."""
        self._closed = EpisodeChanged(f"{self.name} is disconnected from its node; connect another controller")
        self._ended = self._ended or self._closed
        if self._busy:
            self._wake()
        self._wake.close()
        self._close.close()
        self.bus.forget(self)

    def forked(self, error: ZenostatError, session: Any) -> None:
        """Disown the link in a forked process: every call raises `error`, and closing does nothing."""
        self._closed = self._ended = error
        self._close, self._busy = ExitStack(), False
        self._wake = Wake(session, self._wake.key)  # another thread may have held the previous one's lock at the fork
        self._wake.close()

    # Samples

    @_one_receiver
    def reset(
        self, *, seed: int | list[int | None] | None = None, slots: list[int] | None = None, snapshot: str = ""
    ) -> SampleView:
        """Start a new episode and wait for its first sample.

        Args:
            seed: See `Reset`.
            slots: Slots that start a new episode; None is all.
            snapshot: Name of a snapshot to return to instead of sample 0.

        Raises:
            NodeNotFound: The node is not on the bus.
            NodeLost: It was restarted with other points, or is lost while waiting.
            UsageError: Another thread is in `receive` or `reset`.
        """
        if isinstance(seed, list):
            seed = [None if slot_seed is None else check_seed(slot_seed) for slot_seed in seed]
        elif seed is not None:
            seed = check_seed(seed)
        request = Reset(controller=self.name, seed=seed, slots=slots, snapshot=snapshot)
        if self._closed is not None:
            raise self._closed
        if not self._claimed:
            self._claim_again()
        accepted = self.accepted = self.bus.reset(self.manifest.node, request)
        self._ended = self._closed
        self._answered = True
        self._latest = None
        while True:
            sample = self._next(resetting=True)
            if sample.message.episode == accepted.episode:
                return self._keep(sample)

    def weather(self, columns: Sequence[str], slot: int = 0) -> WeatherSeries:
        """Return weather of a slot's current episode, noise included; `UnknownName` lists the columns."""
        return self.bus.weather(self.manifest.node, columns, slot)

    def scenario(self) -> str:
        """Return the scenario that the node simulates, as the text of a scenario file (YAML)."""
        return self.bus.scenario(self.manifest.node)

    def current(self) -> SampleView:
        """Return the node's current sample, for a controller that has just connected."""
        node, sample = self.manifest.node, None
        with suppress(RequestRejected):  # there is none yet
            sample = self._view(self.bus.latest(node))
        status = self.bus.status(node)
        if status.state is State.FAILED:
            raise from_wire({"error": status.failure_error, "message": status.failure})
        if status.state is State.ENDED:
            return self.reset()
        if self._claimed:
            self._ended = self._closed  # an error that ended an earlier episode
        if sample is not None and sample.message.episode == status.episode:
            if status.state is State.WAITING and sample.message.step == status.step:
                return self._keep(sample)
            self._latest = sample  # it is answered already; the next one follows
        return self.receive()

    def set_current(self, sample: Sample) -> SampleView:
        """Make `sample` the current one, as for a branch, which continues from its parent's sample."""
        return self._keep(self._view(sample))

    @_one_receiver
    def receive(self) -> SampleView:
        """Wait for the next sample.

        A controller that has just connected waits for the first sample of an episode that somebody begins. For the
        present sample, which a node in lockstep may be waiting for it to answer, it has `current`.

        Raises:
            NodeLost: The node is gone.
            SimulatorError: The plant failed; the text contains its messages.
            RequestRejected: The node rejected this controller's last command.
            EpisodeChanged: Another controller reset the node, or another thread closed the link.
            UsageError: Another thread is in `receive` or `reset`.
        """
        previous = self._latest
        while True:
            sample = self._next(resetting=False)
            if previous is None:
                return self._keep(sample)
            episode, current = sample.message.episode, previous.message.episode
            if episode == current and is_after(sample.message, previous.message):
                return self._keep(sample)
            if any(new > old for new, old in zip(episode, current, strict=True)):
                raise EpisodeChanged(f"node {self.manifest.node!r} was reset by another controller{self._where()}")

    def _keep(self, sample: SampleView) -> SampleView:
        self._latest, flags = sample, sample.message.flags
        done = flags[0] & _TRUNCATED != 0 and all(flag & _TRUNCATED for flag in flags)
        self._answered = self._done = done
        return sample

    def _next(self, *, resetting: bool) -> SampleView:
        """Return the next sample from the inbox; an error that ended the stream is raised again."""
        if self._ended is not None:
            raise self._ended
        while True:
            try:
                message = self._polling.wait(self._try_recv, self._recv)
            except (zenoh.ZError, RuntimeError):
                if self._ended is None:
                    raise
                raise self._ended from None
            key = str(message.key_expr)
            if key == self._sample_key:
                if self._placement is not None:
                    self._placement.count()
                return self._view(codec.decode(Sample, message.payload.to_bytes(), str(message.encoding)))
            self._on_message(key, message, resetting=resetting)
            if self._watchdog.is_due and (sample := self._query(resetting=resetting)) is not None:
                return sample

    def _query(self, *, resetting: bool) -> SampleView | None:
        """After a long wait, return the node's current sample, or raise what has ended the stream."""
        self._watchdog.is_due = False
        try:
            sample = query_sample(self.bus, self.manifest.node, self.name)
        except ZenostatError as error:
            self._claimed = False
            self._ended = None if isinstance(error, RequestRejected) else error
            raise
        self.on_wait()
        return None if sample is None or (self._latest is None and not resetting) else self._view(sample)

    def _view(self, sample: Sample) -> SampleView:
        return SampleView(sample, self.manifest, self._names, self)

    def _on_message(self, key: str, message: zenoh.Sample, *, resetting: bool) -> None:
        """Handle a message that is not a sample; raise the error that ends the wait, if it does."""
        node = self.manifest.node
        if self._closed is not None:
            raise self._closed
        if key == self._wake.key and self._node.lost:
            self._ended = self.bus.lost(node, self._where())
            raise self._ended
        if key == keys.MANIFEST.at(node):
            self._described = message.payload.to_bytes()
            self.paced_by = ""  # the event that follows names who
            return
        if key != keys.EVENT.at(node):
            return
        event = codec.decode(Event, message.payload.to_bytes(), str(message.encoding))
        if event.kind is EventKind.PACE and event.source:
            self.paced_by = event.source
        if event.kind is EventKind.FAILED and not (resetting and event.episode != self.accepted.episode[0]):
            self._ended = from_wire({"error": event.error, "message": event.text})
            raise self._ended
        if event.kind is EventKind.STOPPED:
            self._claimed = False
            self._ended = NodeLost(f"node {node!r} was stopped{self._where()}")
            raise self._ended
        if event.kind is EventKind.REJECTED and event.source == self.name and not resetting:
            self._claimed = False  # a missing claim may be the reason; the next reset claims again
            raise RequestRejected(f"node {node!r} rejected the command{self._where()}: {event.text}")
        if event.kind is EventKind.STARTED and not resetting and self._latest and event.episode != self._latest.episode:
            source = event.source or "another controller"
            raise EpisodeChanged(
                f"node {node!r} was reset by {source}{self._where()}; it is now in episode {event.episode}"
            )

    def _where(self) -> str:
        return f" (last sample: episode {self._latest.episode}, step {self._latest.step})" if self._latest else ""

    # Commands

    def send(
        self,
        values: Mapping[str, float | None] | Floats | None = None,
        operations: bytes | None = None,
        *,
        still: Collection[int] = (),
    ) -> None:
        """Answer the current sample. An episode's last sample has no answer: nothing is sent.

        Args:
            values: Values by actuator name, where None relinquishes an actuator to the baseline control and actuators
                that are not named keep theirs; or an array of all actuators in manifest order, of shape (actuators,),
                for several slots (slots, actuators); or None to keep all values.
            operations: With an array, a `CommandOp` byte for each of its values; None sets all.
            still: Slots that do not advance in this timestep.

        Raises:
            InvalidAction: Unknown actuator, wrong shape, or a value of a mapping that is not finite. Values of an array
                are checked by the node: `receive` then raises `RequestRejected`.
            UsageError: There is no sample to answer yet.
        """
        if self._latest is None:
            raise UsageError("there is no sample to answer yet; call current() or reset() first")
        if self._ended is not None:
            raise self._ended
        if self._done:
            return
        payload = self._encode_command(self._latest.message, values, operations, still)
        self._answered = True
        try:
            self._put_command(payload)
        except (zenoh.ZError, RuntimeError):
            if self._ended is None:
                raise
            raise self._ended from None

    def try_step(self, alternatives: Sequence[CommandValues]) -> list[SampleView]:
        """Return the sample that would follow each of several alternative answers to the current sample.

        Nothing is answered; the node stays at its sample.

        Args:
            alternatives: 1 to 256 commands, each as in `send`.

        Raises:
            RequestRejected: The node has another sample by now, or a value is out of bounds.
            InvalidAction, InvalidConfig, ForkFailed, SimulatorError: As for `Bus.try_step`.
        """
        return [sample for (sample,) in self.try_steps([[values] for values in alternatives])]

    def try_steps(self, alternatives: Sequence[Sequence[CommandValues]]) -> list[list[SampleView]]:
        """Return the samples that would follow each of several sequences of commands; see `Bus.try_steps`."""
        if self._latest is None:
            raise UsageError("there is no sample to try from yet; call receive() or reset() first")
        request = trial_request(self.manifest, alternatives, at=self._latest.message)
        return self.trial(request)

    def trial(self, request: TrySteps) -> list[list[SampleView]]:
        """Send the request for a trial; return the samples of each alternative."""
        return self.finish_trial(self.begin_trial(request))

    def begin_trial(self, request: TrySteps) -> PendingTrial:
        """Send the request for a trial; `finish_trial` waits for its reply."""
        if self._ended is not None:
            raise self._ended
        reply = self.bus.begin_trial(self.manifest.node, request.model_copy(update={"controller": self.name}))
        return PendingTrial(reply, request.alternatives)

    def finish_trial(self, pending: PendingTrial) -> list[list[SampleView]]:
        """Wait for a trial that `begin_trial` began; return the samples of each alternative."""
        reply = self.bus.finish_trial(self.manifest.node, pending.reply)
        return tried_samples(reply, pending.alternatives, self.manifest)

    def __iter__(self) -> Iterator[SampleView]:
        """Yield samples from the current one to the episode's last; without an answer all values are kept."""
        sample = self.current()
        while True:
            yield sample
            if sample.truncated:
                return
            if not self._answered:
                self.send()
            sample = self.receive()


def open_link(
    bus: Connection,
    node: str,
    *,
    name: str = "controller",
    priority: int = 10,
    actuators: list[str] | None = None,
    required: bool = True,
) -> ControllerLink:
    """Connect a controller to a node; see `Bus.controller`."""
    suffix = f"-{os.getpid()}-{next(_numbers)}"
    unique = keys.check_name(name, "the controller") + suffix
    if len(unique) > keys.MAX_NAME:
        longest = keys.MAX_NAME - len(suffix)
        raise InvalidConfig(f"the controller {name!r}: use up to {longest} characters, since {suffix!r} is added to it")
    claim = build(Claim, controller=bus.sender(unique), priority=priority, actuators=actuators, required=required)
    try:
        link = ControllerLink(bus, node, claim, bus.affinity)
    except RequestRejected as error:
        own = [link.name for link in bus.links if isinstance(link, ControllerLink)]
        if holder := next((name for name in own if repr(name) in str(error)), ""):
            text = f"{holder!r} is a controller of this connection: use it again, or close it first"
            raise RequestRejected(f"{error}; {text}") from None
        raise
    bus.adopt(link)
    return link
