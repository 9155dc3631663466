"""`zenostat gateway`: access to a bus for clients of other protocols."""

from __future__ import annotations

import asyncio
import importlib.util
from collections.abc import Awaitable, Callable, Mapping
from contextlib import AbstractAsyncContextManager, AsyncExitStack
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Protocol

import typer

from zenostat.bridge.runtime.service_manager import reported
from zenostat.bridge.runtime.signals import TERMINATION_SIGNALS, override_signals
from zenostat.cli.boptest import boptest
from zenostat.cli.console import err, out
from zenostat.cli.gateway_clients import Allow, clients_of, notify
from zenostat.cli.options import DEFAULTS, BusOptions, Expose, Wait, on_bus, only_node
from zenostat.cli.waiting import RETRY_S, Waiting, when_there
from zenostat.topics.errors import InvalidConfig, NodeNotFound, RequestRejected, ZenostatError
from zenostat.topics.extras import install_command
from zenostat.topics.keys import Role, check_name
from zenostat.topics.plurals import counted

if TYPE_CHECKING:
    import zenoh

    from zenostat.gateways.node_client import NodeClient
    from zenostat.topics.messages import Manifest

_RELINQUISH_S = 2.0
_END_S = 5.0  # more than a gateway takes to answer its clients

app = typer.Typer(add_completion=False, rich_markup_mode="markdown", no_args_is_help=True)


@app.callback()
def gateway() -> None:
    """Give clients of other protocols access to the nodes of a bus.

    Example: `zenostat gateway modbus office`
    """


app.command()(boptest)


@app.command()
@on_bus
def zeromq(
    options: BusOptions = DEFAULTS,
    node: Annotated[list[str] | None, typer.Option(metavar="<str>", help="Serve only this node. Default: all.")] = None,
    publish: Annotated[
        str, typer.Option(help="Address that publishes samples, events and manifests.")
    ] = "tcp://127.0.0.1:5556",
    command: Annotated[str, typer.Option(help="Address that receives requests.")] = "tcp://127.0.0.1:5557",
    lease: Annotated[
        float, typer.Option(help="Seconds without a heartbeat after which a client counts as disconnected.")
    ] = 10.0,
    allow: Allow = None,
    wait: Wait = False,
    expose: Expose = False,
) -> None:
    """Run a ZeroMQ gateway until Ctrl-C. With keys, it uses the gateway role.

    Example: `zenostat gateway zeromq --node office`
    """
    if importlib.util.find_spec("zmq") is None:
        raise InvalidConfig(f"pyzmq is not installed: {install_command('zeromq')}")
    from zenostat.gateways.zeromq import Gateway
    from zenostat.gateways.zeromq.sockets import is_local

    clients = clients_of(None, allow, is_exposed=not is_local(command), name_themselves=True)
    only = only_node(node)
    served = "all nodes" if only == "*" else f"node {only}"

    def run() -> Gateway:
        opened = options.open_session(Role.GATEWAY)
        with (
            opened as session,
            Gateway(
                session,
                only,
                publish=publish,
                command=command,
                lease_s=lease,
                expose=expose,
                identity=opened.name,
                why_gone=opened.why_gone,
                clients=clients,
                notify=notify,
            ) as running,
            override_signals(lambda *_: running.stop(), *TERMINATION_SIGNALS),
        ):
            addresses = f"samples on {running.publish}, requests on {running.command}"
            may = f"; {clients.description}" if clients.is_restricted else ""
            out.print(f"ready: {served} of {options.endpoint}; {addresses}{may}; press Ctrl-C to stop")
            running.run()
        return running

    counts = when_there(run, wait=wait).counts
    out.print(
        f"{counted(counts.samples, 'sample')}, {counted(counts.requests, 'request')}, {counts.denied} of them rejected"
    )


def manifest_of(node: str, options: BusOptions, *, wait: bool) -> Manifest:
    """Return the manifest of a node, with `wait` as soon as the bus and the node are there."""

    def read() -> Manifest:
        with options.open_bus(Role.GATEWAY) as bus:
            return bus.manifest(node)

    return when_there(read, wait=wait)


class NodeGateway(Protocol):
    """A running gateway of one node."""

    @property
    def description(self) -> str:
        """Node and address, for the first line."""

    async def run(self) -> None:
        """Serve until it fails; cancelled at the end."""

    def summary(self) -> str:
        """Return counts for the last line."""


def serve(
    node: str,
    gateway: Callable[[NodeClient], AbstractAsyncContextManager[NodeGateway]],
    *,
    source: str,
    via: str,
    options: BusOptions,
    wait: bool,
    exclusive: Mapping[str, str] | None = None,
) -> None:
    """Run a gateway of one node until a signal; print a line that begins with `ready:`, and counts at the end.

    In the end it relinquishes the commands that its clients have written through it, and those that an earlier process
    of the same source has left.

    Args:
        node: name of the node.
        gateway: creates the gateway in the running loop.
        source: name of the gateway among the sources of values and events.
        via: the protocol of its clients, the way in that recordings show.
        options: the bus; with keys, it uses the gateway role.
        wait: wait for the bus and the node instead of failing.
        exclusive: further names that no other gateway of the node may have, with what to do if one has.

    Raises:
        InvalidConfig: a source that is not valid in a topic.
        NodeNotFound: nobody listens at the endpoint, or the node is not on the bus, and `wait` is false.
        NameInUse: another gateway of the node has the source, or another of the names.
        SystemExit: a signal arrived before the gateway was ready.
    """
    check_name(source, "--source")
    names = {source: "choose another name with --source", **(exclusive or {})}
    attempt = partial(_serve, node=node, gateway=gateway, source=source, via=via, names=names, options=options)
    number = asyncio.run(_until_served(attempt, wait=wait))
    if number:
        raise SystemExit(128 + number)


async def _until_served(serve_until: Callable[[asyncio.Future[int]], Awaitable[int]], *, wait: bool) -> int:
    """Serve until a signal, once or, with `wait`, as soon as the node is there; return as `_serve`."""
    loop = asyncio.get_running_loop()
    stopped: asyncio.Future[int] = loop.create_future()

    def stop(number: int) -> None:
        if not stopped.done():
            stopped.set_result(number)

    for number in TERMINATION_SIGNALS:
        loop.add_signal_handler(number, stop, number)
    waiting = Waiting(wait)
    while True:
        try:
            return await serve_until(stopped)
        except NodeNotFound as error:
            waiting.report(error)
        await asyncio.wait((stopped,), timeout=RETRY_S)
        if stopped.done():
            return stopped.result()


async def _serve(
    stopped: asyncio.Future[int],
    *,
    node: str,
    gateway: Callable[[NodeClient], AbstractAsyncContextManager[NodeGateway]],
    source: str,
    via: str,
    names: Mapping[str, str],
    options: BusOptions,
) -> int:
    """Return the number of the signal that arrived before the gateway was ready; 0 if it was ready."""
    opened = options.open_session(Role.GATEWAY)
    with opened as session:
        async with AsyncExitStack() as stack:
            starting = asyncio.create_task(_start(stack, session, node, gateway, source, via, names, opened.name))
            if not await _ends_before(starting, stopped):
                return stopped.result()
            client, running = await starting
            client.listeners.presence.append(
                lambda is_online: out.print(
                    f"{node}: on the bus again" if is_online else f"{node}: gone{opened.why_gone()}; waiting for it"
                )
            )
            out.print(f"ready: {running.description}; press Ctrl-C to stop")
            stack.enter_context(reported(asyncio.get_running_loop().call_soon_threadsafe))
            serving = asyncio.create_task(running.run())
            if await _ends_before(serving, stopped):
                await serving  # it has failed
        missed = f"; {counted(client.counts.missed, 'message')} of the node missed" if client.counts.missed else ""
        out.print(running.summary() + missed)
    return 0


async def _start(
    stack: AsyncExitStack,
    session: zenoh.Session,
    node: str,
    gateway: Callable[[NodeClient], AbstractAsyncContextManager[NodeGateway]],
    source: str,
    via: str,
    names: Mapping[str, str],
    identity: str,
) -> tuple[NodeClient, NodeGateway]:
    """Enter the contexts of a gateway."""
    from zenostat.gateways.exclusive_names import reserved_names
    from zenostat.gateways.node_client import NodeClient

    client = await stack.enter_async_context(NodeClient(session, node, source=source, identity=identity, via=via))
    on_bus = {client.source: names[source]}  # below the certificate's name, if there is one
    await stack.enter_async_context(reserved_names(session, node, {**names, **on_bus}, identity))
    stack.push_async_callback(_relinquish, client)
    return client, await stack.enter_async_context(gateway(client))


async def _ends_before(task: asyncio.Task[Any], stopped: asyncio.Future[int]) -> bool:
    """Wait for a task, or for a signal, which cancels it; return whether the task has ended by itself."""
    from zenostat.gateways.tasks import cancel

    await asyncio.wait((task, stopped), return_when=asyncio.FIRST_COMPLETED)
    if task.done():
        return True
    await cancel(task, retry_s=_END_S)
    return False


async def _relinquish(client: NodeClient) -> None:
    """Relinquish the commands of a gateway that ends: nobody could relinquish them through it afterwards."""
    if not client.is_online:
        return  # the operator has been told, and a node that has ended has no commands
    try:
        async with asyncio.timeout(_RELINQUISH_S):
            done = await client.relinquish_written()
    except RequestRejected:  # a replay has no commands
        return
    except (ZenostatError, TimeoutError) as error:
        reason = str(error) or f"node {client.name!r} does not answer"
        err.print(f"commands through this gateway are not relinquished: {reason}")
        return
    if done.count:
        out.print(f"relinquished {counted(done.count, 'command')} of this gateway")
    for command, reason in done.rejected.items():
        remains = f"{command.actuator} at priority {command.priority}, written as {command.source}"
        err.print(f"a command through this gateway remains in force: {remains}: {reason}")
