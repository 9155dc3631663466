"""Messages to bytes and back: msgpack maps, with the message's class and version in the encoding.

A payload whose encoding names another class or version is refused by name; one that names none (a
stranger that speaks msgpack alone) is checked like any other.
"""

from __future__ import annotations

import itertools
import reprlib
from collections.abc import Iterable
from functools import cache
from typing import Any, TypeVar

import msgpack
import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from topics.errors import BadMessage, did_you_mean
from topics.messages import SCHEMA_VERSION, Batch, Claim, Manifest, Message, Sample, Status

M = TypeVar("M", bound=Message)

MAX_BYTES = 8 * 1024 * 1024
"""Larger payloads are refused unread."""

MAX_ENTRIES = 4_000
"""Entries of all lists and maps of a message together; more are refused before they are looked at."""

MAX_ITEMS = {Batch: 100_000, Claim: 20_000, Manifest: 1_000_000, Sample: 100_000, Status: 100_000}
"""The same, of messages that name points, and of a node's for many slots."""

_MAX_ERRORS = 10
FLOAT = np.dtype("<f8")
INDEX = np.dtype("<u2")
_MEDIA = "application/msgpack"
_SCHEMA_MARK = ";zenostat/"
_UNNAMED = frozenset(("", "zenoh/bytes", "application/octet-stream", _MEDIA, "application/x-msgpack"))
"""Encodings that say nothing of the class: what Zenoh's libraries send unasked, and msgpack as such."""


@cache
def encoding(message: type[Message]) -> str:
    """The encoding of a message class: `application/msgpack;zenostat/2.Sample`."""
    return f"{_MEDIA}{_SCHEMA_MARK}{SCHEMA_VERSION}.{message.__name__}"


def encoding_matches(message: type[Message], said: str) -> bool:
    """Whether the encoding `said` is that of a message class and of this version, or names none."""
    return said == encoding(message) or said in _UNNAMED


def _plain(value: Any) -> Any:
    if isinstance(value, Message):
        return value.__dict__
    raise TypeError(f"{type(value).__name__} does not travel")


def encode(message: Message) -> bytes:
    """The payload of a message: one msgpack map of its fields."""
    packed: bytes = msgpack.packb(message.__dict__, default=_plain)
    return packed


_packer = msgpack.Packer()  # one for all: of plain values it packs in one go, whichever thread asks


def pack(**fields: Any) -> bytes:
    """The payload of a message whose fields the caller knows to be right: the hot path's `encode`."""
    packed: bytes = _packer.pack(fields)
    return packed


def command_head(episode: list[int], step: list[int], size: int) -> bytes:
    """How a `Command` without `operations` and with `size` bytes of values begins; the values follow."""
    blank = bytes(size)
    return pack(episode=episode, step=step, operations=None, values=blank)[: -size or None]


def decode(message: type[M], payload: bytes, said: str = "") -> M:
    """The message in `payload`; `said` is the encoding that came with it.

    Raises:
        BadMessage: what was wrong, with the path of the bad value.
    """
    if not encoding_matches(message, said):
        raise BadMessage(f"expected encoding {encoding(message)!r}, got {said!r}")
    if len(payload) > MAX_BYTES:
        raise BadMessage(f"{len(payload)} bytes; a {message.__name__} has at most {MAX_BYTES}")
    try:
        fields = _unpacked(payload, MAX_ITEMS.get(message, MAX_ENTRIES))
    except Exception as error:  # msgpack raises a dozen unrelated classes on malformed input
        raise BadMessage(f"not msgpack: {type(error).__name__} {error}".rstrip()) from None
    if not isinstance(fields, dict):
        raise BadMessage(f"a {message.__name__} is a map of its fields, got {type(fields).__name__}")
    try:
        return message.__pydantic_validator__.validate_python(fields)  # type: ignore[no-any-return]
    except ValidationError as error:
        raise BadMessage(f"{message.__name__}: {describe_validation_errors(error)}") from None


def text_field(payload: bytes, name: str, most: int) -> str:
    """One text of a map, whatever else is wrong with it: its first `most` characters; empty if it cannot be read."""
    if len(payload) > MAX_BYTES:
        return ""
    try:
        fields = _unpacked(payload, MAX_ENTRIES)
    except Exception:  # msgpack raises a dozen unrelated classes on malformed input
        return ""
    text = fields.get(name) if isinstance(fields, dict) else None
    return text[:most] if isinstance(text, str) else ""


def _unpacked(payload: bytes, most: int) -> Any:
    if len(payload) <= most:  # an entry has a byte at least
        return msgpack.unpackb(payload)
    entries = 0

    def count(gathered: Any) -> Any:
        nonlocal entries
        entries += len(gathered)
        if entries > most:
            raise ValueError(f"its lists and maps have more than {most} entries")
        return gathered

    return msgpack.unpackb(payload, max_array_len=most, max_map_len=most, list_hook=count, object_hook=count)


def describe_validation_errors(error: ValidationError, known: Iterable[str] = ()) -> str:
    """The faults that pydantic found, in one line: path, what came, what would be right; of very many the first.

    `known`: names of the fields at the top, of which near ones are told.
    """
    faults = []
    found = error.errors(include_url=False)
    for fault in found[:_MAX_ERRORS]:
        loc = [str(part) for part in fault["loc"] if not str(part).startswith("@")]
        path = _cut(".".join(loc)) or "(whole)"
        if fault["type"] == "missing":
            faults.append(f"{path}: it is missing")
        elif fault["type"] == "extra_forbidden":
            faults.append(
                f"{path}: there is no such field"
                + (f"; {did_you_mean(loc[0], known)}" if len(loc) == 1 and known else "")
            )
        else:
            faults.append(f"{path}: {fault['msg'].removeprefix('Value error, ')}, got {_short(fault['input'])}")
    more = len(found) - len(faults)
    return "; ".join(faults) + (f"; and {more} more" if more else "")


class _Repr(reprlib.Repr):
    """`repr` of the begin of a value: a nested one may stand for more than fits into memory."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel = 6
        self.maxlist = self.maxtuple = self.maxset = self.maxdict = 20
        self.maxstring = self.maxlong = self.maxother = 400

    def repr_dict(self, x: Any, level: int) -> str:
        """A mapping in its own order."""
        shown = dict(itertools.islice(x.items(), self.maxdict))
        if level <= 0:
            return "{...}" if shown else "{}"
        return (
            "{" + ", ".join(f"{self.repr1(k, level - 1)}: {self.repr1(v, level - 1)}" for k, v in shown.items()) + "}"
        )


_repr = _Repr()


def _short(value: Any, most: int = 60) -> str:
    return _cut(_repr.repr(value), most)


def _cut(text: str, most: int = 200) -> str:
    return text if len(text) <= most else text[: most - 1] + "…"


def floats(raw: bytes, shape: tuple[int, ...], what: str) -> NDArray[np.float64]:
    """A read-only float64 array over `raw`, or `BadMessage` if the size is not that of `shape`."""
    return _array(raw, FLOAT, shape, what)


def row(raw: bytes, index: int, rows: int, width: int, what: str) -> NDArray[np.float64]:
    """One row of `floats(raw, (rows, width), what)`, without making the others."""
    if len(raw) != 8 * rows * width:
        floats(raw, (rows, width), what)
    return np.frombuffer(raw, FLOAT, width, 8 * width * index)


def uint8s(raw: bytes, shape: tuple[int, ...], what: str) -> NDArray[np.uint8]:
    """A read-only uint8 array over `raw`, or `BadMessage` if the size is not that of `shape`."""
    return _array(raw, np.dtype("u1"), shape, what)


def indices(raw: bytes, shape: tuple[int, ...], what: str) -> NDArray[np.uint16]:
    """A read-only uint16 array over `raw`, or `BadMessage` if the size is not that of `shape`."""
    return _array(raw, INDEX, shape, what)


def _array(raw: bytes, kind: np.dtype[Any], shape: tuple[int, ...], what: str) -> NDArray[Any]:
    array = np.frombuffer(raw, kind) if len(raw) % kind.itemsize == 0 else None
    expected = 1
    for length in shape:
        expected *= length
    if array is None or array.size != expected:
        raise BadMessage(
            f"{what} has {len(raw)} bytes; {expected * kind.itemsize} expected: "
            f"{' x '.join(map(str, shape))} of {kind.name}"
        )
    return array.reshape(shape)
