"""Report why a command failed: one sentence, and the frames of the user's own code if that code raised."""

from __future__ import annotations

import errno
import os
import traceback

from zenostat.bridge.runtime.exhaustion import describe_exhaustion
from zenostat.bridge.runtime.user_code import describe_user_error, user_frames
from zenostat.cli.console import err, print_error
from zenostat.topics.errors import UsageError, ZenostatError

_DISK_ERRORS = (
    errno.EACCES, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.ENAMETOOLONG, errno.ENOSPC, errno.EPERM, errno.EROFS,
)  # fmt: skip


def print_failure(error: Exception) -> int:
    """Print the error that ended a command, and return the exit code; a full disk or memory is one sentence.

    Raises:
        Exception: the error itself, if it is not a `ZenostatError` and the user's code did not raise it.
    """
    frames = user_frames(error)
    if frames:
        err.print("Traceback (most recent call last):")
        err.print("".join(traceback.format_list(frames)).rstrip())
    if isinstance(error, ZenostatError):
        print_error(str(error))
        return 2 if isinstance(error, UsageError) else 1
    if (text := describe_exhaustion(error) or _describe_disk_error(error)) is not None:
        print_error(text)
        return 1
    if not frames:
        raise error
    print_error(describe_user_error(error))
    return 1


def _describe_disk_error(error: BaseException) -> str | None:
    """Return a sentence about a file that cannot be written or read; None if the error has another cause."""
    if isinstance(error, FileNotFoundError) and _is_working_directory_gone():
        return "the working directory has been removed; change to another one"
    if not isinstance(error, OSError) or error.errno not in _DISK_ERRORS:
        return None
    where = f"{error.filename}: " if error.filename is not None else ""
    return f"{where}{os.strerror(error.errno)}"


def _is_working_directory_gone() -> bool:
    try:
        os.getcwd()
    except FileNotFoundError:
        return True
    return False
