"""Cache of derived files under keys of content: created once, read by any number of processes.

The first line of a cached file has the digest of its name and content. A file that does not match its digest
(truncated, empty, swapped, a folder in its place) is created again, with a one-line notice on standard error.
"""

from __future__ import annotations

import errno
import hashlib
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from platformdirs import user_cache_dir

from zenostat.topics.errors import InvalidConfig

_FILLING = ".filling-"
_MAKING = ".making-"
_ABANDONED_S = 86_400.0
"""Age of a temporary folder whose file nobody makes any more."""
_FILES = "v2"
"""Folder of the cached files; change it when their format changes."""

_LOCK_MODE = 0o666
"""Every user of a shared cache may take its lock."""

_MAGIC = b"zenostat-cache "
_DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)


def cache_dir() -> Path:
    """Return the cache folder: `$ZENOSTAT_CACHE`, else `$XDG_CACHE_HOME/zenostat`, else `~/.cache/zenostat`.

    Raises:
        InvalidConfig: there is no home folder, and neither variable is set.
    """
    if named := os.environ.get("ZENOSTAT_CACHE"):
        return Path(named)
    try:
        path = user_cache_dir("zenostat")
    except RuntimeError:
        path = "~"
    if path.startswith("~"):  # what earlier releases of platformdirs return where there is no home folder
        raise InvalidConfig("there is no home folder for the cache; set ZENOSTAT_CACHE to a folder")
    return Path(path)


def digest(*parts: bytes | str) -> str:
    """Return a key of content, 24 hexadecimal digits."""
    return _sha256(*parts)[:24]


def _sha256(*parts: bytes | str) -> str:
    total = hashlib.sha256()
    for part in parts:
        raw = part.encode() if isinstance(part, str) else part
        total.update(len(raw).to_bytes(8, "little") + raw)
    return total.hexdigest()


def cached_bytes(name: str, make: Callable[[Path], None]) -> bytes:
    """Return the content of the cached file `name`, created by `make(path)` if it is missing or damaged.

    `make` works in a temporary folder and the file is then moved into place atomically, so two processes may create
    the same file at once. What a killed process left is removed a day later.

    Raises:
        InvalidConfig: the cache cannot be written; the text names `ZENOSTAT_CACHE`.
    """
    target = cache_dir() / _FILES / name
    damage = ""
    try:
        content = _verified(target, name)
        if content is not None:
            return content
        damage = "its content does not match its digest"
    except FileNotFoundError:
        pass
    except OSError as error:
        damage = error.strerror or str(error)
    with _as_cache_errors():
        target.parent.mkdir(parents=True, exist_ok=True)
        for left in target.parent.glob(f"{_MAKING}*"):
            with suppress(FileNotFoundError):  # its own process has just removed it
                if left.stat().st_mtime < time.time() - _ABANDONED_S:
                    shutil.rmtree(left, ignore_errors=True)
        scratch = Path(tempfile.mkdtemp(prefix=_MAKING, dir=target.parent))
    if damage:
        _notice(target, damage)
    try:
        product = scratch / target.name
        with _as_cache_errors(_DISK_ERRORS):
            make(product)
        with _as_cache_errors():
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
    """Return the content of a cached file; None if it is damaged."""
    head, _, content = target.read_bytes().partition(b"\n")
    return content if head + b"\n" == _head(name, content) else None


def _notice(target: Path, reason: str) -> None:
    sys.stderr.write(f"zenostat: the cached {target} is damaged ({reason}); it is created again\n")


def _clear(target: Path) -> None:
    """Remove a folder at `target`, which a file cannot replace."""
    if target.is_dir() and not target.is_symlink():
        shutil.rmtree(target)


@contextmanager
def _as_cache_errors(numbers: tuple[int, ...] | None = None) -> Iterator[None]:
    """Raise file system errors (only those in `numbers`, if given) as errors of the cache."""
    try:
        yield
    except OSError as error:
        if numbers is not None and error.errno not in numbers:
            raise
        reason = error.strerror or str(error)
        raise InvalidConfig(
            f"cannot write the cache {cache_dir()}: {reason}; set ZENOSTAT_CACHE to a writable folder"
        ) from None


def find_dir(name: str) -> Path | None:
    """Return the cached folder `name`; None if there is none.

    Raises:
        InvalidConfig: the cache cannot be read.
    """
    target = cache_dir() / name
    try:
        return target if target.is_dir() else None
    except OSError as error:
        raise InvalidConfig(
            f"cannot read the cache {cache_dir()}: {error.strerror}; set ZENOSTAT_CACHE to another folder"
        ) from None


def cached_dir(name: str, make: Callable[[Path], None]) -> Path:
    """Return the cached folder `name`, filled by `make(path)` if it is missing.

    An existing folder is complete. One process fills a folder at a time; a second one waits and uses the result. The
    next one removes the temporary folders of a killed process.

    Raises:
        InvalidConfig: the cache cannot be written; the text names `ZENOSTAT_CACHE`.
    """
    target = cache_dir() / name
    if find_dir(name):
        return target
    with _as_cache_errors(), _locked(target.parent) as folder:
        if not target.is_dir():
            if target.exists():
                _notice(target, "it is not a folder")
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


def evict(name: str) -> bool:
    """Remove the cached folder `name`, atomically for readers; False if there is none."""
    target = cache_dir() / name
    if find_dir(name) is None:
        return False
    with _as_cache_errors(), _locked(target.parent) as folder:
        scratch = Path(tempfile.mkdtemp(prefix=_FILLING, dir=folder))
        try:
            target.rename(scratch / target.name)
        except FileNotFoundError:  # another process removed it first
            return False
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
    return True


@contextmanager
def _locked(folder: Path) -> Iterator[Path]:
    """Create `folder` and lock it between processes; remove what a killed process left in it.

    The kernel releases the lock of a killed process. The lock file is next to the folder and is not deleted.
    """
    from filelock import FileLock  # not at the top: it registers fork hooks, and a node forks without ever using it

    folder.mkdir(parents=True, exist_ok=True)
    with FileLock(f"{folder}.lock", mode=_LOCK_MODE):
        for abandoned in folder.glob(f"{_FILLING}*"):
            shutil.rmtree(abandoned, ignore_errors=True)
        yield folder
