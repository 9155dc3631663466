"""Reading and writing YAML with the core schema of YAML 1.2.

PyYAML implements YAML 1.1, in which `on` and `no` are booleans, `1e-4` is a string, `12:30` a number in base 60 and
`2018-07-01` a date. With the core schema they are strings and floats as expected. A repeated key is an error.

Files may be untrusted: their size, depth and number of nodes (aliases expanded) are limited before they are loaded.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import yaml
from pydantic import BaseModel

from zenostat.topics.codec import validated
from zenostat.topics.errors import InvalidConfig, UsageError
from zenostat.topics.user_file import user_file

M = TypeVar("M", bound=BaseModel)

_Base: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_MERGE = "tag:yaml.org,2002:merge"
_WORDS = (
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("bool", r"true|True|TRUE|false|False|FALSE", list("tTfF")),
    ("int", r"[-+]?[0-9]+", list("-+0123456789")),
    (
        "float",
        r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        list("-+.0123456789"),
    ),
    ("merge", r"<<", ["<"]),
)


MAX_BYTES = 8 * 1024 * 1024
"""Largest size of a file in bytes."""

MAX_NODES = 200_000
"""Largest number of values, lists and mappings in a file, with all aliases expanded."""

MAX_DEPTH = 64
"""Largest depth of nested lists and mappings."""

_TAGS = {f"tag:yaml.org,2002:{name}" for name in ("null", "bool", "int", "float", "str")}
"""Tags permitted on scalars; lists and mappings may have none."""


class _Loader(_Base):  # type: ignore[misc]
    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012  # as PyYAML declares it

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:  # noqa: FBT001, FBT002
        seen = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise yaml.constructor.ConstructorError(None, None, "a name is expected", key.start_mark)
            if key.tag != _MERGE and key.value in seen:
                raise yaml.constructor.ConstructorError(None, None, f"repeated name {key.value!r}", key.start_mark)
            seen.add(key.value)
        mapping: dict[Any, Any] = super().construct_mapping(node, deep)
        return mapping


class _Dumper(yaml.SafeDumper):
    pass


for _tag, _pattern, _first in _WORDS:
    for _class in (_Loader, _Dumper):
        _class.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(rf"^(?:{_pattern})$"), _first)


def _bool(loader: Any, node: yaml.ScalarNode) -> bool:
    text = str(loader.construct_scalar(node)).casefold()
    if text not in ("true", "false"):
        raise yaml.constructor.ConstructorError(None, None, f"{text!r} is neither true nor false", node.start_mark)
    return text == "true"


_Loader.add_constructor("tag:yaml.org,2002:bool", _bool)
_Loader.add_constructor("tag:yaml.org,2002:int", lambda loader, node: int(loader.construct_scalar(node)))


def _text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    """Represent a string; line breaks that YAML would read as a space are escaped."""
    style = '"' if re.search("[\x85\u2028\u2029]", text) else None
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Dumper.add_representer(str, _text)


class _Limits:
    """Checks the limits on a stream of parser events, without building objects and without recursion."""

    def __init__(self) -> None:
        self._nodes = 0
        self._open: list[tuple[str | None, int]] = []  # anchor, and the number of nodes before it
        self._sizes: dict[str, int] = {}  # number of nodes of each anchor

    def check(self, event: yaml.Event) -> None:
        """Raise `YAMLError` if a limit is exceeded, a tag is not permitted or an alias has no anchor."""
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in self._sizes:
                _fail(f"the alias *{event.anchor} has no anchor before it", event)
            self._count(self._sizes[event.anchor], event)
        elif isinstance(event, yaml.NodeEvent):
            self._node(event)
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before = self._open.pop()
            self._name(anchor, before)

    def _node(self, event: Any) -> None:
        scalar = isinstance(event, yaml.ScalarEvent)
        if event.tag not in (None, "!", *(_TAGS if scalar else ())):
            _fail(f"the tag {event.tag!r} is not supported; remove it", event)
        before = self._nodes
        self._count(1, event)
        if not scalar:
            self._open.append((event.anchor, before))
            if len(self._open) > MAX_DEPTH:
                _fail(f"it is nested more than {MAX_DEPTH} levels deep", event)
        elif "\0" in event.value:
            _fail("a NUL character in a string", event)
        else:
            self._name(event.anchor, before)

    def _count(self, more: int, event: yaml.Event) -> None:
        self._nodes += more
        if self._nodes > MAX_NODES:
            _fail(f"it has more than {MAX_NODES} values, with aliases expanded", event)

    def _name(self, anchor: str | None, before: int) -> None:
        if anchor is not None:
            self._sizes[anchor] = self._nodes - before


_KINDS: dict[type, str] = {list: "a list", dict: "a name that is not a text"}
"""What a file has instead of a mapping with names as keys."""


def _fail(text: str, event: Any) -> NoReturn:
    raise yaml.constructor.ConstructorError(None, None, text, event.start_mark)


def read_text(path: Path) -> str:
    """Return the text of a file.

    Raises:
        OSError: the file does not exist, cannot be read, is not a regular file, or is larger than `MAX_BYTES`.
        UnicodeDecodeError: the file is not UTF-8.
    """
    if "\0" in str(path):
        raise OSError("a NUL character in its name")
    # O_NONBLOCK: opening a FIFO would wait for its other end.
    with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError("it is not a regular file")
        raw = file.read(MAX_BYTES + 1)
    if len(raw) > MAX_BYTES:
        raise OSError(f"it has more than {MAX_BYTES} bytes")
    return raw.decode("utf-8")


def parse(text: str, what: str) -> dict[str, Any]:
    """Parse the YAML text of a file into a mapping.

    Args:
        text: content of the file.
        what: description of the file for errors.

    Raises:
        InvalidConfig: the text is not YAML, is not a mapping with names as keys, or exceeds the limits.
    """
    if len(text) > MAX_BYTES:
        raise InvalidConfig(f"{what} has {len(text)} characters; at most {MAX_BYTES} are read")
    limits = _Limits()
    try:
        for event in yaml.parse(text, _Loader):
            limits.check(event)
        mapping = yaml.load(text, _Loader)  # noqa: S506  # a SafeLoader
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise InvalidConfig(f"{what} is not valid YAML: {_describe(error)}") from None
    if not isinstance(mapping, dict) or not all(isinstance(key, str) for key in mapping):
        content = "it is empty" if mapping is None else f"got {_KINDS.get(type(mapping), 'a single value')}"
        raise InvalidConfig(f"{what}: names with values expected, each as `name: value`; {content}")
    return mapping


def _describe(error: Exception) -> str:
    """Describe an error of PyYAML in one line, without the stream's name."""
    if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
        context = f" {error.context}" if error.context else ""
        mark = error.problem_mark
        return f"line {mark.line + 1}, column {mark.column + 1}: {error.problem}{context}"
    if isinstance(error, yaml.reader.ReaderError):
        return f"position {error.position}: unacceptable character #x{error.character:04x}"
    return str(error)


class Lines(dict[tuple[str | int, ...], int]):
    """The line of each value of a file, from 1, by its path of names and indices: `("plants", "tank")`."""

    def at(self, path: Sequence[str | int]) -> int:
        """Return the line of a value, or of the nearest one around it that the file has."""
        known = tuple(path)
        while known and known not in self:
            known = known[:-1]
        return self.get(known, 1)


def parse_with_lines(text: str, what: str) -> tuple[dict[str, Any], Lines]:
    """Parse the YAML text of a file into a mapping, and the line of each of its values; see `parse`."""
    mapping, lines = parse(text, what), Lines()
    _add_lines(yaml.compose(text, _Loader), (), lines)
    return mapping, lines


def _add_lines(node: Any, path: tuple[str | int, ...], lines: Lines) -> None:
    """Add the lines of the values in a node; those that a merge (`<<`) brings are lines of the merged mapping."""
    if isinstance(node, yaml.SequenceNode):
        for index, item in enumerate(node.value):
            lines.setdefault((*path, index), item.start_mark.line + 1)
            _add_lines(item, (*path, index), lines)
    elif isinstance(node, yaml.MappingNode):
        for key, value in sorted(node.value, key=lambda pair: pair[0].tag == _MERGE):  # what is merged comes last
            if key.tag == _MERGE:
                for merged in value.value if isinstance(value, yaml.SequenceNode) else [value]:
                    _add_lines(merged, path, lines)
            else:
                lines.setdefault((*path, key.value), key.start_mark.line + 1)
                _add_lines(value, (*path, key.value), lines)


def read_mapping(path: Path, error: type[UsageError] = InvalidConfig) -> dict[str, Any]:
    """Read a YAML file that contains a mapping.

    Raises:
        UsageError: the file cannot be read; of the class `error`.
        InvalidConfig: as of `parse`.
    """
    with user_file(path, error, "a YAML file"):
        text = read_text(path)
    return parse(text, str(path))


def read_model(path: Path, model: type[M]) -> M:
    """Read a file into a pydantic model.

    Raises:
        InvalidConfig: the file cannot be read, or is not valid; the text lists all errors.
    """
    with user_file(path):
        path = path.expanduser()
    return validated(model, read_mapping(path), str(path))


def dump(plain: dict[str, Any]) -> str:
    """Return a mapping of built-in types as YAML; `parse` returns an equal mapping."""
    return yaml.dump(plain, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=120, default_flow_style=None)
