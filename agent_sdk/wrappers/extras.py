"""Imports of modules that an extra of the package installs."""

from __future__ import annotations

import importlib
from typing import Any

from topics.errors import InvalidConfig
from topics.extras import install_command


def load(module: str, extra: str, feature: str) -> Any:
    """Import a module.

    Args:
        module: its name.
        extra: the extra that installs it.
        feature: the feature that needs it, for the error.

    Raises:
        InvalidConfig: it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise InvalidConfig(f"{feature} needs {module} ({error}): {install_command(extra)}") from None
