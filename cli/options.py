"""Options that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bridge.transport.session import DEFAULT_ENDPOINT

Connect = Annotated[str | None, typer.Option(help="Endpoint of the bus.", show_default=DEFAULT_ENDPOINT)]
Keys = Annotated[Path | None, typer.Option(help="Folder made by `zenostat keys init`: TLS, with rules for each role.")]
CertificateName = Annotated[str | None, typer.Option(help="Certificate of another name than the role's.")]
