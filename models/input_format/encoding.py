"""Check and decode the bytes of a model file.

EnergyPlus needs UTF-8; an IDF also needs lines that end in LF and no byte-order mark.
"""

from __future__ import annotations

import codecs
import re
from pathlib import Path

from zenostat.topics.errors import InvalidConfig

_MACRO = re.compile(rb"\s*(##[a-zA-Z0-9]+)")
_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def check_encoding(raw: bytes, path: Path) -> None:
    """Check that EnergyPlus can read the characters of an IDF. Comments may have any.

    Raises:
        InvalidConfig: the file is empty, has a byte-order mark, no LF, a NUL, a byte outside comments that is not
            UTF-8, or commands of EpMacro; the text says what to do.
    """
    if not raw.strip():
        raise InvalidConfig(f"{path} is not an IDF: it is empty")
    if _is_utf16(raw):
        raise InvalidConfig(f"{path} is not an IDF in UTF-8 (perhaps it is in UTF-16): save it as UTF-8 without BOM")
    if b"\0" in raw:
        damaged = raw[: raw.index(b"\0")].count(b"\n") + 1
        raise InvalidConfig(f"{path} is not an IDF: line {damaged} has a NUL byte; the file is damaged")
    if raw.startswith(codecs.BOM_UTF8):
        raise InvalidConfig(f"{path} begins with a byte-order mark (BOM): save it as UTF-8 without BOM")
    if raw.lstrip().startswith(b"{"):
        raise InvalidConfig(f"{path} is not an IDF but JSON: name it {path.stem}.epJSON")
    if b"\r" in raw and b"\n" not in raw:
        raise InvalidConfig(f"{path} has lines that end with CR alone: save it with line ends of Unix or Windows")
    for number, line in enumerate(raw.split(b"\n"), 1):
        if macro := _MACRO.match(line):
            command = macro[1].decode("ascii")
            reason = f"{command} is a command of EpMacro, which EnergyPlus's engine does not know"
            raise InvalidConfig(f"{path}, line {number}: {reason}; run EpMacro, and use the file that it writes")
        try:
            line.partition(b"!")[0].decode("utf-8")
        except UnicodeDecodeError as error:
            raise _not_utf8(path, number, line[error.start]) from None


def decode_epjson(raw: bytes, path: Path) -> str:
    """Return the text of an epJSON, which may begin with a byte-order mark, with LF at the end of each line.

    Raises:
        InvalidConfig: a byte is not UTF-8; the text has its line.
    """
    if _is_utf16(raw):
        raise InvalidConfig(f"{path} is not an epJSON in UTF-8 (perhaps it is in UTF-16): save it as UTF-8")
    try:
        return raw.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        number = error.object[: error.start].count(b"\n") + 1
        raise _not_utf8(path, number, error.object[error.start]) from None


def _is_utf16(raw: bytes) -> bool:
    return raw.startswith(_UTF16) or raw.count(b"\0") > len(raw) // 4


def _not_utf8(path: Path, line: int, byte: int) -> InvalidConfig:
    return InvalidConfig(f"{path}, line {line}: the byte 0x{byte:02X} is not UTF-8: save the file as UTF-8")


def decode_idf(raw: bytes) -> str:
    """Return the text of an IDF, with LF at the end of each line.

    Bytes that are not UTF-8 are replaced; if the file has passed `check_encoding`, these are in comments only.
    """
    return raw.decode("utf-8", errors="replace").replace("\r\n", "\n")
