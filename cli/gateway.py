"""`zenostat gateway`: access to a bus for clients of other protocols."""

from __future__ import annotations

import asyncio
import importlib.util
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Protocol

import typer

from bridge.runtime.signals import TERMINATION_SIGNALS, override_signals
from bridge.transport.session import default_endpoint
from cli.boptest import boptest
from cli.console import out
from cli.options import CertificateName, Connect, Keys
from topics.errors import InvalidConfig
from topics.extras import install_command
from topics.keys import Role

if TYPE_CHECKING:
    from bridge.gateways.node_client import NodeClient

app = typer.Typer(add_completion=False, rich_markup_mode="markdown", no_args_is_help=True)


@app.callback()
def gateway() -> None:
    """Give clients of other protocols access to the nodes of a bus.

    Example: `zenostat gateway modbus office`
    """


app.command()(boptest)


@app.command()
def zeromq(
    connect: Connect = None,
    keys: Keys = None,
    certificate: CertificateName = None,
    node: Annotated[str, typer.Option(help="Serve only this node. Default: all.")] = "*",
    publish: Annotated[
        str, typer.Option(help="Address that publishes samples, events and manifests.")
    ] = "tcp://127.0.0.1:5556",
    command: Annotated[str, typer.Option(help="Address that receives requests.")] = "tcp://127.0.0.1:5557",
    lease: Annotated[
        float, typer.Option(help="Seconds without a heartbeat after which a client counts as disconnected.")
    ] = 10.0,
    expose: Annotated[bool, typer.Option("--expose", help="Allow addresses reachable from other machines.")] = False,
) -> None:
    """Run a ZeroMQ gateway until Ctrl-C. With keys, it uses the controller role.

    Example: `zenostat gateway zeromq --node office`
    """
    if importlib.util.find_spec("zmq") is None:
        raise InvalidConfig(f"pyzmq is not installed: {install_command('zeromq')}")
    from bridge.gateways.zeromq import Gateway
    from bridge.transport.session import open_session

    connect = connect or default_endpoint(keys)
    with (
        open_session(connect=[connect], keys=keys, role=Role.CONTROLLER, certificate=certificate) as session,
        Gateway(session, node, publish=publish, command=command, lease_s=lease, expose=expose) as running,
        override_signals(lambda *_: running.stop(), *TERMINATION_SIGNALS),
    ):
        served = "all nodes" if node == "*" else f"node {node}"
        addresses = f"samples on {running.publish}, requests on {running.command}"
        out.print(f"ready: {served} of {connect}; {addresses}; press Ctrl-C to stop", soft_wrap=True)
        running.run()
    counts = running.counts
    out.print(f"{counts.samples} samples, {counts.requests} requests, {counts.denied} of them rejected")


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
    connect: str | None,
    keys: Path | None,
    certificate: str | None,
) -> None:
    """Run a gateway of one node until Ctrl-C or SIGTERM; print a line that begins with `ready:`, and counts at the end.

    Args:
        node: name of the node.
        gateway: creates the gateway in the running loop.
        source: name of the gateway among the sources of values and events.
        connect: endpoint of the bus.
        keys: folder of keys; with it, the gateway uses the controller role.
        certificate: name of another certificate of that role.
    """
    asyncio.run(_serve(node, gateway, source, connect or default_endpoint(keys), keys, certificate))


async def _serve(
    node: str,
    gateway: Callable[[NodeClient], AbstractAsyncContextManager[NodeGateway]],
    source: str,
    connect: str,
    keys: Path | None,
    certificate: str | None,
) -> None:
    from bridge.gateways.node_client import NodeClient
    from bridge.transport.session import open_session

    loop, stopped = asyncio.get_running_loop(), asyncio.Event()
    for number in TERMINATION_SIGNALS:
        loop.add_signal_handler(number, stopped.set)
    with open_session(connect=[connect], keys=keys, role=Role.CONTROLLER, certificate=certificate) as session:
        async with NodeClient(session, node, source=source) as client, gateway(client) as running:
            client.listeners.presence.append(
                lambda is_online: out.print(f"{node}: {'on the bus again' if is_online else 'gone; waiting for it'}")
            )
            out.print(f"ready: {running.description}; press Ctrl-C to stop", soft_wrap=True, markup=False)
            serving, waiting = asyncio.create_task(running.run()), asyncio.create_task(stopped.wait())
            try:
                await asyncio.wait((serving, waiting), return_when=asyncio.FIRST_COMPLETED)
            finally:
                waiting.cancel()
                serving.cancel()
                await asyncio.gather(serving, waiting, return_exceptions=True)
        if not serving.cancelled() and serving.exception() is not None:
            raise serving.exception()  # type: ignore[misc]
        out.print(running.summary(), soft_wrap=True, markup=False)
