"""Scratch folders that are removed even if their owners are killed.

The owners of a folder hold a shared lock on a file in it. The kernel releases the lock when a process ends for any
reason, so the next program that starts can remove the folders of killed ones.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_PREFIX = "zenostat-"
_LOCK = ".owner"
_ATTEMPTS, _RETRY_S = 20, 0.01


class Scratch:
    """A scratch folder that this process owns, alone or together with other processes.

    Args:
        folder: a folder, which is created if it does not exist; None creates a new temporary folder.
        parent: where a temporary folder is created; None is the default location.

    Attributes:
        folder: its path.
    """

    def __init__(self, folder: Path | None = None, *, parent: str | None = None) -> None:
        if folder is None:
            folder = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=parent))
        else:
            folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self._lock = _locked(folder)

    def release(self) -> None:
        """Give up ownership of the folder; idempotent."""
        lock, self._lock = self._lock, -1
        if lock >= 0:
            os.close(lock)

    def remove(self) -> None:
        """Remove the folder; idempotent."""
        for _ in range(_ATTEMPTS):  # a process that was just killed may still write to it
            shutil.rmtree(self.folder, ignore_errors=True)
            if not self.folder.exists():
                break
            time.sleep(_RETRY_S)
        self.release()


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Yield a new temporary folder, which is removed at the end."""
    scratch = Scratch()
    try:
        yield scratch.folder
    finally:
        scratch.remove()


def sweep() -> None:
    """Remove the scratch folders whose owners have ended."""
    for parent in {tempfile.gettempdir(), "/tmp"}:  # /tmp is used where the default path is too long
        with suppress(OSError):
            for folder in Path(parent).glob(f"{_PREFIX}*"):
                _sweep(folder)


def _sweep(folder: Path) -> None:
    try:
        if folder.lstat().st_uid != os.getuid():
            return
        lock = os.open(folder / _LOCK, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError:
        return  # another user's folder, or one without a lock
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        shutil.rmtree(folder, ignore_errors=True)
    except OSError:
        pass  # an owner is still running
    finally:
        os.close(lock)


def _locked(folder: Path) -> int:
    """Return a file descriptor that has the folder's shared lock."""
    path = folder / _LOCK
    try:
        lock = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
    except FileNotFoundError:
        # Locked before it is renamed, so that `sweep` never finds an owned folder unlocked.
        temporary = folder / f"{_LOCK}-{os.getpid()}"
        lock = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
        fcntl.flock(lock, fcntl.LOCK_SH)
        temporary.rename(path)
    else:
        fcntl.flock(lock, fcntl.LOCK_SH)
    return lock
