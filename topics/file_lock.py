"""Let one process at a time work on a file or folder."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import filelock

from zenostat.topics.errors import InvalidConfig


@contextmanager
def locked(path: Path, refusal: str, *, wait_s: float = 0.0) -> Iterator[None]:
    """Hold a lock for the time of the context. A lock ends with its process; the lock's file does not stay behind.

    Args:
        path: the lock's own file.
        refusal: message of the error if another process holds the lock.
        wait_s: time to wait for that process.

    Raises:
        InvalidConfig: another process holds the lock, or the file cannot be created.
    """
    lock = filelock.FileLock(path, timeout=wait_s)
    try:
        lock.acquire()
    except filelock.Timeout:
        raise InvalidConfig(refusal) from None
    except OSError as error:
        raise InvalidConfig(f"cannot create {path}: {error.strerror}") from None
    try:
        yield
    finally:
        path.unlink(missing_ok=True)
        lock.release()
