"""`zenostat gateway`: access to a bus for clients of other protocols."""

from __future__ import annotations

import importlib.util
from typing import Annotated

import typer

from bridge.runtime.signals import TERMINATION_SIGNALS, override_signals
from bridge.transport.session import default_endpoint
from cli.console import out
from cli.options import CertificateName, Connect, Keys
from topics.errors import InvalidConfig
from topics.extras import install_command
from topics.keys import Role

app = typer.Typer(add_completion=False, rich_markup_mode="markdown", no_args_is_help=True)


@app.callback()
def gateway() -> None:
    """Give clients of other protocols access to the nodes of a bus.

    Example: `zenostat gateway zeromq --node office`
    """


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
