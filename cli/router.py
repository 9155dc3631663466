"""`zenostat router`: a Zenoh router between nodes and controllers."""

from __future__ import annotations

from typing import Annotated

import typer

from zenostat.cli.console import err, out, until_signal
from zenostat.cli.options import CertificateName, Keys


def router(
    listen: Annotated[
        list[str] | None, typer.Option(help="Endpoint to listen on; repeatable. Default: port 7447 on loopback.")
    ] = None,
    connect: Annotated[
        list[str] | None, typer.Option(help="Endpoint of another router, which may start later; repeatable.")
    ] = None,
    expose: Annotated[bool, typer.Option("--expose", help="Allow connections from other machines.")] = False,
    keys: Keys = None,
    certificate: CertificateName = None,
) -> None:
    """Run a router until Ctrl-C: nodes and controllers connect to it instead of to each other.

    Example: `zenostat router --listen tcp/127.0.0.1:7447`
    """
    from zenostat.bridge.transport.session import Mode, default_endpoint, exposure, open_session
    from zenostat.topics.keys import Role

    endpoints = listen or [default_endpoint(keys)]
    with (
        until_signal() as stop,
        open_session(
            listen=endpoints,
            connect=connect or (),
            wait=True,
            expose=expose,
            keys=keys,
            role=Role.NODE,
            certificate=certificate,
            mode=Mode.ROUTER,
        ),
    ):
        if warning := exposure(endpoints, keys):
            err.print(f"warning: {warning}", style="yellow", markup=False)
        out.print(f"router on {', '.join(endpoints)}; press Ctrl-C to stop", markup=False)
        stop.wait()
