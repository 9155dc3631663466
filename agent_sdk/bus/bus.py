"""A controller's side of the bus, without Gymnasium.

with agent_sdk.connect("tcp/127.0.0.1:7447") as bus:
    for sample in bus.controller("office"):
        sample.send({"core_zn_cooling_setpoint": 26.0})
"""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, TypeVar, cast

import zenoh
from pydantic import ValidationError
from zenoh import CongestionControl, QueryTarget
from zenoh.handlers import Callback, RingChannel

from agent_sdk.bus import fork_guard
from agent_sdk.bus.controller_link import ControllerLink
from agent_sdk.bus.sample import SampleView
from bridge.runtime import affinity
from bridge.runtime.affinity import Affinity
from bridge.transport.access_control import Permission, may
from bridge.transport.session import DEFAULT_ENDPOINT, FORKED, open_session
from bridge.transport.wakeup import Wake
from topics import codec, keys
from topics.errors import (
    BusError,
    InvalidAction,
    InvalidConfig,
    NodeLost,
    NodeNotFound,
    PeerError,
    RequestRejected,
    UnknownName,
    did_you_mean,
    from_wire,
)
from topics.fault_plan import FaultPlan
from topics.keys import Role
from topics.messages import (
    Ack,
    BranchCreated,
    Claim,
    CreateBranch,
    DropSnapshot,
    ErrorReply,
    Event,
    EventKind,
    Manifest,
    Message,
    Mode,
    Pause,
    Query,
    Reset,
    Resume,
    Sample,
    ScenarioText,
    SetPace,
    SnapshotTaken,
    Status,
    StepRequest,
    Stop,
    TakeSnapshot,
    WeatherQuery,
    WeatherSeries,
    Write,
)

R = TypeVar("R", bound=Message)

_REQUEST_TIMEOUT_S = 600.0  # a start of the largest bundled building takes 14 s; death is noticed at once
_LISTEN = 16384
_MEET_S = 10.0
_ANSWER_S = 60.0  # a node that starts an engine hears a write when it has done so
_LEFT = "this bus was left by close(); connect to it again"
_numbers = itertools.count()


def connect(
    endpoint: str = DEFAULT_ENDPOINT,
    *,
    wait: bool = False,
    affinity: Affinity = Affinity.SEPARATE_CORES,
    core: int | None = None,
    keys: Path | None = None,
    role: Role = Role.CONTROLLER,
    certificate: str | None = None,
) -> Bus:
    """Connects to the bus at `endpoint`; use it with `with`.

    Args:
        endpoint: `tcp/HOST:PORT`, `unixsock-stream/PATH`, or, with keys, `tls/HOST:PORT`.
        wait: keep trying in the background instead of failing.
        affinity: where this process's bus threads run; see `bridge.runtime.affinity`.
        core: the node's core, if it is known already.
        keys: a folder that `zenostat keys init` made.
        role: whose certificate to show: a controller's, or a monitor's, which may only read.
        certificate: the name of another certificate of that role.

    Raises:
        NodeNotFound: nobody listens there, or no session over TLS came about.
        InvalidConfig: no such form of an endpoint, or keys that cannot be used.
    """
    with _placed(Affinity(affinity), core):
        session = open_session(connect=[endpoint], wait=wait, keys=keys, role=role, certificate=certificate)
    return Bus(endpoint, session, Affinity(affinity), role if keys else None)


def _made(kind: type[R], **fields: Any) -> R:
    try:
        return kind(**fields)
    except ValidationError as error:
        raise InvalidConfig(codec.describe_validation_errors(error, kind.model_fields)) from None


class Bus:
    """A connection to the nodes that are reached by one endpoint; `role` is that of its certificate, if it has one."""

    def __init__(self, endpoint: str, session: zenoh.Session, affinity: Affinity, role: Role | None = None) -> None:
        self.endpoint = endpoint
        self.role = role
        self._close, self._left = ExitStack(), False
        self._affinity = affinity
        self._links: set[ControllerLink] = set()
        self.session = self._close.enter_context(session)
        fork_guard.open_buses.add(self)

    def __enter__(self) -> Bus:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leaves the bus; twice is fine. A request of another thread ends with `BusError`."""
        self._left = True
        for link in [*self._links]:
            link.close()
        self._close.close()
        fork_guard.open_buses.discard(self)

    def forked(self) -> None:
        """Disown the bus in a forked process: whatever is asked of it raises `BusError`, and closing does nothing."""
        fork_guard.keep(self.session, self._close, *(link.__dict__.copy() for link in self._links))
        self.session, self._close = cast("zenoh.Session", fork_guard.ForkedSession()), ExitStack()
        for link in self._links:
            link.forked(BusError(FORKED), self.session)
        self._links = set()

    def nodes(self) -> list[str]:
        """Names of the nodes that are there."""
        # Not by their tokens: Zenoh 1.10 leaves out those that this session is subscribed to, one time in ten.
        replies = self.session.get(keys.MANIFEST.at("*"), target=QueryTarget.ALL)
        return sorted({keys.node_of(str(r.ok.key_expr)) for r in replies if r.ok})

    def controllers(self) -> list[tuple[str, str]]:
        """(node, controller) of all controllers that are there."""
        replies = self.session.liveliness().get(keys.CONTROLLER_TOKEN.at("*", name="*"))
        found = [str(r.ok.key_expr) for r in replies if r.ok]
        return sorted({(keys.node_of(key), keys.last_chunk(key)) for key in found})

    def manifest(self, node: str) -> Manifest:
        """All that is to know of a node; `NodeNotFound` if it is not on the bus."""
        return self._ask(keys.MANIFEST, node, None, Manifest)

    def status(self, node: str, *, memory: bool = False) -> Status:
        """Where a node stands; `NodeNotFound` if it is not on the bus.

        Args:
            node: its name.
            memory: also what each engine shares with no other process, which takes some milliseconds each.
        """
        return self._ask(keys.STATUS, node, Query(memory=memory), Status)

    def stop(self, node: str) -> None:
        """Tells a node to end."""
        self._ask(keys.STOP, node, Stop(), Ack)

    def pace(self, node: str, speed: float | None = None, *, mode: Mode | str = Mode.PACED, source: str = "") -> None:
        """Sets who sets a node's pace, from now on.

        Args:
            node: its name.
            speed: simulated seconds in a second, above 0 and at most 1e9; only in the mode `paced`.
            mode: `lockstep` (the required controllers), `paced` (the wall clock) or `free` (nobody).
            source: who asks, for the event that tells of it.

        Raises:
            InvalidConfig: no such mode, or a speed that cannot be.
            RequestRejected: `paced` without a speed, or another mode with one.
        """
        self._ask(keys.PACE, node, _made(SetPace, mode=mode, speed=speed, source=source), Ack)

    def pause(self, node: str, *, source: str = "") -> None:
        """Has a node stand still, in whatever mode; when it has answered it does."""
        self._ask(keys.PAUSE, node, _made(Pause, source=source), Ack)

    def resume(self, node: str, *, source: str = "") -> None:
        """Has a node that was paused go on from where it stands, without catching up."""
        self._ask(keys.RESUME, node, _made(Resume, source=source), Ack)

    def step(self, node: str, steps: int = 1, *, source: str = "") -> None:
        """Has a node that is paused go some timesteps: in lockstep once they are answered, else at once.

        Raises:
            InvalidConfig: not 1 to 1,000,000 timesteps.
            RequestRejected: the node is not paused.
        """
        self._ask(keys.STEP, node, _made(StepRequest, steps=steps, source=source), Ack)

    def faults(self, node: str, plan: FaultPlan | Mapping[str, Any] | Path | None) -> None:
        """Has a node inject these faults from now on, in place of those that were there; None: no more.

        Args:
            node: its name.
            plan: a plan, the fields of one, or a file (YAML); see docs/faults.md.

        Raises:
            InvalidConfig: no such file, or faults that cannot be on this node; names all that is wrong.
        """
        if isinstance(plan, Path):
            from bridge.faults import read_plan  # few need it

            plan = read_plan(plan)
        if not isinstance(plan, FaultPlan):
            plan = _made(FaultPlan, **(plan or {}))
        self._ask(keys.FAULTS, node, plan, Ack)

    def latest(self, node: str) -> Sample:
        """The node's latest sample."""
        return self._ask(keys.SAMPLE, node, None, Sample)

    def claim(self, node: str, claim: Claim) -> Ack:
        """Claims actuators of a node; `RequestRejected` says who holds them."""
        return self._ask(keys.CLAIM, node, claim, Ack)

    def reset(self, node: str, reset: Reset) -> Ack:
        """Starts a new episode of a node."""
        return self._ask(keys.RESET, node, reset, Ack)

    def snapshot(self, node: str, controller: str = "") -> SnapshotTaken:
        """Has a node keep where it stands, to go back there by a `Reset`; it is dropped when `controller` leaves.

        Raises:
            RequestRejected: no episode runs, or there are as many snapshots and branches as the node allows.
            ForkFailed: the system cannot fork the engine.
        """
        return self._ask(keys.SNAPSHOT, node, TakeSnapshot(controller=controller), SnapshotTaken)

    def drop(self, node: str, snapshot: str) -> None:
        """Gives a snapshot's memory back; `RequestRejected` if there is none of that name."""
        self._ask(keys.DROP, node, DropSnapshot(snapshot=snapshot), Ack)

    def branch(self, node: str, branch: CreateBranch) -> str:
        """Has a node go on twice from where it stands: the name of the new one, which is a node like any other.

        Raises:
            RequestRejected, ForkFailed: as for `snapshot`; a branch has no branches.
        """
        return self._ask(keys.BRANCH, node, branch, BranchCreated).node

    def weather(self, node: str, columns: Sequence[str], slot: int = 0) -> WeatherSeries:
        """The weather that a slot's present episode reads, noise included; `UnknownName` lists the columns."""
        return self._ask(keys.WEATHER, node, WeatherQuery(columns=list(columns), slot=slot), WeatherSeries)

    def scenario(self, node: str) -> str:
        """The scenario that a node simulates, as a scenario file (YAML)."""
        return self._ask(keys.SCENARIO, node, Query(), ScenarioText).text

    def read(self, node: str, *, slot: int = 0) -> SampleView:
        """The sample that a node stands at, without controlling it; `NodeNotFound` if it is not on the bus.

        Raises:
            UnknownName: the node has no such slot.
        """
        manifest = self.manifest(node)
        if not 0 <= slot < manifest.slots:
            raise UnknownName(f"node {node!r} has no slot {slot}; it has 0 to {manifest.slots - 1}")
        return SampleView(self.latest(node), manifest, {name: i for i, name in enumerate(manifest.names)}, slot=slot)

    def write(
        self,
        node: str,
        point: str,
        value: float | None,
        *,
        priority: int = 8,
        duration_s: float | None = None,
        source: str = "anonymous",
    ) -> Event:
        """Writes one actuator, as a person or a device; it rules from the next timestep on. Gives the node's answer.

        Args:
            node: the node's name.
            point: the actuator's name.
            value: in its unit; None releases it at this priority.
            priority: 1 (highest) to 16; 8 is a person's.
            duration_s: seconds of simulated time after which it is released by itself; None: until somebody does.
            source: who writes; made unique on the bus, since that tells the node's answer from others.

        Raises:
            NodeNotFound: no such node.
            UnknownName: no such actuator; the text lists near ones.
            InvalidAction: a value, priority or time that cannot be.
            RequestRejected: the node did not take it, with its reason.
        """
        manifest = self.manifest(node)
        known = [actuator.name for actuator in manifest.actuators]
        if point not in known:
            raise UnknownName(f"node {node!r} has no actuator {point!r}; {did_you_mean(point, known)}")
        unique = f"{source}-{os.getpid()}-{next(_numbers)}"
        try:
            write = Write(value=value, priority=priority, duration_s=duration_s, source=unique)
        except ValidationError as error:
            raise InvalidAction(f"{point}: {codec.describe_validation_errors(error)}") from None
        event = self._put_write(manifest, point, write)
        if event.kind is EventKind.REJECTED:
            raise RequestRejected(f"node {node!r} did not take it: {event.text}")
        return event

    def _put_write(self, manifest: Manifest, point: str, write: Write) -> Event:
        """Listens, writes once the node is met, and waits for what it says of this write."""
        node, heard = manifest.node, SimpleQueue[zenoh.Sample]()
        token, deadline = keys.NODE_TOKEN.at(node, name=manifest.instance), time.monotonic() + _MEET_S
        on_any = Callback(heard.put, indirect=False)
        sent = False
        with (
            self.session.declare_subscriber(keys.EVENT.at(node), on_any),
            self.session.liveliness().declare_subscriber(token, on_any, history=True),
        ):
            while True:
                try:
                    message = heard.get(timeout=max(deadline - time.monotonic(), 0.0))
                except Empty:
                    if not sent:
                        raise NodeNotFound(f"node {node!r} has gone") from None
                    raise PeerError(f"node {node!r} did not answer the write of {point!r}; read it to see") from None
                if str(message.key_expr) == token:
                    if message.kind == zenoh.SampleKind.DELETE:
                        raise NodeLost(f"node {node!r} is gone")
                    if not sent:
                        self._put(keys.ACTUATOR.at(node, name=point), write)
                        sent, deadline = True, time.monotonic() + _ANSWER_S
                    continue
                event = codec.decode(Event, message.payload.to_bytes(), str(message.encoding))
                if event.source == write.source and event.kind in (EventKind.WRITTEN, EventKind.REJECTED):
                    return event

    def _put(self, key: str, message: Message) -> None:
        said = zenoh.Encoding(codec.encoding(type(message)))
        self.session.put(key, codec.encode(message), encoding=said, congestion_control=CongestionControl.BLOCK)

    def _ask(self, topic: keys.Topic, node: str, question: Message | None, answer: type[R]) -> R:
        if self.role is not None and Permission.ASK not in may(self.role, topic):
            raise InvalidConfig(f"a {self.role} may not ask {topic.key}; connect with the certificate of another role")
        try:
            replies = self.session.get(
                topic.at(node),
                payload=codec.encode(question) if question else None,
                encoding=zenoh.Encoding(codec.encoding(type(question))) if question else None,
                timeout=_REQUEST_TIMEOUT_S,
            )
        except zenoh.ZError:
            if not self._left:
                raise
            raise BusError(_LEFT) from None
        for reply in replies:
            if reply.ok is None:
                why = reply.err.payload.to_string() if reply.err else "no reason given"
                raise PeerError(f"node {node!r} did not answer {topic.key}: {why}")
            said, payload = str(reply.ok.encoding), reply.ok.payload.to_bytes()
            if said == codec.encoding(ErrorReply):
                raise from_wire(codec.decode(ErrorReply, payload, said).__dict__)
            return codec.decode(answer, payload, said)
        if self._left:
            raise BusError(_LEFT)
        raise NodeNotFound(f"no node {node!r} on {self.endpoint}; {did_you_mean(node, self.nodes())}")

    @contextmanager
    def _unless_forked(self, stack: ExitStack) -> Iterator[zenoh.Session]:
        """Leaves to the parent process what a forked one cannot undeclare."""
        session = self.session
        try:
            yield session
        finally:
            if self.session is not session:
                fork_guard.keep(stack.pop_all())

    @contextmanager
    def listen(self, node: str) -> Iterator[Iterator[SampleView]]:
        """All samples of a node from now on, without controlling it: `with bus.listen("office") as samples:`.

        A listener that falls behind by more than some ten thousand samples misses the oldest.

        Raises:
            NodeNotFound: no such node.
            NodeLost: (from the iterator) the node is gone.
        """
        manifest = self.manifest(node)
        names = {name: i for i, name in enumerate(manifest.names)}
        token, wake_key = keys.NODE_TOKEN.at(node, name=manifest.instance), keys.wake(node)
        wake = Wake(self.session, wake_key)

        def on_token(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.DELETE:
                wake()

        with ExitStack() as stack, self._unless_forked(stack) as session:
            inbox = stack.enter_context(self.session.declare_subscriber(keys.stream(node), RingChannel(_LISTEN)))
            watch = self.session.liveliness().declare_subscriber(token, Callback(on_token, indirect=False))
            stack.callback(watch.undeclare)
            stack.callback(wake.close)
            self.manifest(node)  # the end of one that has gone meanwhile would not be told

            def samples() -> Iterator[SampleView]:
                while True:
                    if self.session is not session:
                        raise BusError(FORKED)
                    message = inbox.recv()
                    key = str(message.key_expr)
                    if key == wake_key:
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
        priority: int = 10,
        actuators: list[str] | None = None,
        required: bool = True,
    ) -> ControllerLink:
        """Takes control of a node: claims actuators (None: all) at a priority level.

        Args:
            node: the node's name.
            name: of this controller; made unique on the bus.
            priority: 1 (highest) to 16; 8 is a person's.
            actuators: names; None is all.
            required: the node waits for this controller in lockstep.

        Raises:
            NodeNotFound: no such node.
            RequestRejected: somebody else holds that level.
        """
        identity = f"{keys.check_name(name, 'the controller')}-{os.getpid()}-{next(_numbers)}"
        claim = Claim(controller=identity, priority=priority, actuators=actuators, required=required)
        link = ControllerLink(self, node, claim, self._affinity)
        self._links.add(link)
        return link

    def forget(self, link: ControllerLink) -> None:
        """A controller has let go of its node: the bus need not close it."""
        self._links.discard(link)


def _placed(wanted: Affinity, core: int | None) -> AbstractContextManager[None]:
    if wanted is Affinity.TOGETHER:
        affinity.set_affinity(core)
    return affinity.threads_started_on(None if wanted is Affinity.OFF else core)
