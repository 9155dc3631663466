"""The file of a recording: its path, and exclusive access to it."""

from __future__ import annotations

import errno
import fcntl
import hashlib
import importlib
import itertools
import os
import stat
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from zenostat.topics.errors import InvalidConfig, InvalidRecording
from zenostat.topics.extras import requires_extra
from zenostat.topics.recording import SUFFIX

MAGIC = b"\x89MCAP0\r\n"


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file's content, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_library() -> None:
    """Raise `InvalidConfig` if the libraries that write recordings are not installed."""
    with requires_extra("recording", "a recording", "mcap and zstandard"):
        importlib.import_module("zenostat.bridge.recording.chunk_writer")


def recording_path(record: Path, node: str) -> Path:
    """Return the file for a node's recording.

    Args:
        record: a file, or a folder (any path without a suffix), in which each run has a file of its own, named after
            node, time and process.
        node: the node's name.

    Raises:
        InvalidConfig: a file with another suffix.
    """
    if record.suffix == SUFFIX and not record.is_dir():
        return record.absolute()
    if record.suffix and not record.is_dir():
        raise InvalidConfig(f"record={record}: expected a file with the suffix {SUFFIX}, or a folder")
    stem = f"{node}-{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{os.getpid()}"
    names = [f"{stem}{SUFFIX}", *(f"{stem}-{number}{SUFFIX}" for number in range(2, 1000))]
    return next(path for name in names if not (path := record.absolute() / name).exists())


def next_recording(record: Path) -> Path:
    """Return the file for the recording of a node that follows another one: `run-2.mcap` after `run.mcap`.

    A folder is returned as it is, since each run has a file of its own in it.
    """
    if record.suffix != SUFFIX or record.is_dir():
        return record
    numbered = (record.with_stem(f"{record.stem}-{number}") for number in itertools.count(2))
    return next(path for path in numbered if not path.exists())


def check_path(path: Path, *, overwrite: bool = False) -> None:
    """Raise `InvalidConfig` if a recording must not or cannot replace what is at `path`; nothing is created or written.

    Args:
        path: of the file.
        overwrite: a recording that no other program is writing to may be replaced.
    """
    _check_regular(path)
    if overwrite and os.path.exists(path):
        os.close(_open_replaceable(path))
    elif not overwrite and os.path.lexists(path):
        raise InvalidConfig(_exists(path))


def open_regular(path: Path, flags: int) -> int:
    """Open a regular file and return its descriptor; never waits, as opening a pipe does.

    Raises:
        InvalidConfig: `path` is a folder, a pipe, a device or a socket.
        OSError: it cannot be opened.
    """
    _check_regular(path)  # opening a device may act on it
    descriptor = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC, 0o644)
    if (kind := _other_kind(os.fstat(descriptor).st_mode)) is not None:
        os.close(descriptor)
        raise InvalidConfig(_not_a_file(path, kind))
    return descriptor


def _check_regular(path: Path) -> None:
    try:
        mode = path.stat().st_mode
    except OSError:
        return
    if (kind := _other_kind(mode)) is not None:
        raise InvalidConfig(_not_a_file(path, kind))


def _other_kind(mode: int) -> str | None:
    """Return what a path that is not a regular file is."""
    if stat.S_ISREG(mode):
        return None
    kinds = ((stat.S_ISDIR, "folder"), (stat.S_ISFIFO, "pipe"), (stat.S_ISSOCK, "socket"))
    return next((kind for is_kind, kind in kinds if is_kind(mode)), "device")


def _not_a_file(path: Path, kind: str) -> str:
    hint = "name a file in it" if kind == "folder" else "a recording is a regular file; choose another name"
    return f"{path} is a {kind}; {hint}"


def open_recording(path: Path, *, overwrite: bool = False) -> int:
    """Create the file of a recording and lock it; return its descriptor, whose end releases the lock.

    Raises:
        InvalidConfig: the file exists (with `overwrite`: and is not a recording), another program is recording to it,
            it is no regular file, or it cannot be created.
    """
    return _open_replaceable(path, os.O_CREAT | (0 if overwrite else os.O_EXCL))


def _open_replaceable(path: Path, creation: int = 0) -> int:
    """Open and lock an empty file or a recording; return its descriptor. Errors are those of `open_recording`.

    Args:
        path: of the file.
        creation: flags with which it is created, and emptied; without them, it is left as it is.
    """
    try:
        if creation:
            _create_folder(path.parent)
        descriptor = open_regular(path, os.O_RDWR | creation)
    except FileExistsError:
        raise InvalidConfig(_exists(path)) from None
    except OSError as error:
        raise InvalidConfig(f"cannot record to {path}: {error.strerror}") from None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if (head := os.pread(descriptor, len(MAGIC), 0)) not in (b"", MAGIC):
            raise InvalidConfig(f"{path} exists and is not a recording (it begins with {head!r}); choose another name")
        if creation:
            os.ftruncate(descriptor, 0)
    except OSError as error:
        os.close(descriptor)
        if isinstance(error, BlockingIOError):
            raise InvalidConfig(f"another node is recording to {path}; choose another name") from None
        raise InvalidConfig(f"cannot record to {path}: {error.strerror}") from None
    except InvalidConfig:
        os.close(descriptor)
        raise
    return descriptor


def open_written(path: Path) -> int:
    """Open the file of a recording to go on with it, and lock it; return its descriptor, whose end releases the lock.

    Raises:
        InvalidRecording: there is no such file, it cannot be written, or another program is recording to it.
    """
    try:
        descriptor = open_regular(path, os.O_RDWR)
    except OSError as error:
        raise InvalidRecording(f"cannot go on with {path}: {error.strerror}") from None
    except InvalidConfig as error:
        raise InvalidRecording(f"cannot go on with {error}") from None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise InvalidRecording(f"another node is recording to {path}; stop it first") from None
    return descriptor


def _create_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise NotADirectoryError(errno.ENOTDIR, f"{folder} is not a folder") from None


def _exists(path: Path) -> str:
    try:
        descriptor = open_regular(path, os.O_RDONLY)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        finally:
            os.close(descriptor)
    except BlockingIOError:
        return f"another node is recording to {path}; choose another name"
    except (OSError, InvalidConfig):
        pass
    return (
        f"{path} exists; choose another name, or a folder, in which each run has a file of its own "
        "(--overwrite of `zenostat node` and `zenostat record`, and Bus.record(..., overwrite=True), replace it)"
    )


def recorded_digests(provenance: Mapping[str, Any]) -> dict[str, str]:
    """Return the digests of the files of a recorded provenance, which may be anybody's, by their roles."""
    files = provenance.get("files")
    if not isinstance(files, dict):
        return {}
    return {str(role): str(entry.get("sha256")) for role, entry in files.items() if isinstance(entry, dict)}


def changed_files(
    recording: Path,
    recorded: Mapping[str, str],
    present: Mapping[str, Path],
    changes: Sequence[str] = (),
    *,
    exact: bool,
    missing: Callable[[str], str],
) -> list[str]:
    """Return a text for each file whose content is not the recorded one, after `changes`.

    Args:
        recording: path of the recording.
        recorded: digests by the files' roles.
        present: files by their roles.
        changes: further texts.
        exact: raise an error if there is any text.
        missing: returns the text for a role that has no file.

    Raises:
        InvalidRecording: `exact`, and a file is not the recorded one.
    """
    texts = [*changes]
    for role in dict.fromkeys((*recorded, *present)):
        if role not in present:
            texts.append(missing(role))
        elif role not in recorded:
            texts.append(f"the recording has no digest of the {role} {present[role]}")
        elif file_digest(present[role]) != recorded[role]:
            texts.append(f"the {role} {present[role]} has changed")
    if texts and exact:
        raise InvalidRecording(
            f"{recording} cannot be verified to the bit: {'; '.join(texts)}; a tolerance compares it nevertheless"
        )
    return texts
