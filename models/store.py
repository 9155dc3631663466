"""Files made from other files, kept under a key of content: made once, read by any number of processes."""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

_FILLING = ".filling-"


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


def made_folder(name: str, make: Callable[[Path], None]) -> Path:
    """The stored folder `name`, filled by `make(path)` if it is not there.

    A folder that is there is whole. One maker works at a time; a second waits and finds it made. What a
    killed maker left is swept away by the next.
    """
    target = store() / name
    if target.is_dir():
        return target
    with _alone(target.parent) as folder:
        if not target.is_dir():
            scratch = Path(tempfile.mkdtemp(prefix=_FILLING, dir=folder))
            try:
                product = scratch / target.name
                product.mkdir()
                make(product)
                product.rename(target)
            finally:
                shutil.rmtree(scratch, ignore_errors=True)
    return target


def drop_folder(name: str) -> bool:
    """Removes the stored folder `name`, in one step for whoever looks; False if there is none."""
    target = store() / name
    if not target.is_dir():
        return False
    with _alone(target.parent) as folder:
        scratch = Path(tempfile.mkdtemp(prefix=_FILLING, dir=folder))
        try:
            target.rename(scratch / target.name)
        except FileNotFoundError:  # another process was quicker
            return False
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
    return True


@contextmanager
def _alone(folder: Path) -> Iterator[Path]:
    """`folder`, made and swept, while no other process is in here; the kernel lets go of a killed one's lock."""
    folder.mkdir(parents=True, exist_ok=True)
    lock = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        for left in folder.glob(f"{_FILLING}*"):
            shutil.rmtree(left, ignore_errors=True)
        yield folder
    finally:
        os.close(lock)
