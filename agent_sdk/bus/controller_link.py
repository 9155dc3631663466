"""One controller's hold on one node: its samples in, its commands out."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
import zenoh
from numpy.typing import NDArray
from zenoh import CongestionControl
from zenoh.handlers import FifoChannel

from agent_sdk.bus.presence import NodeWatch, undeclare
from agent_sdk.bus.sample import SampleView
from bridge.runtime import affinity
from bridge.runtime.affinity import Affinity
from bridge.runtime.polling import Polling
from bridge.transport.wakeup import Wake
from topics import codec, keys
from topics.errors import (
    EpisodeChanged,
    InvalidAction,
    NodeLost,
    NodeNotFound,
    PeerError,
    RequestRejected,
    UsageError,
    ZenostatError,
    did_you_mean,
    from_wire,
)
from topics.messages import (
    Ack,
    Claim,
    Command,
    CommandOp,
    Event,
    EventKind,
    Flag,
    Manifest,
    Reset,
    Sample,
    State,
    WeatherSeries,
)
from topics.seeds import check_seed

if TYPE_CHECKING:
    from agent_sdk.bus.bus import Bus

# Plain numbers: what a signal raises while NumPy looks at an enum's member is lost, a Ctrl-C for one.
_KEEP, _SET, _RELEASE = int(CommandOp.KEEP), int(CommandOp.SET), int(CommandOp.RELINQUISH)
_TRUNCATED = int(Flag.TRUNCATED)
_INBOX = 1024


_BUSY = "another thread is in receive() or reset() of this controller; one thread at a time, or a controller for each"


def _points(manifest: Manifest) -> tuple[Any, ...]:
    """What a controller relies on; a node may be restarted with other weather or another period."""
    return manifest.slots, manifest.sensors, manifest.meters, manifest.actuators, manifest.task, manifest.steps_per_hour


def _is_after(new: Sample, old: Sample) -> bool:
    """Whether a slot has gone on; of the same episodes."""
    return new.step > old.step or any(step > was for step, was in zip(new.step, old.step, strict=True))


class ControllerLink:
    """One controller's hold on one node. Iterate over it, or call `receive` and `send` in turn.

    One thread at a time may wait for samples; another thread may send, or close.

    A node of several slots has them all in one sample and one command: see `SampleView.message`.

    Attributes:
        manifest: what the node is.
        name: this controller's name on the bus.
        accepted: the node's answer to the latest reset.
    """

    accepted: Ack

    def __init__(self, bus: Bus, node: str, claim: Claim, placement: Affinity) -> None:
        self.bus = bus
        self.name = claim.controller
        self._claim, self._claimed = claim, False
        self._close = ExitStack()
        self._wake = Wake(bus.session, keys.wake(node))
        self._busy = False
        self._ended: ZenostatError | None = None
        self._closed: ZenostatError | None = None
        self._latest: SampleView | None = None
        self._answered, self._over = True, False
        with ExitStack() as undo:
            undo.callback(self.close)
            self.manifest = bus.manifest(node)
            self._open(bus.session)
            undo.pop_all()
        near_node = self.manifest.host == affinity.host()
        self._polling = Polling(enabled=near_node and placement is Affinity.NODE)

    def _open(self, session: zenoh.Session) -> None:
        """Listens first, claims last: nothing that the node says afterwards is missed."""
        manifest, claim = self.manifest, self._claim
        self._names = {name: i for i, name in enumerate(manifest.names)}
        self._actuators = {a.name: i for i, a in enumerate(manifest.actuators)}
        self._shape = (manifest.slots, len(manifest.actuators)) if manifest.slots > 1 else (len(manifest.actuators),)
        self._sample_key = keys.SAMPLE.at(manifest.node)
        self._wake_key = keys.wake(manifest.node)
        declare = self._close.enter_context
        self._inbox = session.declare_subscriber(keys.stream(manifest.node), FifoChannel(_INBOX))
        self._close.callback(undeclare, self._inbox)
        self._close.callback(self._drain)
        self._recv, self._try_recv = self._inbox.recv, self._inbox.try_recv
        self._node = NodeWatch(session, manifest.node, self._on_loss)
        self._close.callback(self._node.close)
        self._node.watch(manifest.instance)
        declare(session.liveliness().declare_token(keys.CONTROLLER_TOKEN.at(manifest.node, name=claim.controller)))
        commands = session.declare_publisher(
            keys.COMMAND.at(manifest.node, name=claim.controller),
            encoding=zenoh.Encoding(codec.encoding(Command)),
            congestion_control=CongestionControl.BLOCK,
        )
        self._close.callback(undeclare, commands)
        self._put_command = commands.put
        self._take_claim()

    @property
    def lost(self) -> bool:
        """Whether the node has been off the bus since this controller last joined it."""
        return self._node.lost

    def _on_loss(self) -> None:
        self._claimed = False
        self._wake()

    def _take_claim(self) -> None:
        if not self._node.wait():
            raise NodeNotFound(f"node {self.manifest.node!r} has gone")
        self.bus.claim(self.manifest.node, self._claim)
        self._claimed = True

    def _claim_again(self) -> None:
        """Joins the node after a lost link, in which it may have forgotten this controller, or was restarted.

        Raises:
            NodeNotFound: it is not on the bus.
            NodeLost: a node of its name is there that has other points.
        """
        manifest = self.bus.manifest(self.manifest.node)
        self._node.lost = False  # before anything that a second loss could come between
        if manifest.instance != self.manifest.instance:
            if _points(manifest) != _points(self.manifest):
                raise NodeLost(
                    f"node {manifest.node!r} was restarted with other points, slots or actions; "
                    "take control of it again, or make another environment"
                )
            self.manifest = manifest
            self._node.watch(manifest.instance)
        self._take_claim()

    def _drain(self) -> None:
        # A full inbox would hold up the session's close.
        with suppress(zenoh.ZError, RuntimeError):  # another thread is within it, and takes what is there
            while self._inbox.try_recv() is not None:
                pass

    def __enter__(self) -> ControllerLink:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Lets go of the node; twice is fine. Another thread's `receive` or `reset` ends with `EpisodeChanged`."""
        self._closed = EpisodeChanged(f"{self.name} has let go of its node; take control of it again")
        self._ended = self._ended or self._closed
        if self._busy:
            self._wake()
        self._wake.close()
        self._close.close()
        self.bus.forget(self)

    def forked(self, error: ZenostatError, session: Any) -> None:
        """Disowns the link in a forked process: all that is asked of it raises `error`, and closing it does nothing."""
        self._closed = self._ended = error
        self._close, self._busy = ExitStack(), False
        self._wake = Wake(session, self._wake.key)  # another thread may have held the lock of the former
        self._wake.close()

    # Samples

    def reset(
        self,
        *,
        seed: int | list[int | None] | None = None,
        slots: list[int] | None = None,
        snapshot: str = "",
    ) -> SampleView:
        """Starts a new episode and waits for its first sample.

        Args:
            seed: see `Reset`.
            slots: those that begin anew; None is all.
            snapshot: go back to it in place of sample 0.
        """
        seed = [one if one is None else check_seed(one) for one in seed] if isinstance(seed, list) else seed
        seed = check_seed(seed) if seed is not None and not isinstance(seed, list) else seed
        request = Reset(controller=self.name, seed=seed, slots=slots, snapshot=snapshot)
        busy, self._busy = self._busy, True
        if busy:
            raise UsageError(_BUSY)
        try:
            if self._closed is not None:
                raise self._closed
            if not self._claimed:
                self._claim_again()
            accepted = self.accepted = self.bus.reset(self.manifest.node, request)
            self._ended = self._closed
            self._answered = True
            self._latest = None
            while True:
                sample = self._next(changes=True)
                if sample.message.episode == accepted.episode:
                    return self._keep(sample)
        finally:
            self._busy = False

    def weather(self, columns: Sequence[str], slot: int = 0) -> WeatherSeries:
        """Columns of the weather file that a slot's present episode reads; `UnknownName` lists them."""
        return self.bus.weather(self.manifest.node, columns, slot)

    def scenario(self) -> str:
        """The scenario that the node simulates, as a scenario file (YAML)."""
        return self.bus.scenario(self.manifest.node)

    def current(self) -> SampleView:
        """The sample that the node stands at, for a controller that has just come."""
        status = self.bus.status(self.manifest.node)
        if status.state is State.FAILED:
            raise from_wire({"error": status.failure_error, "message": status.failure})
        if status.state is State.ENDED:
            return self.reset()
        if status.state is not State.WAITING:
            return self.receive()  # the present sample is answered already; the next one is on its way
        return self._keep(self._view(self.bus.latest(self.manifest.node)))

    def set_current(self, sample: Sample) -> SampleView:
        """Takes a sample for the present one: of a branch, which stands where its parent stood."""
        return self._keep(self._view(sample))

    def receive(self) -> SampleView:
        """Waits for the next sample.

        Raises:
            NodeLost: the node is gone.
            SimulatorError: EnergyPlus failed, with its words.
            RequestRejected: the node did not take this controller's last command.
            EpisodeChanged: somebody else reset the episode, or another thread closed the link.
            UsageError: another thread is in `receive` or `reset`.
        """
        busy, self._busy = self._busy, True  # one statement without a call: CPython switches no threads within it
        if busy:
            raise UsageError(_BUSY)
        try:
            previous = self._latest
            while True:
                sample = self._next(changes=False)
                if previous is None:
                    return self._keep(sample)
                episode, known = sample.message.episode, previous.message.episode
                if episode == known and _is_after(sample.message, previous.message):
                    return self._keep(sample)
                if any(one > other for one, other in zip(episode, known, strict=True)):
                    raise EpisodeChanged(f"node {self.manifest.node!r} was reset by somebody else{self._where()}")
        finally:
            self._busy = False

    def _keep(self, sample: SampleView) -> SampleView:
        self._latest, flags = sample, sample.message.flags
        over = flags[0] & _TRUNCATED != 0 and all(flag & _TRUNCATED for flag in flags)
        self._answered = self._over = over
        return sample

    def _next(self, *, changes: bool) -> SampleView:
        """The next sample in the inbox; what ended the samples once is raised again."""
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
                return self._view(codec.decode(Sample, message.payload.to_bytes(), str(message.encoding)))
            self._hear(key, message, changes=changes)

    def _view(self, sample: Sample) -> SampleView:
        return SampleView(sample, self.manifest, self._names, self)

    def _hear(self, key: str, message: zenoh.Sample, *, changes: bool) -> None:
        """What is not a sample: raises what ends the wait."""
        node = self.manifest.node
        if self._closed is not None:
            raise self._closed
        if key == self._wake_key and self._node.lost:
            self._ended = NodeLost(f"node {node!r} is gone{self._where()}; nothing more can be known of it")
            raise self._ended
        if key != keys.EVENT.at(node):
            return
        event = codec.decode(Event, message.payload.to_bytes(), str(message.encoding))
        if event.kind is EventKind.FAILED and not (changes and event.episode != self.accepted.episode[0]):
            self._ended = from_wire({"error": event.error, "message": event.text})
            raise self._ended
        if event.kind is EventKind.STOPPED:
            self._claimed = False
            self._ended = NodeLost(f"node {node!r} was stopped{self._where()}")
            raise self._ended
        if event.kind is EventKind.REJECTED and event.source == self.name and not changes:
            self._claimed = False  # it may be that; the next reset claims again
            raise RequestRejected(f"node {node!r} did not take the command{self._where()}: {event.text}")
        if event.kind is EventKind.STARTED and not changes and self._latest and event.episode != self._latest.episode:
            who = event.source or "somebody else"
            raise EpisodeChanged(f"node {node!r} was reset by {who}{self._where()}; episode {event.episode} runs now")

    def _where(self) -> str:
        return f" (last sample: episode {self._latest.episode}, step {self._latest.step})" if self._latest else ""

    # Commands

    def send(
        self,
        values: Mapping[str, float | None] | NDArray[np.float64] | None = None,
        operations: bytes | None = None,
        *,
        still: Collection[int] = (),
    ) -> None:
        """Answers the present sample. An episode's last sample takes no answer: nothing is sent.

        Args:
            values: by actuator name, None releasing it to the building's own control and the others kept
                as they are; or an array of all actuators in manifest order, shape (actuators,), of several slots
                (slots, actuators); or None to keep all.
            operations: with an array, a `CommandOp` byte for each of its values; None sets all.
            still: slots that are to stand still while the others go on.

        Raises:
            InvalidAction: an unknown actuator, a wrong shape, or a value that is not finite.
        """
        if self._latest is None:
            raise PeerError("there is no sample to answer yet; receive one first")
        if self._ended is not None:
            raise self._ended
        if self._over:
            return
        wire = self._latest.message
        raw, operations = self._coded(values, operations)
        steps = [None if slot in still else step for slot, step in enumerate(wire.step)] if still else wire.step
        self._answered = True
        try:
            self._put_command(codec.pack(episode=wire.episode, step=steps, operations=operations, values=raw))
        except (zenoh.ZError, RuntimeError):
            if self._ended is None:
                raise
            raise self._ended from None

    def _coded(
        self, values: Mapping[str, float | None] | NDArray[np.float64] | None, operations: bytes | None
    ) -> tuple[bytes, bytes | None]:
        if isinstance(values, np.ndarray):
            if values.shape != self._shape:
                raise InvalidAction(f"values of shape {values.shape}; {self._shape} expected: one for each actuator")
            return values.astype(codec.FLOAT, copy=False).tobytes(), operations
        slots, count = self.manifest.slots, len(self.manifest.actuators)
        row, codes = np.zeros(count), np.full(count, _KEEP, np.uint8)
        for name, value in (values or {}).items():
            if name not in self._actuators:
                raise InvalidAction(
                    f"node {self.manifest.node!r} has no actuator {name!r}; {did_you_mean(name, self._actuators)}"
                )
            index = self._actuators[name]
            if value is not None and not np.isfinite(value):
                raise InvalidAction(f"{name} = {value}; a finite number or None (release) expected")
            row[index], codes[index] = (0.0, _RELEASE) if value is None else (value, _SET)
        return row.tobytes() * slots, codes.tobytes() * slots

    def __iter__(self) -> Iterator[SampleView]:
        """Samples from the present one to the episode's last; one that was not answered keeps all as it is."""
        sample = self.current()
        while True:
            yield sample
            if sample.truncated:
                return
            if not self._answered:
                self.send()
            sample = self.receive()
