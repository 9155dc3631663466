"""`zenostat router`: a Zenoh router between nodes and controllers."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Annotated

import typer

from zenostat.cli.console import err, out, until_signal
from zenostat.cli.options import CertificateName, Expose, Keys


def router(
    listen: Annotated[
        list[str] | None, typer.Option(help="Endpoint to listen on; repeatable. Default: port 7447 on loopback.")
    ] = None,
    connect: Annotated[
        list[str] | None, typer.Option(help="Endpoint of another router, which may start later; repeatable.")
    ] = None,
    expose: Expose = False,
    keys: Keys = None,
    certificate: CertificateName = None,
) -> None:
    """Run a router until Ctrl-C: nodes and controllers connect to it instead of to each other.

    Example: `zenostat router --listen tcp/127.0.0.1:7447`
    """
    from zenostat.bridge.runtime.service_manager import reported
    from zenostat.bridge.runtime.timer import Timer
    from zenostat.bridge.transport.session import Mode, default_endpoint, exposure, keys_folder, open_session
    from zenostat.topics.keys import Role

    endpoints = listen or [default_endpoint(keys)]
    opened = open_session(
        listen=endpoints,
        connect=connect or (),
        wait=True,
        expose=expose,
        keys=keys,
        role=Role.NODE,
        certificate=certificate,
        mode=Mode.ROUTER,
        warn=err.warning,
    )
    with until_signal() as stop, opened as session, ExitStack() as stack:
        if warning := exposure(endpoints, keys):
            err.warning(warning)
        if (folder := keys_folder(keys)) is not None:
            from zenostat.bridge.transport.deny_list import DenyList

            timer = stack.enter_context(Timer())
            revoked = DenyList(
                folder, session, timer, lambda names: out.print(f"revoked: {', '.join(sorted(names))}"), err.warning
            )
            stack.callback(revoked.close)
            opened.watch_expiry(timer, err.warning)
        out.print(f"router on {', '.join(endpoints)}; press Ctrl-C to stop")
        with reported(lambda report: report()):
            stop.wait()
