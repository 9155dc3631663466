"""Imports of optional dependencies: the one place that names the extra to install."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from topics.errors import InvalidConfig

_ROOT = Path(__file__).resolve().parent.parent


def install_command(extra: str) -> str:
    """Return the command that installs an extra of `pyproject.toml` into this Python's environment.

    Zenostat is on no package index: its extras are installed from a checkout.
    """
    root = str(_ROOT) if (_ROOT / "pyproject.toml").is_file() else "PATH_OF_THE_CHECKOUT"
    return f"{sys.executable} -m pip install -e '{root}[{extra}]'"


@contextmanager
def requires_extra(extra: str, feature: str, library: str) -> Iterator[None]:
    """Report a failed import of optional modules in the body of a `with` statement.

    Args:
        extra: the extra that installs them.
        feature: the feature that needs them, for the error.
        library: the name by which users know the library, for the error.

    Raises:
        InvalidConfig: a module cannot be imported; the text has the reason and the command that installs the extra.
    """
    try:
        yield
    except ImportError as error:
        raise InvalidConfig(f"{feature} needs {library} ({error}): {install_command(extra)}") from None


def import_extra(module: str, extra: str, feature: str) -> Any:
    """Import and return one optional module by its name; arguments and errors as of `requires_extra`."""
    with requires_extra(extra, feature, module):
        return importlib.import_module(module)
