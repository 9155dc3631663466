"""`zenostat room`: the control room."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from zenostat.bridge.runtime.signals import TERMINATION_SIGNALS, override_signals
from zenostat.bridge.transport.session import keys_folder
from zenostat.cli.console import out
from zenostat.cli.options import DEFAULTS, BusOptions, on_bus
from zenostat.cli.token_file import read_token
from zenostat.cli.waiting import when_there
from zenostat.cli.write import user_name
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.extras import requires_extra
from zenostat.topics.keys import Role, safe_name

if TYPE_CHECKING:
    from zenostat.views.room.users import PageTls


@on_bus
def room(
    options: BusOptions = DEFAULTS,
    address: Annotated[
        str, typer.Option(help="HOST:PORT of this machine to listen on; port 0 chooses a free one.")
    ] = "127.0.0.1:8600",
    expose: Annotated[
        bool, typer.Option("--expose", help="Allow an address that others reach; needs --page-certificate and --keys.")
    ] = False,
    page_certificate: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.pem",
            help="Certificate of the page: HTTPS, with the names and roles of the bus for its users.",
        ),
    ] = None,
    page_key: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Private key of the page's certificate. Default: FILE.key beside it."),
    ] = None,
    operator: Annotated[
        str | None, typer.Option(help="Name under which your changes are recorded. Default: your user name.")
    ] = None,
    api_token_file: Annotated[
        Path | None, typer.Option(help="File with the token of Prometheus and Grafana; created if it is missing.")
    ] = None,
    scenarios: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Folder of scenarios, with the models and weather files that they may name: operators save scenarios "
            "there and start nodes from them.",
        ),
    ] = None,
    trainings: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Folder of trainings and studies whose curves are shown; reports and nodes load their policies.",
        ),
    ] = None,
    controller: Annotated[
        list[str] | None,
        typer.Option(
            metavar="CONTROLLER",
            help="Own controller that operators may try in What if, as for zenostat run: path/to/file.py:MyController, "
            "the folder of a training, FILE.npz, or FILE.yaml; may be repeated.",
        ),
    ] = None,
    audit_log: Annotated[
        Path | None, typer.Option(metavar="FILE", help="File to which each change is added as a line of JSON.")
    ] = None,
) -> None:
    """Serve a web page to watch and operate all nodes of a bus, until Ctrl-C.

    Example: `zenostat room --operator ada.lovelace`

    It waits for the bus, and prints a link, which signs one browser in, once. With keys, it uses the gateway role.
    """
    with requires_extra("room", "the control room", "starlette and uvicorn"):
        from zenostat.views.room.access import OPERATOR
        from zenostat.views.room.app import RoomSettings
        from zenostat.views.room.server import RoomServer
        from zenostat.views.room.trial_controllers import offered_controllers
    token = None if api_token_file is None else read_token(api_token_file, "--api-token-file")
    name = safe_name(user_name("operator"))[:64] if operator is None else operator
    if not re.fullmatch(OPERATOR, name):
        raise InvalidConfig(
            f"--operator {name!r}: a name of up to 64 letters, digits, '_', '.' and '-' expected, such as ada.lovelace"
        )
    folder = keys_folder(options.keys)
    keys = folder and folder.resolve()
    tls = _tls(keys, page_certificate, page_key, expose=expose)
    settings = RoomSettings(
        scenarios=_folder("--scenarios", scenarios),
        trainings=_folder("--trainings", trainings),
        node_settings={"connect": [options.endpoint], "keys": keys},
        controllers=offered_controllers(controller or ()),
        audit_log=audit_log,
    )
    with (
        when_there(partial(options.open_bus, Role.GATEWAY), wait=True) as bus,
        RoomServer(
            bus, address, operator=name, api_token=token, settings=settings, tls=tls, is_exposed=expose
        ) as server,
        override_signals(lambda *_: server.stop(), *TERMINATION_SIGNALS),
    ):
        out.print(f"ready: {server.link}")
        out.print("The link signs one browser in, once; press Ctrl-C to stop.")
        bus.via = "http"
        server.run()


def _folder(option: str, folder: Path | None) -> Path | None:
    """Return a folder of the user's as an absolute path; `InvalidConfig` if it is none."""
    if folder is not None and not folder.is_dir():
        raise InvalidConfig(f"{option} {folder}: there is no such folder")
    return None if folder is None else folder.resolve()


def _tls(keys: Path | None, certificate: Path | None, key: Path | None, *, expose: bool) -> PageTls | None:
    """Return the TLS of the page; None without.

    Raises:
        InvalidConfig: options that need others.
    """
    from zenostat.views.room.users import PageTls

    if certificate is None or keys is None:
        if expose or certificate is not None:
            raise InvalidConfig(
                "--expose needs --page-certificate FILE.pem, and both need --keys FOLDER with the names of users; "
                "create a certificate with: zenostat keys add room --role node --host THIS.MACHINE"
            )
        if key is not None:
            raise InvalidConfig("--page-key needs --page-certificate FILE.pem")
        return None
    return PageTls(certificate, key or certificate.with_suffix(".key"), keys)
