"""Modules that come with an extra of the package."""

from __future__ import annotations

import importlib
from typing import Any

from topics.errors import InvalidConfig
from topics.extras import install_command


def load(module: str, extra: str, who: str) -> Any:
    """The module.

    Raises:
        InvalidConfig: it is not installed; the text names the extra.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise InvalidConfig(f"{who} needs {module} ({error}): {install_command(extra)}") from None
