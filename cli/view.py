"""`zenostat view`: show a recording again, or write a screenshot of it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from zenostat.cli.console import out, until_signal
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.user_file import check_user_file

if TYPE_CHECKING:
    from zenostat.views.live.screenshot import Screenshot

At = Annotated[
    str | None,
    typer.Option(help="Simulated time of the cursor in the screenshot, e.g. 07-02T17:30. Default: the newest sample."),
]
Size = Annotated[
    str | None, typer.Option(help="Width and height of the screenshot in pixels.", show_default="1920x1080")
]
Tab = Annotated[
    str | None,
    typer.Option(
        help="Tab in the screenshot: Building, Zones, Energy, Grid, Control, Other points or Events; of one of several "
        "nodes NODE/TAB. Default: the first."
    ),
]


def view(
    recording: Annotated[Path, typer.Argument(help="A recording that zenostat monitor --save wrote: FILE.rrd.")],
    web: Annotated[bool, typer.Option("--web", help="Serve the viewer as a web page on this machine.")] = False,
    screenshot: Annotated[Path | None, typer.Option(help="Write a screenshot to FILE.png.")] = None,
    at: At = None,
    size: Size = None,
    tab: Tab = None,
) -> None:
    """Show a recording: in a window until it is closed, as a web page until Ctrl-C, or as a screenshot.

    Example: `zenostat view run.rrd --screenshot run.png --at 07-02T17:30`
    """
    from zenostat.views.live.screenshot import draw
    from zenostat.views.live.viewer import readable, web_viewer, window

    check_user_file(recording, expected="a recording that zenostat monitor --save FILE.rrd writes")
    if web and screenshot is not None:
        raise InvalidConfig("--web and --screenshot exclude each other")
    request = screenshot_request(screenshot, at, size, tab)
    if request is not None:
        draw(recording, request)
        out.print(f"screenshot: {request.path}")
    elif web:
        with readable(recording) as path, until_signal() as stop, web_viewer(path) as (page, _):
            out.print(f"viewer: {page}; press Ctrl-C to stop")
            stop.wait()
    else:
        window(recording)


def screenshot_request(path: Path | None, at: str | None, size: str | None, tab: str | None) -> Screenshot | None:
    """Check the options of a screenshot; None if there is to be none.

    Raises:
        InvalidConfig, ViewerError: See `zenostat.views.live.screenshot.read_screenshot`; or an option lacks its path.
    """
    from zenostat.views.live.screenshot import SIZE, read_screenshot

    if path is not None:
        return read_screenshot(path, at, size or SIZE, tab)
    for name, value in (("--at", at), ("--size", size), ("--tab", tab)):
        if value is not None:
            raise InvalidConfig(f"{name} {value} needs --screenshot FILE.png")
    return None
