"""A controller's side of the bus, without Gymnasium.

with agent_sdk.connect("tcp/127.0.0.1:7447") as bus:
    for sample in bus.controller("office"):
        sample.send({"core_zn_cooling_setpoint": 26.0})
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from typing import TypeVar

import zenoh
from zenoh.handlers import Callback, RingChannel

from agent_sdk.link import ControlLink
from agent_sdk.sample import SampleView
from bridge import affinity
from bridge.affinity import Affinity
from bridge.session import DEFAULT_ENDPOINT, open_session
from bridge.wake import Wake
from topics import codec, keys
from topics.errors import (
    NodeLost,
    NothingThere,
    PeerError,
    from_wire,
    near,
)
from topics.messages import (
    Accepted,
    Ask,
    Claim,
    Denied,
    Manifest,
    Message,
    Reset,
    Sample,
    ScenarioText,
    Status,
    Stop,
    WeatherQuery,
    WeatherSeries,
)

R = TypeVar("R", bound=Message)

_REQUEST_TIMEOUT_S = 600.0  # a start of the largest bundled building takes 14 s; death is noticed at once
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

    def weather(self, node: str, columns: Sequence[str]) -> WeatherSeries:
        """The weather that a node's present episode reads, noise included; `UnknownName` lists the columns."""
        return self._ask(keys.WEATHER, node, WeatherQuery(columns=list(columns)), WeatherSeries)

    def scenario(self, node: str) -> str:
        """The scenario that a node simulates, as a scenario file (YAML)."""
        return self._ask(keys.SCENARIO, node, Ask(), ScenarioText).text

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
        token, wake_key = keys.NODE_TOKEN.at(node, name=manifest.instance), keys.wake(node)
        wake = Wake(self.session, wake_key)

        def on_token(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.DELETE:
                wake()

        with ExitStack() as stack:
            inbox = stack.enter_context(self.session.declare_subscriber(keys.stream(node), RingChannel(_LISTEN)))
            watch = self.session.liveliness().declare_subscriber(token, Callback(on_token, indirect=False))
            stack.callback(watch.undeclare)
            stack.callback(wake.close)

            def samples() -> Iterator[SampleView]:
                while True:
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
