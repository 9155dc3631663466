"""Options shared by several commands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bridge.transport.session import DEFAULT_ENDPOINT

Connect = Annotated[str | None, typer.Option(help="Endpoint of the bus.", show_default=DEFAULT_ENDPOINT)]
Keys = Annotated[
    Path | None, typer.Option(help="Folder created by `zenostat keys init`: use TLS, with access rules per role.")
]
CertificateName = Annotated[str | None, typer.Option(help="Certificate name, if it differs from the role's.")]
