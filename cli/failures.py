"""What a command says when it fails: a sentence, and the frames of the user's own code if it is that that failed."""

from __future__ import annotations

import sysconfig
import traceback
from pathlib import Path

from cli.console import err, say_error
from topics.errors import UsageError, ZenostatError

_ROOT = Path(__file__).resolve().parent.parent
_PACKAGES = ("agent_sdk", "bridge", "cli", "eplus_node", "models", "topics")
_FOREIGN = (*(_ROOT / name for name in _PACKAGES), Path(sysconfig.get_path("stdlib")))


def say_failure(error: Exception) -> int:
    """Print an error that ended a command, and return the exit code.

    Raises:
        Exception: the error itself, if it is neither one of Zenostat's nor of code of the user's.
    """
    own = user_frames(error)
    if own:
        err.print("Traceback (most recent call last):", markup=False)
        err.print("".join(traceback.format_list(own)).rstrip(), markup=False, soft_wrap=True)
    if isinstance(error, ZenostatError):
        say_error(str(error))
        return 2 if isinstance(error, UsageError) else 1
    if not own:
        raise error
    last = own[-1]
    say_error(f"{Path(last.filename).name}, line {last.lineno}: {type(error).__name__}: {error}")
    return 1


def user_frames(error: BaseException) -> list[traceback.FrameSummary]:
    """Return the frames of code that is neither Zenostat's, nor the standard library's, nor an installed library's."""
    return [frame for frame in traceback.extract_tb(error.__traceback__) if _is_users(frame.filename)]


def _is_users(filename: str) -> bool:
    path = Path(filename)
    if filename.startswith("<") or "site-packages" in path.parts or "dist-packages" in path.parts:
        return False
    return not any(path.absolute().is_relative_to(folder) for folder in _FOREIGN) and path.suffix == ".py"
