"""Imports of optional dependencies: the one place that names the extra to install."""

from __future__ import annotations

import importlib
import importlib.metadata
import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import unquote, urlsplit

from zenostat.topics.errors import MissingExtra


def install_command(extra: str) -> str:
    """Return the command that installs an extra into this Python's environment, from where Zenostat came from.

    That is a checkout, a folder or a file that pip has recorded (PEP 610), or else a package index.
    """
    origin = _origin()
    folder = unquote(urlsplit(origin.get("url", "")).path)
    if origin.get("dir_info", {}).get("editable"):
        requirement = f"-e '{folder}[{extra}]'"
    elif origin:
        requirement = f"'zenostat[{extra}] @ {origin['url']}'"
    else:
        requirement = f"'zenostat[{extra}]'"
    return f"{sys.executable} -m pip install {requirement}"


def _origin() -> dict[str, Any]:
    """Return the `direct_url.json` that pip wrote when it installed Zenostat; empty if it came from an index."""
    for distribution in importlib.metadata.distributions(name="zenostat"):
        if text := distribution.read_text("direct_url.json"):
            origin: dict[str, Any] = json.loads(text)
            return origin
    return {}


@contextmanager
def requires_extra(extra: str, feature: str, library: str) -> Iterator[None]:
    """Report a failed import of optional modules in the body of a `with` statement.

    Args:
        extra: the extra that installs them.
        feature: the feature that needs them, for the error.
        library: the name by which users know the library, for the error.

    Raises:
        MissingExtra: a module cannot be imported; the text has the reason and the command that installs the extra.
    """
    try:
        yield
    except ImportError as error:
        raise MissingExtra(f"{feature} needs {library} ({error}): {install_command(extra)}") from None


def import_extra(module: str, extra: str, feature: str) -> Any:
    """Import and return one optional module by its name; arguments and errors as of `requires_extra`."""
    with requires_extra(extra, feature, module):
        return importlib.import_module(module)
