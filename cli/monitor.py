"""`zenostat monitor`: live plots in Rerun."""

from __future__ import annotations

import signal
import threading
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zenostat.bridge.runtime.scratch import scratch_folder
from zenostat.bridge.transport.session import DEFAULT_ENDPOINT
from zenostat.cli.console import err, out, until_signal
from zenostat.cli.options import BusOptions, CertificateName, Keys, only_node
from zenostat.cli.view import At, Size, Tab, screenshot_request
from zenostat.cli.waiting import Waiting
from zenostat.topics.errors import InvalidConfig, NodeNotFound, ViewerError, did_you_mean
from zenostat.topics.keys import Role
from zenostat.topics.plurals import counted

if TYPE_CHECKING:
    import zenoh

_PAUSE_S = 0.2
_VIEWER_S = 5.0
"""How long a viewer may take for the last samples; that of a page that is suspended takes none."""


def monitor(
    node: Annotated[list[str] | None, typer.Option(metavar="<str>", help="Show only this node. Default: all.")] = None,
    connect: Annotated[
        str | None,
        typer.Option(help="Endpoint of the bus; waits until it is available.", show_default=DEFAULT_ENDPOINT),
    ] = None,
    keys: Keys = None,
    certificate: CertificateName = None,
    save: Annotated[Path | None, typer.Option(help="Write a recording to FILE.rrd.")] = None,
    screenshot: Annotated[Path | None, typer.Option(help="Write a screenshot to FILE.png at the end.")] = None,
    at: At = None,
    size: Size = None,
    tab: Tab = None,
    web: Annotated[bool, typer.Option("--web", help="Serve the viewer as a web page on this machine.")] = False,
    once: Annotated[bool, typer.Option("--once", help="Stop when a monitored node leaves the bus.")] = False,
) -> None:
    """Stream the bus to Rerun until Ctrl-C: to the viewer, a web page, a recording or a screenshot.

    Example: `zenostat monitor --save run.rrd --screenshot run.png --at 07-02T17:30`
    """
    from zenostat.views.live.screenshot import check_writable, draw
    from zenostat.views.live.viewer import how_to_open

    only, request = only_node(node), screenshot_request(screenshot, at, size, tab)
    if save is not None:
        if save.suffix != ".rrd":
            raise InvalidConfig(f"--save {save}: expected a .rrd file, for example --save run.rrd")
        check_writable(save)
    with ExitStack() as stack:
        recording = save
        if request is not None and recording is None:
            recording = stack.enter_context(scratch_folder()) / "run.rrd"
        samples = _stream(only, BusOptions(connect, keys, certificate), recording, web=web, once=once)
        if save is not None and samples is not None:
            out.print(f"recording: {save}; open it with: {how_to_open(save)}")
        if request is not None and recording is not None and samples:
            draw(recording, request)
            out.print(f"screenshot: {request.path}")
        elif request is not None and samples == 0:
            raise ViewerError(f"no screenshot was written to {request.path}: the monitor received no samples")


def _stream(node: str, options: BusOptions, recording: Path | None, *, web: bool, once: bool) -> int | None:
    """Log samples until Ctrl-C, or until a node leaves the bus; return their number, None if there was no bus."""
    from zenostat.bridge.runtime import affinity
    from zenostat.cli.monitor_stream import open_stream

    with ExitStack() as stack:
        viewer = stack.enter_context(ExitStack())
        sinks = _sinks(viewer, recording, web)
        stop = stack.enter_context(until_signal())
        if not _wait_for_bus(options, stop):
            return None
        session = stack.enter_context(options.open_session(Role.MONITOR, wait=True))
        affinity.lower_priority()
        is_live = recording is None or len(sinks) > 1
        with open_stream(session, node, sinks, is_live=is_live) as stream:
            out.print(f"connected to {options.endpoint}{_missing_note(session, node)}; press Ctrl-C to stop")
            stream.run(until=lambda: stop.is_set() or (once and stream.left))
            if is_live and not stream.is_shown(_VIEWER_S):
                rest = "ended without the rest" if web else "close its window, or press Ctrl-C again"
                err.warning(f"the viewer has not taken all samples within {_VIEWER_S:g} s; {rest}")
                viewer.close()
                signal.signal(signal.SIGINT, signal.SIG_DFL)
        out.print(f"{counted(stream.samples, 'sample')} logged, {stream.missed} missed")
        return stream.samples


def _missing_note(session: zenoh.Session, node: str) -> str:
    """Describe what the monitor waits for; empty if the node, or any node for `*`, is on the bus."""
    from zenostat.topics.keys import MANIFEST, node_of

    nodes = sorted({node_of(str(reply.ok.key_expr)) for reply in session.get(MANIFEST.at("*")) if reply.ok})
    if node in nodes or (node == "*" and nodes):
        return ""
    if node == "*":
        return "; no node is on this bus yet; waiting for one"
    return f"; waiting for node {node!r}, which is not on this bus ({did_you_mean(node, nodes)})"


def _wait_for_bus(options: BusOptions, stop: threading.Event) -> bool:
    """Wait until the endpoint accepts connections; return False if `stop` is set first."""
    waiting = Waiting(True)
    while not stop.is_set():
        try:
            with options.open_session(Role.MONITOR):
                return True
        except NodeNotFound as error:
            waiting.report(error)
            stop.wait(_PAUSE_S)
    return False


def _sinks(stack: ExitStack, recording: Path | None, web: bool) -> list[Any]:
    import rerun as rr

    from zenostat.views.live.viewer import NO_DISPLAY, has_display, program, web_viewer

    sinks: list[Any] = []
    if recording is not None:
        sinks.append(rr.FileSink(str(recording)))
    if web:
        page, url = stack.enter_context(web_viewer())
        out.print(f"viewer: {page}")
        sinks.append(rr.GrpcSink(url))
    if not sinks:
        if not has_display():
            raise InvalidConfig(f"{NO_DISPLAY}; without one, use --web, --save FILE.rrd or --screenshot FILE.png")
        rr.spawn(connect=False, executable_path=program())
        sinks.append(rr.GrpcSink())
    return sinks
