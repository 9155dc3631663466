"""Errors of a file that the user has named: one sentence for each reason."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from stat import S_ISDIR

from zenostat.topics.errors import InvalidConfig, UsageError


@contextmanager
def user_file(
    path: Path, error: type[UsageError] = InvalidConfig, expected: str = "a file", remedy: str = ""
) -> Iterator[None]:
    """Turn the errors of reading a user's file into one sentence.

    Args:
        path: the file.
        error: class of the error to raise.
        expected: what a folder is not, such as "a YAML file".
        remedy: what to do if there is no file.

    Raises:
        UsageError: the file does not exist, is a folder, cannot be read, or is not UTF-8 or not CSV.
    """
    try:
        yield
    except FileNotFoundError:
        raise error(f"there is no file {absolute(path)}" + (f"; {remedy}" if remedy else "")) from None
    except IsADirectoryError:
        raise error(f"{absolute(path)} is a folder; expected {expected}") from None
    except (OSError, RuntimeError, UnicodeDecodeError, csv.Error) as reason:  # RuntimeError: ~name of an unknown user
        raise error(f"cannot read {absolute(path)}: {getattr(reason, 'strerror', None) or reason}") from None


def check_user_file(path: Path, error: type[UsageError] = InvalidConfig, expected: str = "a file") -> None:
    """Check that a user's file exists and is no folder; as `user_file`, before anything reads it."""
    with user_file(path, error, expected):
        if S_ISDIR(path.stat().st_mode):
            raise IsADirectoryError


def absolute(path: Path) -> Path:
    """Return a path as an absolute one.

    Raises:
        InvalidConfig: it is relative, and the working directory no longer exists.
    """
    try:
        return path.absolute()
    except FileNotFoundError:
        raise InvalidConfig(f"{path} is a relative path, and the working directory no longer exists") from None
