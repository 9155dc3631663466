"""`zenostat gateway`: clients of other protocols join a bus."""

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


@app.callback(epilog="Example: `zenostat gateway zeromq --node office`")
def gateway() -> None:
    """Let clients of other protocols use the nodes of a bus.

    Example: `zenostat gateway zeromq --node office`
    """


@app.command()
def zeromq(
    connect: Connect = None,
    keys: Keys = None,
    certificate: CertificateName = None,
    node: Annotated[str, typer.Option(help="Only this node; all by default.")] = "*",
    publish: Annotated[str, typer.Option(help="Where samples, events and manifests go out.")] = "tcp://127.0.0.1:5556",
    command: Annotated[str, typer.Option(help="Where requests come in.")] = "tcp://127.0.0.1:5557",
    lease: Annotated[float, typer.Option(help="Seconds after which a peer without a heartbeat is gone.")] = 10.0,
    expose: Annotated[bool, typer.Option("--expose", help="Allow endpoints beyond this machine.")] = False,
) -> None:
    """Joins programs that speak only ZeroMQ to a bus, until Ctrl-C; with keys, as a controller.

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
        of = "all nodes" if node == "*" else node
        where = f"samples on {running.publish}, requests to {running.command}"
        out.print(f"ready: {of} of {connect}: {where}; Ctrl-C ends it", soft_wrap=True)
        running.run()
    counts = running.counts
    out.print(f"{counts.samples} samples, {counts.requests} requests, {counts.denied} of them denied")
