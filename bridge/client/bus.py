"""The client of the bus, without Gymnasium.

with zenostat.connect("tcp/127.0.0.1:7447") as bus:
    for sample in bus.controller("office"):
        sample.send({"core_zn_cooling_setpoint": 26.0})
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path

from zenostat.bridge.client.connection import Connection
from zenostat.bridge.client.controller_link import ControllerLink, open_link
from zenostat.bridge.client.listener import listen
from zenostat.bridge.client.sample import SampleView
from zenostat.bridge.runtime import affinity
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.bridge.transport.session import DEFAULT_ENDPOINT, open_session
from zenostat.topics.keys import Role


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
    """Connect to the bus at `endpoint`; use the result in a `with` statement.

    Args:
        endpoint: `tcp/HOST:PORT`, `unixsock-stream/PATH`, or, with `keys`, `tls/HOST:PORT`.
        wait: Keep trying in the background instead of failing.
        affinity: Placement of this process's bus threads; see `zenostat.bridge.runtime.affinity`.
        core: The node's core, if it is already known.
        keys: A folder created by `zenostat keys init`.
        role: Which certificate to use: a controller's, or a monitor's, which may only read.
        certificate: Name of another certificate of that role.

    Raises:
        NodeNotFound: No process listens at the endpoint, or the TLS session failed.
        InvalidConfig: The endpoint is malformed, or the keys cannot be used.
    """
    with _thread_placement(Affinity(affinity), core):
        session = open_session(connect=[endpoint], wait=wait, keys=keys, role=role, certificate=certificate)
    return Bus(endpoint, session, Affinity(affinity), role if keys else None)


class Bus(Connection):
    """A connection to all nodes that are reachable through one endpoint.

    Attributes:
        endpoint, role: Its endpoint, and the role of its certificate (None without TLS).
        session: The Zenoh session.
        timer: For the checks of controllers that have waited for long; its thread starts with the first controller.
    """

    def listen(self, node: str) -> AbstractContextManager[Iterator[SampleView]]:
        """Receive all samples of a node from now on: `with bus.listen("office") as samples:`.

        A listener that lags by more than about ten thousand samples misses the oldest.

        Raises:
            NodeNotFound: No such node.
            NodeLost: The node is gone; raised by the iterator.
        """
        return listen(self, node)

    def controller(
        self,
        node: str,
        *,
        name: str = "controller",
        priority: int = 10,
        actuators: list[str] | None = None,
        required: bool = True,
    ) -> ControllerLink:
        """Connect a controller to a node and claim actuators at a priority.

        Args:
            node: The node's name.
            name: The controller's name; made unique on the bus.
            priority: 1 (highest) to 16; 8 is a manual operator's.
            actuators: Names of actuators; None claims all.
            required: Whether the node waits for this controller in lockstep.

        Raises:
            NodeNotFound: No such node.
            RequestRejected: Another controller holds one of the actuators at that priority.
        """
        return open_link(self, node, name=name, priority=priority, actuators=actuators, required=required)


def _thread_placement(placement: Affinity, core: int | None) -> AbstractContextManager[None]:
    if placement is Affinity.TOGETHER:
        affinity.set_affinity(core)
    return affinity.threads_started_on(None if placement is Affinity.OFF else core)
