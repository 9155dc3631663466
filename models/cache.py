"""Cache of files made from other files, under a key of content: made once, read by any number of processes.

A cached file begins with a line that has the digest of its name and its content. A file that does not fit its digest
(truncated, empty, swapped, a folder in its place) is made again, with one line of notice on standard error.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from topics.errors import InvalidConfig

_FILLING = ".filling-"
_FILES = "v2"
"""Folder of the cached files; another form of them gets another one."""

_MAGIC = b"zenostat-cache "
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)


def store() -> Path:
    """`$ZENOSTAT_CACHE`, else `$XDG_CACHE_HOME/zenostat`, else `~/.cache/zenostat`.

    Raises:
        InvalidConfig: there is no home folder, and neither variable names one.
    """
    if named := os.environ.get("ZENOSTAT_CACHE"):
        return Path(named)
    if base := os.environ.get("XDG_CACHE_HOME"):
        return Path(base) / "zenostat"
    try:
        return Path.home() / ".cache" / "zenostat"
    except RuntimeError:
        raise InvalidConfig("there is no home folder for the cache; name a folder in ZENOSTAT_CACHE") from None


def digest(*parts: bytes | str) -> str:
    """A key of content, 24 hexadecimal digits."""
    return _sha256(*parts)[:24]


def _sha256(*parts: bytes | str) -> str:
    total = hashlib.sha256()
    for part in parts:
        raw = part.encode() if isinstance(part, str) else part
        total.update(len(raw).to_bytes(8, "little") + raw)
    return total.hexdigest()


def cached_bytes(name: str, make: Callable[[Path], None]) -> bytes:
    """Return the content of the cached file `name`, made by `make(path)` if it is not there or damaged.

    Each maker works in a folder of its own and the finished file is moved into place in one step, so
    two processes that make the same file at once do not disturb each other.

    Raises:
        InvalidConfig: the cache cannot be written; the text names `ZENOSTAT_CACHE`.
    """
    target = store() / _FILES / name
    content = _verified(target, name)
    if content is not None:
        return content
    with _errors_named():
        target.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=".making-", dir=target.parent))
    try:
        product = scratch / target.name
        with _errors_named(_NO_ROOM):
            make(product)
        with _errors_named():
            content = product.read_bytes()
            product.write_bytes(_head(name, content) + content)
            _clear(target)
            os.replace(product, target)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return content


def _head(name: str, content: bytes) -> bytes:
    return _MAGIC + _sha256(name, content).encode() + b"\n"


def _verified(target: Path, name: str) -> bytes | None:
    """Content of a cached file; None if there is none, or a damaged one (with a notice)."""
    try:
        head, _, content = target.read_bytes().partition(b"\n")
    except FileNotFoundError:
        return None
    except OSError as error:
        _notice(target, error.strerror or str(error))
        return None
    if head + b"\n" == _head(name, content):
        return content
    _notice(target, "its content does not fit its digest")
    return None


def _notice(target: Path, why: str) -> None:
    sys.stderr.write(f"zenostat: the cached {target} is damaged ({why}); it is made again\n")


def _clear(target: Path) -> None:
    """Removes what is in the place of a file and cannot be replaced by one."""
    if target.is_dir() and not target.is_symlink():
        shutil.rmtree(target)


@contextmanager
def _errors_named(numbers: tuple[int, ...] | None = None) -> Iterator[None]:
    """Tells an error of the file system (one of `numbers` if given) as one of the cache."""
    try:
        yield
    except OSError as error:
        if numbers is not None and error.errno not in numbers:
            raise
        why = error.strerror or str(error)
        raise InvalidConfig(
            f"cannot write the cache {store()}: {why}; name a folder that can be written in ZENOSTAT_CACHE"
        ) from None


def stored_folder(name: str) -> Path | None:
    """Return the stored folder `name`; None if there is none.

    Raises:
        InvalidConfig: the cache cannot be read.
    """
    target = store() / name
    try:
        return target if target.is_dir() else None
    except OSError as error:
        raise InvalidConfig(
            f"cannot read the cache {store()}: {error.strerror}; name another folder in ZENOSTAT_CACHE"
        ) from None


def made_folder(name: str, make: Callable[[Path], None]) -> Path:
    """The stored folder `name`, filled by `make(path)` if it is not there.

    A folder that is there is whole. One maker works at a time; a second waits and finds it made. What a
    killed maker left is swept away by the next.

    Raises:
        InvalidConfig: the cache cannot be written; the text names `ZENOSTAT_CACHE`.
    """
    target = store() / name
    if stored_folder(name):
        return target
    with _errors_named(), _alone(target.parent) as folder:
        if not target.is_dir():
            if target.exists():
                _notice(target, "it is no folder")
                target.unlink()
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
    if stored_folder(name) is None:
        return False
    with _errors_named(), _alone(target.parent) as folder:
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
