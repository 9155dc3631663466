"""Scratch folders that do not outlive their owners.

A folder is owned by whoever holds a lock on a file in it. The system releases the lock when the owner ends, in
whatever way, so the next program that starts finds what a killed one has left.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
import time
from contextlib import suppress
from pathlib import Path

_PREFIX = "zenostat-"
_LOCK = ".owner"
_TRIES, _TRY_AGAIN_S = 20, 0.01


class Scratch:
    """A scratch folder that this process owns, alone or with others.

    Args:
        folder: one that is there, or is made; None makes one in the place of temporary files.
        parent: where it is made then; None is the usual place.

    Attributes:
        folder: that one.
    """

    def __init__(self, folder: Path | None = None, *, parent: str | None = None) -> None:
        if folder is None:
            folder = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=parent))
        else:
            folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self._lock = _locked(folder)

    def release(self) -> None:
        """Does not own the folder any more; twice is fine."""
        lock, self._lock = self._lock, -1
        if lock >= 0:
            os.close(lock)

    def remove(self) -> None:
        """Removes the folder; twice is fine."""
        for _ in range(_TRIES):  # a process that was killed may write a last time
            shutil.rmtree(self.folder, ignore_errors=True)
            if not self.folder.exists():
                break
            time.sleep(_TRY_AGAIN_S)
        self.release()


def sweep() -> None:
    """Removes the scratch folders whose owners have ended."""
    for place in {tempfile.gettempdir(), "/tmp"}:  # where folders go if the usual path is too long
        with suppress(OSError):
            for folder in Path(place).glob(f"{_PREFIX}*"):
                _sweep(folder)


def _sweep(folder: Path) -> None:
    try:
        if folder.lstat().st_uid != os.getuid():
            return
        lock = os.open(folder / _LOCK, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError:
        return  # another's, or nobody's whose end could be known
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        shutil.rmtree(folder, ignore_errors=True)
    except OSError:
        pass  # its owner lives
    finally:
        os.close(lock)


def _locked(folder: Path) -> int:
    """A descriptor that holds the folder's lock together with whoever else owns it."""
    path = folder / _LOCK
    try:
        lock = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
    except FileNotFoundError:
        # Locked before it has its name: it is never seen without a lock.
        unnamed = folder / f"{_LOCK}-{os.getpid()}"
        lock = os.open(unnamed, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
        fcntl.flock(lock, fcntl.LOCK_SH)
        unnamed.rename(path)
    else:
        fcntl.flock(lock, fcntl.LOCK_SH)
    return lock
