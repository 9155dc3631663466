"""Files made from other files, kept under a key of content: made once, read by any number of processes."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path


def store() -> Path:
    """`$ZENOSTAT_CACHE`, else `$XDG_CACHE_HOME/zenostat`, else `~/.cache/zenostat`."""
    if named := os.environ.get("ZENOSTAT_CACHE"):
        return Path(named)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "zenostat"


def digest(*parts: bytes | str) -> str:
    """A key of content, 24 hexadecimal digits."""
    total = hashlib.sha256()
    for part in parts:
        raw = part.encode() if isinstance(part, str) else part
        total.update(len(raw).to_bytes(8, "little") + raw)
    return total.hexdigest()[:24]


def made(name: str, make: Callable[[Path], None]) -> Path:
    """The stored file `name`, made by `make(path)` if it is not there.

    Each maker works in a folder of its own and the finished file is moved into place in one step, so
    two processes that make the same file at once do not disturb each other.
    """
    target = store() / name
    if target.exists():
        return target
    target.parent.mkdir(parents=True, exist_ok=True)
    scratch = Path(tempfile.mkdtemp(prefix=".making-", dir=target.parent))
    try:
        product = scratch / target.name
        make(product)
        os.replace(product, target)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return target
