"""Report why a command failed: one sentence, and the frames of the user's own code if that code raised."""

from __future__ import annotations

import errno
import os
import sysconfig
import traceback
from pathlib import Path

import zenostat
from zenostat.bridge.runtime.exhaustion import describe_exhaustion
from zenostat.cli.console import err, print_error
from zenostat.topics.errors import UsageError, ZenostatError

_DISK_ERRORS = (
    errno.EACCES, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.ENAMETOOLONG, errno.ENOSPC, errno.EPERM, errno.EROFS,
)  # fmt: skip
_NOT_USER_CODE = (Path(zenostat.__file__).parent, Path(sysconfig.get_path("stdlib")))


def print_failure(error: Exception) -> int:
    """Print the error that ended a command, and return the exit code; a full disk or memory is one sentence.

    Raises:
        Exception: the error itself, if it is not a `ZenostatError` and the user's code did not raise it.
    """
    frames = user_frames(error)
    if frames:
        err.print("Traceback (most recent call last):", markup=False)
        err.print("".join(traceback.format_list(frames)).rstrip(), markup=False, soft_wrap=True)
    if isinstance(error, ZenostatError):
        print_error(str(error))
        return 2 if isinstance(error, UsageError) else 1
    if (text := describe_exhaustion(error) or _describe_disk_error(error)) is not None:
        print_error(text)
        return 1
    if not frames:
        raise error
    last = frames[-1]
    print_error(f"{Path(last.filename).name}, line {last.lineno}: {type(error).__name__}: {error}")
    return 1


def _describe_disk_error(error: BaseException) -> str | None:
    """Return a sentence about a file that cannot be written or read; None if the error has another cause."""
    if not isinstance(error, OSError) or error.errno not in _DISK_ERRORS:
        return None
    where = f"{error.filename}: " if error.filename is not None else ""
    return f"{where}{os.strerror(error.errno)}"


def user_frames(error: BaseException) -> list[traceback.FrameSummary]:
    """Return the frames of the user's code: not Zenostat, the standard library or an installed package."""
    return [frame for frame in traceback.extract_tb(error.__traceback__) if _is_user_code(frame.filename)]


def _is_user_code(filename: str) -> bool:
    path = Path(filename)
    if filename.startswith("<") or "site-packages" in path.parts or "dist-packages" in path.parts:
        return False
    return not any(path.absolute().is_relative_to(folder) for folder in _NOT_USER_CODE) and path.suffix == ".py"
