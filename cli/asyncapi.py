"""`zenostat asyncapi`: the bus contract, for programs in other languages."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from zenostat.topics.atomic_file import check_writable


def asyncapi(
    output: Annotated[Path | None, typer.Option(help="Write to this file instead of standard output.")] = None,
) -> None:
    """Print the bus contract as an AsyncAPI 3.0 document (YAML).

    Example: `zenostat asyncapi --output asyncapi.yaml`
    """
    from zenostat.topics.asyncapi import document
    from zenostat.topics.yaml12 import dump

    text = dump(document())
    if output is None:
        sys.stdout.write(text)
        return
    check_writable(output, f"--output {output}")
    output.write_text(text, encoding="utf-8")
