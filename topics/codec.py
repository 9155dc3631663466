"""Serialization of messages: msgpack maps, with the message's class and schema version in the Zenoh encoding.

A payload whose encoding names another class or version is rejected. One whose encoding names none (a client that only
uses msgpack) is validated like any other.
"""

from __future__ import annotations

import itertools
import re
import reprlib
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from math import prod
from typing import Any, TypeVar, get_args

import msgpack
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from zenostat.topics.arrays import Floats
from zenostat.topics.errors import BadMessage, InvalidConfig, ZenostatError, did_you_mean
from zenostat.topics.messages import (
    SCHEMA_VERSION,
    Ack,
    AlarmList,
    Batch,
    Claim,
    Geometry,
    Manifest,
    Message,
    PriorityArrays,
    Sample,
    Status,
    Systems,
)
from zenostat.topics.printable import replace_controls

M = TypeVar("M", bound=Message)
V = TypeVar("V", bound=BaseModel)

MAX_BYTES = 8 * 1024 * 1024
"""Largest payload in bytes; larger ones are rejected unread."""

MAX_ENTRIES = 4_000
"""Largest number of entries in all lists and maps of a message; messages with more are rejected before validation."""

MAX_ITEMS = {
    Ack: 100_000,
    AlarmList: 100_000,
    Batch: 100_000,
    Claim: 20_000,
    Geometry: 100_000,
    Manifest: 1_000_000,
    PriorityArrays: 100_000,
    Sample: 100_000,
    Status: 100_000,
    Systems: 1_000_000,
}
"""Larger limits of entries, for messages that list points, zones or many slots."""

_MAX_ERRORS = 10
_RULES = {
    **dict.fromkeys(("tuple_type", "list_type"), "a list expected"),
    "bytes_type": "bytes expected",
    **dict.fromkeys(("dict_type", "model_type", "model_attributes_type"), "a mapping expected"),
}
"""Rules whose text by pydantic names classes of Python."""
_MEMBER = re.compile(r"<\w+\.\w+: ('[^']*')>")
"""A member of an enumeration in pydantic's text, with its value."""
FLOAT = np.dtype("<f8")
INDEX = np.dtype("<u2")
_MEDIA = "application/msgpack"
RELINQUISHED = np.array(np.nan, FLOAT).tobytes()
"""The command of a relinquished actuator."""

_NO_FIELDS = b"\x80"  # an empty map
_SCHEMA_MARK = ";zenostat/"
_UNNAMED = frozenset(("", "zenoh/bytes", "application/octet-stream", _MEDIA, "application/x-msgpack"))
"""Encodings without a message class: Zenoh's default encodings and plain msgpack."""


@cache
def encoding(message: type[Message]) -> str:
    """Return the encoding of a message class: `application/msgpack;zenostat/3.Sample`."""
    return f"{_MEDIA}{_SCHEMA_MARK}{SCHEMA_VERSION}.{message.__name__}"


def encoding_matches(message: type[Message], declared: str) -> bool:
    """Return whether a declared encoding names this message class and schema version, or none."""
    return declared == encoding(message) or declared in _UNNAMED


def _plain(value: Any) -> Any:
    if isinstance(value, Message):
        return value.__dict__
    raise TypeError(f"a {type(value).__name__} cannot be encoded")


def encode(message: Message) -> bytes:
    """Return the payload of a message: one msgpack map of its fields."""
    packed: bytes = msgpack.packb(message.__dict__, default=_plain)
    return packed


_packer = msgpack.Packer()  # shared by all threads: packing of built-in types keeps the GIL


def pack(**fields: Any) -> bytes:
    """Return the payload of a message without validating its fields; `encode` for the hot path."""
    packed: bytes = _packer.pack(fields)
    return packed


class CommandHead:
    """The head of each `Command` of an episode, without `operations`; `size` bytes of values follow it."""

    __slots__ = ("_begin", "_end")

    def __init__(self, episode: list[int], size: int) -> None:
        self._begin: bytes = (
            b"\x84" + _packer.pack("episode") + _packer.pack(episode) + _packer.pack("step")
        )  # 4 fields
        self._end = pack(operations=None, values=bytes(size))[1 : -size or None]

    def at(self, step: list[int]) -> bytes:
        """Return the head of the commands that answer this step."""
        packed: bytes = _packer.pack(step)
        return self._begin + packed + self._end


def decode(message: type[M], payload: bytes, declared: str = "") -> M:
    """Decode and validate a message; `declared` is the encoding that was sent with it.

    Raises:
        BadMessage: the payload is not valid; the text has the path of each invalid value.
    """
    if not encoding_matches(message, declared):
        raise BadMessage(f"expected encoding {encoding(message)!r}, got {declared!r}")
    if not payload:
        raise BadMessage(f"there is no payload; a {message.__name__} expected")
    if len(payload) > MAX_BYTES:
        raise BadMessage(f"{len(payload)} bytes; a {message.__name__} has at most {MAX_BYTES}")
    try:
        fields = _unpacked(payload, MAX_ITEMS.get(message, MAX_ENTRIES))
    except _TooManyEntries as error:
        raise BadMessage(f"a {message.__name__}: {error}") from None
    except Exception as error:  # msgpack raises a dozen unrelated classes on malformed input
        raise BadMessage(replace_controls(f"not msgpack: {type(error).__name__} {error}".rstrip())) from None
    if not isinstance(fields, dict):
        raise BadMessage(f"a {message.__name__} should be a map of its fields, got {type(fields).__name__}")
    try:
        return message.__pydantic_validator__.validate_python(fields)  # type: ignore[no-any-return]
    except ValidationError as error:
        raise BadMessage(replace_controls(f"{message.__name__}: {describe_validation_errors(error)}")) from None


def decode_request(message: type[M], payload: bytes, declared: str = "") -> M:
    """Decode and validate a request as `decode` does; one without a payload has no fields."""
    return decode(message, payload or _NO_FIELDS, declared)


class _TooManyEntries(Exception):
    """A message has too many entries; the text has the limit."""


def _unpacked(payload: bytes, limit: int) -> Any:
    if len(payload) <= limit:  # each entry has at least one byte
        return msgpack.unpackb(payload)
    entries = 0

    def count(container: Any) -> Any:
        nonlocal entries
        entries += len(container)
        if entries > limit:
            raise _TooManyEntries(f"its lists and maps have more than {limit} entries")
        return container

    return msgpack.unpackb(payload, max_array_len=limit, max_map_len=limit, list_hook=count, object_hook=count)


def validated(
    model: type[V], fields: Mapping[str, Any], what: str = "", error: type[ZenostatError] = InvalidConfig
) -> V:
    """Return a pydantic model with these fields; `what` names them in errors.

    Raises:
        ZenostatError: of the class `error`; describes the invalid fields.
    """
    try:
        return model.model_validate(dict(fields))
    except ValidationError as invalid:
        described = describe_validation_errors(invalid, model.model_fields)
        raise error(f"{what}: {described}" if what else described) from None


def describe_validation_errors(error: ValidationError, known: Iterable[str] = ()) -> str:
    """Describe the errors of a pydantic validation in one line: the path, the rule and the value of each.

    Of many errors, only the first ones are described. `known`: names of the top-level fields, of which similar ones
    are suggested for an unknown one; the `model_fields` of a model also have those of nested models. Where a field is
    missing, those that are there are not suggested.
    """
    texts = []
    errors = error.errors(include_url=False)
    for detail in errors[:_MAX_ERRORS]:
        loc = [str(part) for part in detail["loc"] if not str(part).startswith("@")]
        path = _cut(".".join(loc))
        rule = _RULES.get(detail["type"], _MEMBER.sub(r"\1", detail["msg"].removeprefix("Value error, ")))
        if not path:  # a rule on several fields
            is_fields = isinstance(detail["input"], (dict, Message))
            texts.append(rule if is_fields else f"{rule}, got {_short(detail['input'])}")
        elif detail["type"] == "missing":
            texts.append(f"{path}: it is missing")
        elif detail["type"] == "extra_forbidden":
            beside = (each for each in errors if each["type"] == "missing" and each["loc"][:-1] == detail["loc"][:-1])
            present = next((each["input"] for each in beside if isinstance(each["input"], Mapping)), {})
            names = [name for name in _names_beside(loc, known) if name not in present]
            texts.append(f"{path}: there is no such field" + (f"; {did_you_mean(loc[-1], names)}" if names else ""))
        else:
            texts.append(f"{path}: {rule}, got {_short(detail['input'])}")
    more = len(errors) - len(texts)
    return "; ".join(texts) + (f"; and {more} more" if more else "")


def _names_beside(loc: Sequence[str], known: Iterable[str]) -> list[str]:
    """Return the names of the fields of the model in which `loc` is unknown; none if it is one of several models."""
    for part in loc[:-1]:
        if isinstance(known, Mapping) and part in known:  # else an index, or a key of a mapping
            models = _models_in(known[part].annotation)
            known = models[0].model_fields if len(models) == 1 else ()
        elif not isinstance(known, Mapping):
            return []
    return list(known)


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in get_args(annotation) for model in _models_in(argument)]


class _Repr(reprlib.Repr):
    """`repr` of the first part of a value; a nested value with aliases can have a repr too large for memory."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel = 6
        self.maxlist = self.maxtuple = self.maxset = self.maxdict = 20
        self.maxstring = self.maxlong = self.maxother = 400

    def repr_dict(self, x: Any, level: int) -> str:
        """Return the repr of a mapping in its own order, not sorted as in the base class."""
        shown = dict(itertools.islice(x.items(), self.maxdict))
        if level <= 0:
            return "{...}" if shown else "{}"
        return (
            "{" + ", ".join(f"{self.repr1(k, level - 1)}: {self.repr1(v, level - 1)}" for k, v in shown.items()) + "}"
        )


_repr = _Repr()


def _short(value: Any, limit: int = 60) -> str:
    return _cut(_repr.repr(value), limit)


def _cut(text: str, limit: int = 200) -> str:
    return text if len(text) <= limit else text[: limit - 1] + "…"


def floats(raw: bytes, shape: tuple[int, ...], what: str) -> Floats:
    """Return a read-only float64 view of `raw`; `what` names it in errors.

    Raises:
        BadMessage: the size of `raw` is not that of `shape`.
    """
    return _array(raw, FLOAT, shape, what)


def row(raw: bytes, index: int, rows: int, width: int, what: str) -> Floats:
    """Return one row of `floats(raw, (rows, width), what)` as a view."""
    if len(raw) != 8 * rows * width:
        floats(raw, (rows, width), what)
    return np.frombuffer(raw, FLOAT, width, 8 * width * index)


def uint8s(raw: bytes, shape: tuple[int, ...], what: str) -> NDArray[np.uint8]:
    """Return a read-only uint8 view of `raw`; like `floats`."""
    return _array(raw, np.dtype("u1"), shape, what)


def indices(raw: bytes, shape: tuple[int, ...], what: str) -> NDArray[np.uint16]:
    """Return a read-only uint16 view of `raw`; like `floats`."""
    return _array(raw, INDEX, shape, what)


def _array(raw: bytes, kind: np.dtype[Any], shape: tuple[int, ...], what: str) -> NDArray[Any]:
    array = np.frombuffer(raw, kind) if len(raw) % kind.itemsize == 0 else None
    expected = prod(shape)
    if array is None or array.size != expected:
        raise BadMessage(
            f"{what} has {len(raw)} bytes; {expected * kind.itemsize} expected: "
            f"{' x '.join(map(str, shape))} of {kind.name}"
        )
    return array.reshape(shape)
