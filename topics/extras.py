"""Installation hints for optional dependencies, used in error texts."""

from __future__ import annotations

import sys
from pathlib import Path

_ROOT = Path(__file__).resolve().parent.parent


def install_command(extra: str) -> str:
    """Return the command that installs an extra of `pyproject.toml` into this Python's environment.

    Zenostat is on no package index: its extras are installed from a checkout.
    """
    root = str(_ROOT) if (_ROOT / "pyproject.toml").is_file() else "PATH_OF_THE_CHECKOUT"
    return f"{sys.executable} -m pip install -e '{root}[{extra}]'"
