"""Write a file atomically."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from zenostat.topics.errors import InvalidConfig


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder, whose file replaces `path` on success and is removed on an error.

    Readers see the previous file or the complete new one. The temporary name has the suffix of `path`, from which some
    libraries choose the format. An `OSError` of a write, which has no file's name, or that of the temporary file, gets
    that of `path`.
    """
    temporary = _temporary(path)
    try:
        yield temporary
        temporary.replace(path)
    except OSError as error:
        if error.filename is None or str(error.filename) == str(temporary):
            error.filename = str(path)
        raise
    finally:
        temporary.unlink(missing_ok=True)


def check_writable(path: Path, what: str) -> None:
    """Check that `atomic_file` can write a file, before anything that takes long.

    Raises:
        InvalidConfig: it cannot; the text begins with `what`.
    """
    folder = path.absolute().parent
    if not folder.is_dir():
        raise InvalidConfig(f"{what}: there is no folder {folder}")
    if path.is_dir():
        raise InvalidConfig(f"{what}: expected a file, but this is a folder")
    temporary = _temporary(path)
    try:
        temporary.touch()
        temporary.unlink()
    except OSError as error:
        raise InvalidConfig(f"{what}: no file can be written in {folder}: {error.strerror}") from None


def _temporary(path: Path) -> Path:
    return path.with_name(f".{os.getpid()}.{path.name}")
