"""The part of an error that lies in the user's own code."""

from __future__ import annotations

import sys
import sysconfig
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from zenostat.bridge.runtime.signals import Terminated
from zenostat.topics.errors import InvalidConfig

_PACKAGE = sys.modules[__name__.partition(".")[0]]
_NOT_USER_CODE = (Path(str(_PACKAGE.__file__)).parent, Path(sysconfig.get_path("stdlib")))


def user_frames(error: BaseException) -> list[traceback.FrameSummary]:
    """Return the frames of the user's code: not Zenostat, the standard library or an installed package."""
    return [frame for frame in traceback.extract_tb(error.__traceback__) if _is_user_code(frame.filename)]


def describe_user_error(error: BaseException) -> str:
    """Describe an error with the file and the line of the user's code that raised it, if any did."""
    frames = user_frames(error)
    place = f"{Path(frames[-1].filename).name}, line {frames[-1].lineno}: " if frames else ""
    return f"{place}{type(error).__name__}: {error}"


@contextmanager
def refuse_exit(what: str) -> Iterator[None]:
    """Report a `SystemExit` of the user's code, as of argparse, as an error; a signal ends the program all the same.

    Raises:
        InvalidConfig: the code ended the program.
    """
    try:
        yield
    except Terminated:
        raise
    except SystemExit as error:
        raise InvalidConfig(f"{what} ended the program: {describe_user_error(error)}") from error


def _is_user_code(filename: str) -> bool:
    path = Path(filename)
    if filename.startswith("<") or "site-packages" in path.parts or "dist-packages" in path.parts:
        return False
    return not any(path.absolute().is_relative_to(folder) for folder in _NOT_USER_CODE) and path.suffix == ".py"
