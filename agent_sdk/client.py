"""A controller's side of the bus, without Gymnasium.

with agent_sdk.connect("tcp/127.0.0.1:7447") as bus:
    for sample in bus.controller("office"):
        sample.send({"core_zn_cooling_setpoint": 26.0})
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from types import TracebackType
from typing import TypeVar

import numpy as np
import zenoh
from numpy.typing import NDArray
from zenoh import CongestionControl, Locality
from zenoh.handlers import Callback, FifoChannel, RingChannel

from agent_sdk.sample import SampleView
from bridge import affinity
from bridge.affinity import Affinity
from bridge.polling import Polling
from bridge.session import DEFAULT_ENDPOINT, open_session
from topics import codec, keys
from topics.errors import (
    EpisodeChanged,
    InvalidAction,
    NodeLost,
    NothingThere,
    PeerError,
    Refused,
    from_wire,
    near,
)
from topics.messages import (
    Accepted,
    Ask,
    Claim,
    Command,
    Denied,
    Event,
    EventKind,
    Manifest,
    Mask,
    Message,
    Reset,
    Sample,
    State,
    Status,
    Stop,
)

R = TypeVar("R", bound=Message)

_REQUEST_TIMEOUT_S = 600.0  # a start of the largest bundled building takes 14 s; death is noticed at once
_INBOX = 1024
_LISTEN = 16384
_numbers = itertools.count()


def connect(
    endpoint: str = DEFAULT_ENDPOINT,
    *,
    wait: bool = False,
    affinity: Affinity = Affinity.APART,
    core: int | None = None,
) -> Bus:
    """Connects to the bus at `endpoint`; use it with `with`.

    Args:
        endpoint: `tcp/HOST:PORT` or `unixsock-stream/PATH`.
        wait: keep trying in the background instead of failing.
        affinity: where this process's bus threads run; see `bridge.affinity`.
        core: the node's core, if it is known already.

    Raises:
        NothingThere: nobody listens there.
        InvalidConfig: no such form of an endpoint.
    """
    return Bus(endpoint, wait=wait, affinity=affinity, core=core)


class Bus:
    """A connection to the nodes that are reached by one endpoint."""

    def __init__(self, endpoint: str, *, wait: bool, affinity: Affinity, core: int | None) -> None:
        self.endpoint = endpoint
        self._close = ExitStack()
        self._affinity = Affinity(affinity)
        with _placed(self._affinity, core):
            self.session = self._close.enter_context(open_session(connect=[endpoint], wait=wait))

    def __enter__(self) -> Bus:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leaves the bus; twice is fine."""
        self._close.close()

    def nodes(self) -> list[str]:
        """Names of the nodes that are there."""
        replies = self.session.liveliness().get(keys.NODE_TOKEN.at("*", name="*"))
        return sorted({keys.node_of(str(r.ok.key_expr)) for r in replies if r.ok})

    def controllers(self) -> list[tuple[str, str]]:
        """(node, controller) of all controllers that are there."""
        replies = self.session.liveliness().get(keys.CONTROLLER_TOKEN.at("*", name="*"))
        found = [str(r.ok.key_expr) for r in replies if r.ok]
        return sorted({(keys.node_of(key), keys.last_of(key)) for key in found})

    def manifest(self, node: str) -> Manifest:
        """All that is to know of a node; `NothingThere` if it is not on the bus."""
        return self._ask(keys.MANIFEST, node, None, Manifest)

    def status(self, node: str) -> Status:
        """Where a node stands; `NothingThere` if it is not on the bus."""
        return self._ask(keys.STATUS, node, Ask(), Status)

    def stop(self, node: str) -> None:
        """Tells a node to end."""
        self._ask(keys.STOP, node, Stop(), Accepted)

    def latest(self, node: str) -> Sample:
        """The node's latest sample."""
        return self._ask(keys.SAMPLE, node, None, Sample)

    def claim(self, node: str, claim: Claim) -> Accepted:
        """Claims actuators of a node; `Refused` says who holds them."""
        return self._ask(keys.CLAIM, node, claim, Accepted)

    def reset(self, node: str, reset: Reset) -> Accepted:
        """Starts a new episode of a node."""
        return self._ask(keys.RESET, node, reset, Accepted)

    def _ask(self, topic: keys.Topic, node: str, question: Message | None, answer: type[R]) -> R:
        replies = self.session.get(
            topic.at(node),
            payload=codec.encode(question) if question else None,
            encoding=zenoh.Encoding(codec.encoding(type(question))) if question else None,
            timeout=_REQUEST_TIMEOUT_S,
        )
        for reply in replies:
            if reply.ok is None:
                why = reply.err.payload.to_string() if reply.err else "no reason given"
                raise PeerError(f"node {node!r} did not answer {topic.key}: {why}")
            said, payload = str(reply.ok.encoding), reply.ok.payload.to_bytes()
            if said == codec.encoding(Denied):
                raise from_wire(codec.decode(Denied, payload, said).__dict__)
            return codec.decode(answer, payload, said)
        raise NothingThere(f"no node {node!r} on {self.endpoint}; {near(node, self.nodes())}")

    @contextmanager
    def listen(self, node: str) -> Iterator[Iterator[SampleView]]:
        """All samples of a node from now on, without controlling it: `with bus.listen("office") as samples:`.

        A listener that falls behind by more than some ten thousand samples misses the oldest.

        Raises:
            NothingThere: no such node.
            NodeLost: (from the iterator) the node is gone.
        """
        manifest = self.manifest(node)
        names = {name: i for i, name in enumerate(manifest.names)}
        token, wake = keys.NODE_TOKEN.at(node, name=manifest.instance), f"{keys.root(node)}/{keys.WAKE}"

        def on_token(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.DELETE:
                self.session.put(wake, b"", allowed_destination=Locality.SESSION_LOCAL)

        with ExitStack() as stack:
            own = f"{keys.root(node)}/{keys.OWN_STREAM}"
            inbox = stack.enter_context(self.session.declare_subscriber(own, RingChannel(_LISTEN)))
            watch = self.session.liveliness().declare_subscriber(token, Callback(on_token, indirect=False))
            stack.callback(watch.undeclare)

            def samples() -> Iterator[SampleView]:
                while True:
                    message = inbox.recv()
                    key = str(message.key_expr)
                    if key == wake:
                        raise NodeLost(f"node {node!r} is gone")
                    if key == keys.SAMPLE.at(node):
                        wire = codec.decode(Sample, message.payload.to_bytes(), str(message.encoding))
                        yield SampleView(wire, manifest, names)

            yield samples()

    def controller(
        self,
        node: str,
        *,
        name: str = "controller",
        level: int = 10,
        actuators: list[str] | None = None,
        required: bool = True,
    ) -> ControlLink:
        """Takes control of a node: claims actuators (None: all) at a priority level.

        Args:
            node: the node's name.
            name: of this controller; made unique on the bus.
            level: 1 (highest) to 16; 8 is a person's.
            actuators: names; None is all.
            required: the node waits for this controller in lockstep.

        Raises:
            NothingThere: no such node.
            Refused: somebody else holds that level.
        """
        identity = f"{keys.check_name(name, 'the controller')}-{os.getpid()}-{next(_numbers)}"
        claim = Claim(controller=identity, level=level, actuators=actuators, required=required)
        return self._close.enter_context(ControlLink(self, node, claim, self._affinity))


def _placed(wanted: Affinity, core: int | None) -> AbstractContextManager[None]:
    if wanted is Affinity.TOGETHER:
        affinity.pin(core)
    return affinity.threads_started_on(None if wanted is Affinity.OFF else core)


class ControlLink:
    """One controller's hold on one node. Iterate over it, or call `receive` and `send` in turn.

    Attributes:
        manifest: what the node is.
        name: this controller's name on the bus.
        accepted, rejected: its commands of this link so far.
    """

    def __init__(self, bus: Bus, node: str, claim: Claim, placement: Affinity) -> None:
        self.bus = bus
        self.name = claim.controller
        self._close = ExitStack()
        self._lost = False
        self._latest: SampleView | None = None
        self._answered = True
        with ExitStack() as undo:
            undo.callback(self.close)
            self.manifest = bus.manifest(node)
            self._open(bus.session, claim)
            undo.pop_all()
        near_node = self.manifest.host == affinity.host()
        self._polling = Polling(enabled=near_node and placement is Affinity.NODE)

    def _open(self, session: zenoh.Session, claim: Claim) -> None:
        """Listens first, claims last: nothing that the node says afterwards is missed."""
        manifest, root = self.manifest, keys.root(self.manifest.node)
        self._names = {name: i for i, name in enumerate(manifest.names)}
        self._actuators = {a.name: i for i, a in enumerate(manifest.actuators)}
        self._shape = (manifest.slots, len(manifest.actuators))
        self._sample_key = keys.SAMPLE.at(manifest.node)
        self._wake_key = f"{root}/{keys.WAKE}"
        declare = self._close.enter_context
        self._inbox = declare(session.declare_subscriber(f"{root}/{keys.OWN_STREAM}", FifoChannel(_INBOX)))
        self._close.callback(self._drain)
        self._recv, self._try_recv = self._inbox.recv, self._inbox.try_recv
        token = keys.NODE_TOKEN.at(manifest.node, name=manifest.instance)
        watch = session.liveliness().declare_subscriber(token, Callback(self._on_node, indirect=False), history=True)
        self._close.callback(watch.undeclare)
        declare(session.liveliness().declare_token(keys.CONTROLLER_TOKEN.at(manifest.node, name=claim.controller)))
        commands = session.declare_publisher(
            keys.COMMAND.at(manifest.node, name=claim.controller),
            encoding=zenoh.Encoding(codec.encoding(Command)),
            congestion_control=CongestionControl.BLOCK,
        )
        self._put_command = declare(commands).put
        self.bus.claim(manifest.node, claim)

    def _on_node(self, token: zenoh.Sample) -> None:
        if token.kind == zenoh.SampleKind.DELETE:
            self._lost = True
            self.bus.session.put(self._wake_key, b"", allowed_destination=Locality.SESSION_LOCAL)

    def _drain(self) -> None:
        # A full inbox would hold up the session's close.
        while self._inbox.try_recv() is not None:
            pass

    def __enter__(self) -> ControlLink:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Lets go of the node; twice is fine."""
        self._close.close()

    # Samples

    def reset(self, *, seed: int | None = None) -> SampleView:
        """Starts a new episode and waits for its sample 0."""
        accepted = self.bus.reset(self.manifest.node, Reset(controller=self.name, seed=seed))
        self._answered = True
        self._latest = None
        while True:
            sample = self._next(changes=True)
            if sample.episode == accepted.episode[0]:
                return self._keep(sample)

    def current(self) -> SampleView:
        """The sample that the node stands at, for a controller that has just come."""
        status = self.bus.status(self.manifest.node)
        if status.state is State.FAILED:
            raise from_wire({"error": "SimulatorError", "message": status.failure})
        if status.state is State.ENDED:
            return self.reset()
        sample = self._view(self.bus.latest(self.manifest.node))
        return self._keep(sample)

    def receive(self) -> SampleView:
        """Waits for the next sample.

        Raises:
            NodeLost: the node is gone.
            SimulatorError: EnergyPlus failed, with its words.
            Refused: the node did not take this controller's last command.
            EpisodeChanged: somebody else reset the episode.
        """
        previous = self._latest
        while True:
            sample = self._next(changes=False)
            if previous is None or sample.episode != previous.episode or sample.step > previous.step:
                return self._keep(sample)

    def _keep(self, sample: SampleView) -> SampleView:
        self._latest = sample
        self._answered = sample.truncated
        return sample

    def _next(self, *, changes: bool) -> SampleView:
        """The next sample in the inbox."""
        while True:
            message = self._polling.wait(self._try_recv, self._recv)
            key = str(message.key_expr)
            if key == self._sample_key:
                return self._view(codec.decode(Sample, message.payload.to_bytes(), str(message.encoding)))
            self._hear(key, message, changes=changes)

    def _view(self, sample: Sample) -> SampleView:
        return SampleView(sample, self.manifest, self._names, self)

    def _hear(self, key: str, message: zenoh.Sample, *, changes: bool) -> None:
        """What is not a sample: raises what ends the wait."""
        node = self.manifest.node
        if self._lost:
            raise NodeLost(f"node {node!r} is gone{self._where()}; nothing more can be known of it")
        if key != keys.EVENT.at(node):
            return
        event = codec.decode(Event, message.payload.to_bytes(), str(message.encoding))
        if event.kind is EventKind.FAILED:
            raise from_wire({"error": event.error, "message": event.text})
        if event.kind is EventKind.STOPPED:
            raise NodeLost(f"node {node!r} was stopped{self._where()}")
        if event.kind is EventKind.REJECTED and event.source == self.name:
            raise Refused(f"node {node!r} did not take the command{self._where()}: {event.text}")
        if event.kind is EventKind.STARTED and not changes and self._latest and event.episode != self._latest.episode:
            who = event.source or "somebody else"
            raise EpisodeChanged(f"node {node!r} was reset by {who}{self._where()}; episode {event.episode} runs now")

    def _where(self) -> str:
        return f" (last sample: episode {self._latest.episode}, step {self._latest.step})" if self._latest else ""

    # Commands

    def send(self, values: Mapping[str, float | None] | NDArray[np.float64] | None = None) -> None:
        """Answers the present sample. An episode's last sample takes no answer: nothing is sent.

        Args:
            values: by actuator name, None releasing it to the building's own control and the others kept
                as they are; or an array of all actuators in manifest order; or None to keep all.

        Raises:
            InvalidAction: an unknown actuator, a wrong shape, or a value that is not finite.
        """
        if self._latest is None:
            raise PeerError("there is no sample to answer yet; receive one first")
        if self._latest.truncated:
            return
        wire = self._latest.wire
        raw, mask = self._coded(values)
        self._answered = True
        self._put_command(codec.pack(episode=wire.episode, step=wire.step, mask=mask, values=raw))

    def _coded(self, values: Mapping[str, float | None] | NDArray[np.float64] | None) -> tuple[bytes, bytes | None]:
        count = self._shape[1]
        if isinstance(values, np.ndarray):
            if values.shape != (count,):
                raise InvalidAction(f"values of shape {values.shape}; ({count},) expected: one for each actuator")
            return values.astype("<f8", copy=False).tobytes(), None
        row, mask = np.zeros(count), np.full(count, Mask.KEEP, np.uint8)
        for name, value in (values or {}).items():
            if name not in self._actuators:
                raise InvalidAction(
                    f"node {self.manifest.node!r} has no actuator {name!r}; {near(name, self._actuators)}"
                )
            index = self._actuators[name]
            if value is not None and not np.isfinite(value):
                raise InvalidAction(f"{name} = {value}; a finite number or None (release) expected")
            row[index], mask[index] = (0.0, Mask.RELEASE) if value is None else (value, Mask.SET)
        return row.tobytes(), mask.tobytes()

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
