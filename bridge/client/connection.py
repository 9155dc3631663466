"""A connection to the bus: the requests to its nodes over one Zenoh session, and the links that end with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Protocol, Self, cast

import zenoh
from zenoh import QueryTarget

from zenostat.bridge.client import fork_guard
from zenostat.bridge.client.priorities import PriorityValue, decode_priorities, decode_remaining
from zenostat.bridge.client.sample import SampleView
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.bridge.runtime.contention import FollowedPlacement
from zenostat.bridge.runtime.timer import Timer
from zenostat.bridge.transport.access_control import Permission, may
from zenostat.bridge.transport.request import M, PendingReply, send_request
from zenostat.bridge.transport.session import FORKED, OpenSession
from zenostat.topics import codec, keys
from zenostat.topics.errors import (
    BusError,
    InvalidAction,
    InvalidConfig,
    NodeLost,
    NodeNotFound,
    RequestRejected,
    UnknownName,
    did_you_mean,
)
from zenostat.topics.fault_plan import FaultPlan
from zenostat.topics.messages import (
    Ack,
    BranchCreated,
    Claim,
    CreateBranch,
    DropSnapshot,
    Geometry,
    Manifest,
    Message,
    Mode,
    Pause,
    PlanSimulated,
    PriorityArrays,
    Query,
    Reset,
    Resume,
    Revoke,
    Sample,
    ScenarioText,
    SemanticModel,
    SetPace,
    SimulatePlan,
    SnapshotTaken,
    Status,
    StepRequest,
    StepsTried,
    Stop,
    Systems,
    TakeSnapshot,
    TrySteps,
    WeatherQuery,
    WeatherSeries,
    Write,
)
from zenostat.topics.points import actuator_index, value_index

_REQUEST_TIMEOUT_S = 600.0  # starting the largest bundled building takes 14 s; the death of a node is noticed at once
_CLOSED = "this bus is closed; connect to it again"


class Link(Protocol):
    """Object that ends with the connection, such as a `ControllerLink`."""

    def close(self) -> None:
        """Close it; idempotent."""

    def forked(self, error: BusError, session: zenoh.Session) -> None:
        """Disown it in a forked process."""


class Connection:
    """Requests to all nodes that are reachable through one endpoint.

    Attributes (besides those that `Bus` describes):
        affinity: Placement of its threads.
        links: Its controllers that are not closed.
        placement: Places them like the threads of a local node.
        timeout_s: Time after which a node that is present but does not answer fails a request with `PeerError`.
        via: Protocol of those for whom it sends requests, which recordings show as the way in; empty for itself.
    """

    def __init__(self, endpoint: str, session: OpenSession, affinity: Affinity) -> None:
        self.endpoint = endpoint
        self.identity, self.roles = session.name, session.roles
        self._expired, self._why_gone = session.expired, session.why_gone
        self.timeout_s, self.via = _REQUEST_TIMEOUT_S, ""
        self._close, self._closed = ExitStack(), False
        self.affinity = affinity
        self.placement: FollowedPlacement | None = None
        self.links: set[Link] = set()
        self.timer = self._close.enter_context(Timer())
        self.session = self._close.enter_context(session)
        fork_guard.open_buses.add(self)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection and its controller links; idempotent. Pending requests raise `BusError`."""
        self._closed = True
        for link in [*self.links]:
            link.close()
        self._close.close()
        fork_guard.open_buses.discard(self)

    def forked(self) -> None:
        """Disown the bus in a forked process: every request raises `BusError`, and closing does nothing."""
        fork_guard.keep(self.session, self._close, *(link.__dict__.copy() for link in self.links))
        self.session, self._close = cast("zenoh.Session", fork_guard.ForkedSession()), ExitStack()
        for link in self.links:
            link.forked(BusError(FORKED), self.session)
        self.links = set()

    def adopt(self, link: Link) -> None:
        """Close a link with this connection."""
        self.links.add(link)

    def forget(self, link: Link) -> None:
        """Remove a link that has been closed."""
        self.links.discard(link)

    # Requests

    def ask(self, topic: keys.Topic, node: str, request: Message | None, reply_type: type[M], *, name: str = "") -> M:
        """Send a request to a node and return its reply.

        Args:
            topic: The request's topic.
            node: The node's name.
            request: None for a topic whose requests are empty.
            reply_type: The class of the reply.
            name: The topic's name, if it has one.

        Raises:
            NodeNotFound: No such node, or it does not know the topic.
            InvalidConfig: The node's name is not valid, or the roles of this connection may not query the topic.
            BusError: This connection is closed.
            ZenostatError: The error that the node replied with.
        """
        return self._receive(node, self._send(topic, node, request, reply_type, name=name))

    def _send(
        self, topic: keys.Topic, node: str, request: Message | None, reply_type: type[M], *, name: str = ""
    ) -> PendingReply[M]:
        """Send a request to a node; see `ask`."""
        if self.roles and not any(Permission.ASK in may(role, topic) for role in self.roles):
            raise InvalidConfig(
                f"{' and '.join(self.roles)} {self.identity!r} may not query {topic.key}; connect with a certificate "
                f"that also has the role {' or '.join(topic.senders)}"
            )
        sender = ""
        if topic.has_sender and request is not None:
            request, sender = self._signed(request)
        try:
            return send_request(
                self.session, topic, node, request, reply_type, name=name, sender=sender, via=self.via,
                timeout_s=self.timeout_s,
            )  # fmt: skip
        except zenoh.ZError:
            if not self._closed:
                raise
            raise BusError(_CLOSED) from None

    def _receive(self, node: str, pending: PendingReply[M]) -> M:
        """Wait for the reply to a request; see `ask`."""
        try:
            reply = pending.wait()
        except zenoh.ZError:
            if not self._closed:
                raise
            raise BusError(_CLOSED) from None
        if reply is not None:
            return reply
        if self._closed:
            raise BusError(_CLOSED)
        known = self.nodes()
        if node in known:
            raise NodeNotFound(
                f"the node {node!r} on {self.endpoint} did not take the request: it has just started, or does not "
                "offer it"
            )
        starting = "" if known else " (one may be starting)"
        denied = "" if known else self._why_gone()
        raise NodeNotFound(f"no node {node!r} on {self.endpoint}; {did_you_mean(node, known)}{starting}{denied}")

    def lost(self, node: str, where: str = "") -> NodeLost:
        """Return the error for a node that has left the bus; with keys, it says how a certificate may be the reason.

        Args:
            node: The node's name.
            where: How far the caller had come, for the text.
        """
        return NodeLost(f"node {node!r} is gone{where}{self._why_gone(self.endpoint)}")

    def _signed(self, request: Message) -> tuple[Message, str]:
        """Return a request with its sender's name, and that name: below the one in the certificate."""
        field = keys.sender_field(type(request))
        named = getattr(request, field) if field else ""
        sender = self.sender(named)
        return (request.model_copy(update={field: sender}) if named not in ("", sender) else request), sender

    def sender(self, name: str = "") -> str:
        """Return the name under which this connection sends what `name` stands for; see `topics.keys.own_name`."""
        return keys.own_name(self.identity, name)

    def nodes(self) -> list[str]:
        """Return the names of all nodes on the bus, sorted."""
        # Not through liveliness tokens: one time in ten, Zenoh 1.10 omits those that this session is subscribed to.
        replies = self.session.get(keys.MANIFEST.at("*"), target=QueryTarget.ALL)
        names = {keys.node_of(str(r.ok.key_expr)) for r in replies if r.ok}
        return sorted(filter(keys.is_name, names))  # a stranger's may have another form

    def check_link(self) -> None:
        """Raise `NodeNotFound` if this connection has lost its link; Zenoh goes on connecting by itself."""
        if not self.session.info.links():
            reason = self._expired(self.endpoint) or "nobody listens there, or the network is interrupted"
            raise NodeNotFound(f"the connection to {self.endpoint} is lost: {reason}")

    def controllers(self) -> list[tuple[str, str]]:
        """Return pairs (node, controller) of all controllers on the bus, sorted."""
        replies = self.session.liveliness().get(keys.CONTROLLER_TOKEN.everywhere())
        tokens = [str(r.ok.key_expr) for r in replies if r.ok]
        return sorted({(keys.node_of(token), keys.last_chunk(token)) for token in tokens})

    def manifest(self, node: str) -> Manifest:
        """Return a node's manifest; `NodeNotFound` if it is not on the bus."""
        return self.ask(keys.MANIFEST, node, None, Manifest)

    def status(self, node: str, *, memory: bool = False) -> Status:
        """Return a node's status; `NodeNotFound` if it is not on the bus.

        Args:
            node: The node's name.
            memory: Include each engine's private memory, which takes a few milliseconds per engine.
        """
        return self.ask(keys.STATUS, node, Query(memory=memory), Status)

    def stop(self, node: str, *, source: str = "", instance: str = "") -> None:
        """Stop a node.

        Args:
            node: The node's name.
            source: Name of who stops it, which events and recordings show.
            instance: Of the node, as in its manifest; a branch has that of its node. Empty: not compared.

        Raises:
            RequestRejected: The node has another instance.
        """
        self.ask(keys.STOP, node, build(Stop, source=source, instance=instance), Ack)

    def faults(self, node: str, plan: FaultPlan | Mapping[str, Any] | Path | None, *, source: str = "") -> None:
        """Replace the faults that a node injects; None stops all injection.

        Args:
            node: The node's name.
            plan: A plan, its fields, or a YAML file; see docs/faults.md.
            source: Name of who injects them, which events and recordings show.

        Raises:
            InvalidConfig: No such file, or faults that do not fit this node; the text lists all errors.
        """
        if isinstance(plan, Path):
            from zenostat.bridge.faults import read_plan  # imported here because few programs need it

            plan = read_plan(plan)
        if not isinstance(plan, FaultPlan):
            if not isinstance(plan, Mapping | None):
                raise InvalidConfig(f"faults: a plan, a mapping of its fields or a path expected, got {plan!r}")
            plan = build(FaultPlan, **(plan or {}))
        if source:
            plan = build(FaultPlan, **{**dict(plan), "source": source})
        self.ask(keys.FAULTS, node, plan, Ack)

    def fault_plan(self, node: str) -> FaultPlan:
        """Return the faults that a node injects now or later; `RequestRejected` if it is a replay."""
        return self._ask_since(keys.FAULT_PLAN, node, FaultPlan, "its fault plan")

    def latest(self, node: str) -> Sample:
        """Return a node's latest sample."""
        return self.ask(keys.SAMPLE, node, None, Sample)

    def claim(self, node: str, claim: Claim) -> Ack:
        """Claim actuators of a node; `RequestRejected` names the controllers that hold them."""
        return self.ask(keys.CLAIM, node, claim, Ack)

    def reset(self, node: str, reset: Reset) -> Ack:
        """Start a new episode of a node."""
        return self.ask(keys.RESET, node, reset, Ack)

    def geometry(self, node: str) -> Geometry:
        """Return a node's zones and surfaces; `zenostat.views.display.surfaces` decodes them.

        Raises:
            RequestRejected: Its plant has no geometry, or its version of Zenostat does not send it.
        """
        return self._ask_since(keys.GEOMETRY, node, Geometry, "a geometry")

    def systems(self, node: str) -> Systems:
        """Return the loops of a node's building, and their components in order of flow.

        Raises:
            RequestRejected: Its plant has no such systems, or its version of Zenostat does not send them.
        """
        return self._ask_since(keys.SYSTEMS, node, Systems, "its systems")

    def _ask_since(self, topic: keys.Topic, node: str, reply: type[M], what: str) -> M:
        """Return the reply of a node, which may be of a release that does not have the topic."""
        try:
            return self.ask(topic, node, Query(), reply)
        except NodeNotFound:
            version = self.manifest(node).versions.zenostat
            raise RequestRejected(f"node {node!r} is of Zenostat {version}, which does not send {what}") from None

    def semantic(self, node: str) -> str:
        """Return a node's semantic model as Turtle; `zenostat.semantic` reads it.

        Raises:
            RequestRejected: Its plant has no semantic model, or its version of Zenostat does not send it.
        """
        return self._ask_since(keys.SEMANTIC, node, SemanticModel, "a semantic model").text

    def scenario(self, node: str) -> str:
        """Return the scenario that a node simulates, as the text of a scenario file (YAML)."""
        return self.ask(keys.SCENARIO, node, Query(), ScenarioText).text

    def weather(self, node: str, columns: Sequence[str], slot: int = 0) -> WeatherSeries:
        """Return weather of a slot's current episode, noise included; `UnknownName` lists the columns."""
        return self.ask(keys.WEATHER, node, WeatherQuery(columns=list(columns), slot=slot), WeatherSeries)

    def read(self, node: str, *, slot: int = 0) -> SampleView:
        """Return a slot's current sample without controlling the node; `UnknownName` if there is no such slot."""
        manifest = self._manifest_with(node, slot)
        return SampleView(self.latest(node), manifest, value_index(manifest), slot=slot)

    def _manifest_with(self, node: str, slot: int) -> Manifest:
        manifest = self.manifest(node)
        if not 0 <= slot < manifest.slots:
            raise UnknownName(f"node {node!r} has no slot {slot}; it has 0 to {manifest.slots - 1}")
        return manifest

    def write(
        self,
        node: str,
        point: str,
        value: float | None,
        *,
        priority: int = 8,
        duration_s: float | None = None,
        source: str = "",
    ) -> Ack:
        """Write one actuator as a person or a device, and return the node's reply; effective from the next timestep.

        Args:
            node: The node's name.
            point: The actuator's name.
            value: In the actuator's unit; None relinquishes it at this priority.
            priority: 1 (highest) to 16; 8 is a manual operator's.
            duration_s: Simulated seconds after which the value is relinquished; None keeps it until it is relinquished.
            source: Name of the writer, which samples and events show; empty for `anonymous`, or with keys the
                certificate's name.

        Raises:
            NodeNotFound: No such node.
            NodeLost: It left the bus before it replied.
            UnknownName: No such actuator; the text lists similar names.
            InvalidAction: Value, priority, duration or source out of range.
            RequestRejected: The node rejected the write, with its reason.
        """
        manifest = self.manifest(node)
        actuator_index(manifest).require([point])
        fields = {"value": value, "priority": priority, "duration_s": duration_s, "source": source}
        write = codec.validated(Write, fields, point, InvalidAction)
        try:
            return self.ask(keys.WRITE_REQUEST, node, write, Ack, name=point)
        except NodeNotFound:
            raise self.lost(node) from None
        except RequestRejected as error:
            raise RequestRejected(f"node {node!r} rejected the write: {error}") from None

    def priorities(self, node: str, *, slot: int = 0) -> dict[str, list[PriorityValue]]:
        """Return each actuator's priority array by its name: 16 entries, that of priority 1 first.

        The arrays are those before the next timestep: a command or a write that was accepted is in them at once.

        Raises:
            UnknownName: There is no such slot.
        """
        manifest = self._manifest_with(node, slot)
        return decode_priorities(self.ask(keys.PRIORITIES, node, Query(), PriorityArrays), manifest, slot)

    def revoke(self, node: str, name: str, *, source: str = "") -> Ack:
        """Revoke the name of a certificate on a node: its claims end, and nothing of it is accepted any more.

        Raises:
            UnknownName: No such name in the node's list of names.
            RequestRejected: The node has no keys, or it is its own name.
        """
        return self.ask(keys.REVOKE, node, build(Revoke, name=name, source=source), Ack)

    def remaining_durations(self, node: str) -> dict[str, dict[int, float]]:
        """Return by actuator and priority the simulated seconds after which a written value is relinquished.

        Values without a duration are left out.
        """
        return decode_remaining(self.ask(keys.PRIORITIES, node, Query(), PriorityArrays), self.manifest(node))

    # Pace

    def pace(self, node: str, speed: float | None = None, *, mode: Mode | str = Mode.PACED, source: str = "") -> None:
        """Set a node's mode: what decides when it simulates the next timestep.

        Args:
            node: The node's name.
            speed: Simulated seconds per second, above 0 and at most 1e9; only with `paced`.
            mode: `lockstep` (required controllers), `paced` (the wall clock) or `free` (nothing; full speed).
            source: Name of the requester, for the event that reports the change.

        Raises:
            InvalidConfig: Unknown mode, or speed out of range.
            RequestRejected: `paced` without a speed, or another mode with one.
        """
        self.ask(keys.PACE, node, build(SetPace, mode=mode, speed=speed, source=source), Ack)

    def pause(self, node: str, *, source: str = "") -> None:
        """Pause a node, in any mode; return once it is paused."""
        self.ask(keys.PAUSE, node, build(Pause, source=source), Ack)

    def resume(self, node: str, *, source: str = "") -> None:
        """Resume a paused node from its current timestep; it does not catch up."""
        self.ask(keys.RESUME, node, build(Resume, source=source), Ack)

    def step(self, node: str, steps: int = 1, *, source: str = "") -> None:
        """Let a paused node simulate some timesteps: in lockstep as soon as they are answered, else at once.

        Raises:
            InvalidConfig: `steps` is not from 1 to 1,000,000.
            RequestRejected: The node is not paused.
        """
        self.ask(keys.STEP, node, build(StepRequest, steps=steps, source=source), Ack)

    # Snapshots, branches and plans

    def snapshot(self, node: str, controller: str = "") -> SnapshotTaken:
        """Take a snapshot of a node, to return to with a `Reset`; the node drops it when `controller` disconnects.

        That is also after 10 s if `controller` is on the bus by no liveliness token. Without a name, on a bus without
        keys, the snapshot is kept until somebody drops it.

        Raises:
            RequestRejected: No episode is running, or the node has its maximum of snapshots and branches.
            ForkFailed: The system cannot fork the engine.
        """
        return self.ask(keys.SNAPSHOT, node, TakeSnapshot(controller=controller), SnapshotTaken)

    def drop(self, node: str, snapshot: str, controller: str = "") -> None:
        """Drop a snapshot of an owner and free its memory; `RequestRejected` if the node has none of that name."""
        self.ask(keys.DROP_SNAPSHOT, node, build(DropSnapshot, snapshot=snapshot, controller=controller), Ack)

    def branch(self, node: str, branch: CreateBranch) -> str:
        """Create a branch of a node and return the branch's name; a branch is a node like any other.

        Its `controller` owns it as that of `snapshot` does.

        Raises:
            RequestRejected, ForkFailed: As for `snapshot`; a branch cannot have branches.
        """
        return self.ask(keys.BRANCH, node, branch, BranchCreated).node

    def plan(self, branch: str, plan: SimulatePlan) -> PlanSimulated:
        """Let a branch simulate several timesteps, and return their samples.

        Raises:
            RequestRejected: It is not a branch in lockstep, or a command is not valid; nothing was simulated.
            SimulatorError: The simulator failed.
        """
        return self.ask(keys.PLAN, branch, plan, PlanSimulated)

    def trial(self, node: str, request: TrySteps) -> StepsTried:
        """Let a node simulate timesteps under alternative commands, and return the samples; see `Bus.try_steps`.

        Raises:
            NodeLost: It left the bus before it replied.
        """
        return self.finish_trial(node, self.begin_trial(node, request))

    def begin_trial(self, node: str, request: TrySteps) -> PendingReply[StepsTried]:
        """Send the request for a trial; `finish_trial` waits for its reply. Other nodes can try at the same time."""
        return self._send(keys.TRY, node, request, StepsTried)

    def finish_trial(self, node: str, pending: PendingReply[StepsTried]) -> StepsTried:
        """Wait for the reply to a trial that `begin_trial` began; raises as `trial` does, `BusError` if cancelled."""
        try:
            return self._receive(node, pending)
        except NodeNotFound:
            if pending.is_cancelled:
                raise BusError(f"the trial of node {node!r} was cancelled") from None
            raise self.lost(node) from None


def build(message_type: type[M], **fields: Any) -> M:
    """Build a message; `InvalidConfig` lists all invalid fields."""
    return codec.validated(message_type, fields)
