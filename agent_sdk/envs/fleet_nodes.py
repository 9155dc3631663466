"""The nodes of a fleet: their addresses, whether they fit together, and their errors."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import NamedTuple, TypeVar

from zenostat.agent_sdk.envs import spaces
from zenostat.agent_sdk.envs.action_values import Actions
from zenostat.bridge.client.bus import Bus
from zenostat.bridge.client.bus import connect as connect_bus
from zenostat.bridge.transport.access_control import RESETTING
from zenostat.bridge.transport.session import check_endpoint
from zenostat.topics.errors import (
    BusError,
    ErrorCollector,
    InvalidConfig,
    PeerError,
    SimulatorError,
    ZenostatError,
    repeated,
)
from zenostat.topics.keys import check_name
from zenostat.topics.messages import Manifest

A = TypeVar("A")
T = TypeVar("T")

NODE_ERRORS = (BusError, PeerError, SimulatorError)
"""Errors of one node, which do not concern the others; any other error is the caller's."""

_MAX_THREADS = 64


class NodeAddress(NamedTuple):
    """Endpoint of a bus, and the name of a node on it."""

    endpoint: str
    node: str

    def describe(self, slot: int) -> str:
        """Return how errors name the slot of this node."""
        return f"slot {slot} (node {self.node!r} at {self.endpoint})"


def node_addresses(
    connect: str | Sequence[str] | None, node: str | Sequence[str] | None, count: int | None = None
) -> tuple[NodeAddress, ...]:
    """Return the address of each slot's node.

    Args:
        connect: Endpoint of each node, or one for all.
        node: Name of each node, or one for all.
        count: Number of slots that the caller expects; None: any.

    Raises:
        InvalidConfig: Endpoints and names, or the number expected, do not match; a malformed endpoint or name; a node
            that is listed twice; or none at all. The text lists all errors.
    """
    if connect is None or node is None:
        raise InvalidConfig(
            "several nodes need connect= and node=: a list of endpoints and of names, or one text for all slots"
        )
    endpoints = [connect] if isinstance(connect, str) else [*connect]
    names = [node] if isinstance(node, str) else [*node]
    size = max(len(endpoints), len(names)) if endpoints and names else 0
    if isinstance(connect, str):
        endpoints *= size
    if isinstance(node, str):
        names *= size
    if not size or len(endpoints) != len(names):
        raise InvalidConfig(
            f"connect has {len(endpoints)} endpoints and node {len(names)} names; one of each for every slot expected, "
            "or one text for all slots"
        )
    errors = ErrorCollector()
    for endpoint in dict.fromkeys(endpoints):
        errors.collect(partial(check_endpoint, str(endpoint)))
    for name in dict.fromkeys(names):
        errors.collect(partial(check_name, str(name), "the node"))
    errors.raise_if_any()
    addresses = tuple(NodeAddress(*address) for address in zip(endpoints, names, strict=True))
    if twice := repeated(addresses):
        raise InvalidConfig(f"node {twice[0].node!r} at {twice[0].endpoint} is listed twice; a node has one controller")
    if count not in (None, len(addresses)):
        raise InvalidConfig(
            f"num_envs = {count}, but connect and node list {len(addresses)} nodes: "
            f"gymnasium.make_vec(…, num_envs={len(addresses)})"
        )
    return addresses


def check_compatible(addresses: Sequence[NodeAddress], manifests: Sequence[Manifest]) -> None:
    """Check that one policy fits all nodes: the same observations, actions, spaces and wrappers, and a single slot.

    Raises:
        InvalidConfig: Lists each node that does not fit the first one, with the first difference.
    """
    errors = []
    for slot, (address, manifest) in enumerate(zip(addresses, manifests, strict=True)):
        if manifest.slots > 1:
            errors.append(f"{address.describe(slot)} has {manifest.slots} slots; a fleet needs nodes with one slot")
        elif difference := _difference(manifests[0], manifest):
            errors.append(f"{address.describe(slot)} does not fit slot 0: {difference}")
    if errors:
        raise InvalidConfig("\n".join(errors))


def _difference(first: Manifest, other: Manifest) -> str:
    if first.task == other.task and (first.sensors, first.meters, first.actuators) == (
        other.sensors,
        other.meters,
        other.actuators,
    ):
        return ""
    pairs = [(_observation_names(manifest), Actions(manifest)) for manifest in (first, other)]
    (first_names, first_actions), (names, actions) = pairs
    for kind, expected, actual in (
        ("observations", first_names, names),
        ("actions", tuple(first_actions.names), tuple(actions.names)),
    ):
        if expected != actual:
            return _describe_names(kind, expected, actual)
    for kind, space, other_space in (
        ("observation space", spaces.observation_space(first), spaces.observation_space(other)),
        ("action space", first_actions.space, actions.space),
    ):
        if space != other_space:
            return f"its {kind} is {other_space}, not {space}"
    if first.task.wrappers != other.task.wrappers:
        return f"its scenario has the wrappers {other.task.wrappers}, not {first.task.wrappers}"
    return ""


def _observation_names(manifest: Manifest) -> tuple[str, ...]:
    return (*map(str, manifest.task.time), *manifest.observed_names)


def _describe_names(kind: str, expected: Sequence[str], actual: Sequence[str]) -> str:
    missing = [name for name in expected if name not in actual]
    added = [name for name in actual if name not in expected]
    parts = [f"{label} {_listed(names)}" for label, names in (("without", missing), ("with", added)) if names]
    return f"its {kind} are {' and '.join(parts)}" if parts else f"its {kind} are in another order"


def combined_error(errors: Mapping[int, ZenostatError], addresses: Sequence[NodeAddress]) -> ZenostatError:
    """Return one error that names the slots of all; of their class, or a `BusError` if the classes differ."""
    slots_of = defaultdict(list)
    for slot, error in sorted(errors.items()):
        slots_of[str(error)].append(slot)
    lines = [
        f"{addresses[slots[0]].describe(slots[0]) if len(slots) == 1 else f'slots {_listed(slots)}'}: {text}"
        for text, slots in slots_of.items()
    ]
    kinds = {type(error) for error in errors.values()}
    return (kinds.pop() if len(kinds) == 1 else BusError)("\n".join(lines))


def _listed(items: Sequence[object]) -> str:
    return ", ".join(map(str, items[:10])) + (f" and {len(items) - 10} more" if len(items) > 10 else "")


def attempt_all(function: Callable[[A], T], items: Sequence[A]) -> list[T | ZenostatError]:
    """Call a function for each item at the same time, in threads; return each result, or the error of its node."""

    def attempt(item: A) -> T | ZenostatError:
        try:
            return function(item)
        except NODE_ERRORS as error:
            return error

    if len(items) <= 1:
        return [attempt(item) for item in items]
    with ThreadPoolExecutor(min(len(items), _MAX_THREADS)) as pool:
        return list(pool.map(attempt, items))


def all_results(function: Callable[[int], T], addresses: Sequence[NodeAddress]) -> tuple[T, ...]:
    """Return the result of a function for each slot, called as by `attempt_all`; raise one error if any fails."""
    results, errors = list[T](), dict[int, ZenostatError]()
    for slot, result in enumerate(attempt_all(function, range(len(addresses)))):
        if isinstance(result, ZenostatError):
            errors[slot] = result
        else:
            results.append(result)
    if errors:
        raise combined_error(errors, addresses)
    return tuple(results)


def connect_all(
    addresses: Sequence[NodeAddress], keys: Path | None, close: ExitStack
) -> tuple[tuple[Bus, Manifest], ...]:
    """Return the bus and the manifest of each slot's node; slots with the same endpoint share a bus.

    Args:
        addresses: The slots' nodes.
        keys: Folder of certificates, for endpoints with TLS.
        close: Closes the buses.

    Raises:
        NodeNotFound: No program listens at an endpoint, or has no node of the name; the text lists all of them.
        InvalidConfig: The keys cannot be used.
    """
    endpoints = list(dict.fromkeys(address.endpoint for address in addresses))
    buses = dict(
        zip(endpoints, attempt_all(lambda at: connect_bus(at, keys=keys, role=RESETTING), endpoints), strict=True)
    )
    for bus in buses.values():
        if isinstance(bus, Bus):
            close.enter_context(bus)

    def find(slot: int) -> tuple[Bus, Manifest]:
        endpoint, node = addresses[slot]
        bus = buses[endpoint]
        if isinstance(bus, ZenostatError):
            raise bus
        return bus, bus.manifest(node)

    return all_results(find, addresses)
