"""Files with a token for programs, readable by their owner alone."""

from __future__ import annotations

import os
import secrets
from pathlib import Path

from zenostat.topics.errors import InvalidConfig

_SHORTEST = 32


def read_token(path: Path, option: str) -> str:
    """Return the token in a file, which is created with a random one if it is missing.

    Args:
        path: the file.
        option: that names it, for errors.

    Raises:
        InvalidConfig: it cannot be read or written, others may read it, or it is too short.
    """
    try:
        with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
            file.write(secrets.token_urlsafe(32) + "\n")
    except FileExistsError:
        pass
    except OSError as error:
        raise InvalidConfig(f"{option} {path}: {error.strerror}") from None
    try:
        if path.stat().st_mode & 0o077:
            raise InvalidConfig(f"{option} {path}: others may read it; chmod 600 {path}")
        token = path.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidConfig(f"{option} {path}: {error}") from None
    if len(token) < _SHORTEST:
        raise InvalidConfig(f"{option} {path}: a token of at least {_SHORTEST} characters expected")
    return token
