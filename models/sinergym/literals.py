"""Read Python source that is data (spaces, arrays and tables of choices) from its syntax tree, without running it.

Only the forms listed here are accepted; an error for anything else quotes the source. Plain literals are read by
`ast.literal_eval`.
"""

from __future__ import annotations

import ast
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

from zenostat.topics.errors import InvalidConfig, UnknownName
from zenostat.topics.user_file import user_file

_MAX_CHARACTERS = 200_000
_MAX_LEVELS = 100
_ARRAYS = ("np.array", "numpy.array", "array")
_SPACES = tuple(prefix + "{}" for prefix in ("gym.spaces.", "gymnasium.spaces.", "spaces.", ""))


@dataclass(frozen=True, slots=True)
class BoxSpec:
    """Gymnasium's `Box`: a value for each dimension, within bounds."""

    low: tuple[float, ...]
    high: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class DiscreteSpec:
    """Gymnasium's `Discrete`: one of `n` choices."""

    n: int


@dataclass(frozen=True, slots=True)
class MultiDiscrete:
    """Gymnasium's `MultiDiscrete`: one of `nvec[i]` choices for dimension i."""

    nvec: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Rows:
    """The meaning of each choice: a value for each dimension."""

    values: tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True)
class Offsets:
    """The meaning of each choice: its number plus an offset; `offsets` has (dimension, offset)."""

    offsets: tuple[tuple[int, float], ...]


Space = BoxSpec | DiscreteSpec | MultiDiscrete
Table = Rows | Offsets


def parse(text: str, what: str) -> ast.Module:
    """Parse `text`; `InvalidConfig` if it is not Python, or too long or too deeply nested to be data."""
    if len(text) > _MAX_CHARACTERS:
        raise InvalidConfig(f"{what} has {len(text)} characters, at most {_MAX_CHARACTERS} are allowed")
    try:
        module = ast.parse(text)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise InvalidConfig(f"{what} is not Python: {error}") from None
    level: list[ast.AST] = [module]
    for _ in range(_MAX_LEVELS):
        level = [child for node in level for child in ast.iter_child_nodes(node)]
        if not level:
            return module
    raise InvalidConfig(f"{what} is nested more than {_MAX_LEVELS} levels deep")


def text_of(path: Path) -> str:
    """Read a Python source file as text."""
    with user_file(path, UnknownName):
        return path.read_text(encoding="utf-8")


def read_space(text: str) -> Space:
    """Read a space: `Box(low=…, high=…)`, `Discrete(n)` or `MultiDiscrete([…])`."""
    body = parse(text.strip(), "the text of a space").body
    if len(body) != 1 or not isinstance(body[0], ast.Expr):
        raise _unexpected(text, "a space: Box(low=…, high=…), Discrete(n) or MultiDiscrete([…])")
    return read_space_node(body[0].value)


def read_space_node(node: ast.expr) -> Space:
    """Read a space from a syntax node."""
    if isinstance(node, ast.Call):
        constructor = ast.unparse(node.func)
        for kind, read in (("Box", _box), ("Discrete", _discrete), ("MultiDiscrete", _multi_discrete)):
            if constructor in [pattern.format(kind) for pattern in _SPACES]:
                return read(node)
    raise _unexpected(node, "a space: Box(low=…, high=…), Discrete(n) or MultiDiscrete([…])")


def _box(node: ast.Call) -> BoxSpec:
    arguments = _arguments(node, ("low", "high", "shape", "dtype"))
    if not {"low", "high"} <= set(arguments):
        raise _unexpected(node, "a Box with low= and high=")
    bounds = [read_literal(arguments[name]) for name in ("low", "high")]
    lengths = {len(bound) for bound in bounds if isinstance(bound, list)}
    lengths |= {_length(arguments["shape"])} if "shape" in arguments else set()
    if len(lengths) != 1:
        raise _unexpected(node, "a Box whose low, high and shape have one length")
    size = lengths.pop()
    low, high = (_vector(bound if isinstance(bound, list) else [bound] * size, node) for bound in bounds)
    for lower, upper in zip(low, high, strict=True):
        if not lower < upper:
            raise _unexpected(node, f"a Box whose low is below its high, not {lower:g} to {upper:g}")
    return BoxSpec(low, high)


def _length(node: ast.expr) -> int:
    shape = read_literal(node)
    if not isinstance(shape, list) or len(shape) != 1 or not _is_count(shape[0], 0):
        raise _unexpected(node, "a shape of one dimension, as (2,)")
    return int(shape[0])


def _discrete(node: ast.Call) -> DiscreteSpec:
    arguments = _arguments(node, ("n",))
    count: Any = read_literal(arguments["n"]) if "n" in arguments else None
    if not _is_count(count, 1):
        raise _unexpected(node, "Discrete(n) with an integer number of choices")
    return DiscreteSpec(count)


def _multi_discrete(node: ast.Call) -> MultiDiscrete:
    arguments = _arguments(node, ("nvec", "dtype"))
    counts = read_literal(arguments["nvec"]) if "nvec" in arguments else None
    if not isinstance(counts, list) or not counts or not all(_is_count(n, 1) for n in counts):
        raise _unexpected(node, "MultiDiscrete([…]) with integer numbers of choices")
    return MultiDiscrete(tuple(counts))


def _is_count(value: Any, minimum: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= minimum


def _arguments(node: ast.Call, names: Sequence[str]) -> dict[str, ast.expr]:
    """Return the arguments by name; positional arguments are in the order of `names`."""
    arguments: dict[str, ast.expr] = dict(zip(names, node.args, strict=False))
    is_valid = len(node.args) <= len(names)
    for keyword in node.keywords:
        is_valid = is_valid and keyword.arg in names and keyword.arg not in arguments
        arguments[keyword.arg or "**"] = keyword.value
    if not is_valid or any(isinstance(argument, ast.Starred) for argument in node.args):
        raise _unexpected(node, f"arguments among {', '.join(names)}, each once")
    if "dtype" in arguments:
        _type(arguments["dtype"])
    return arguments


def _type(node: ast.expr) -> None:
    """Check that a dtype is a number type; it has no effect, since values are read as written."""
    name = node.value if isinstance(node, ast.Constant) else ast.unparse(node)
    plain = str(name).removeprefix("np.").removeprefix("numpy.")
    if not plain.startswith(("float", "int", "uint")) or not plain.isalnum():
        raise _unexpected(node, "a number type, as np.float32")


def read_literal(node: ast.expr) -> Any:
    """Return numbers, strings, None, lists (also written as tuples or arrays), or mappings of those."""
    try:
        value = ast.literal_eval(_ArrayUnwrapper().visit(deepcopy(node)))
    except (ValueError, TypeError):
        raise _unexpected(node, "plain numbers, strings and lists") from None
    return _plain(value, node)


class _ArrayUnwrapper(ast.NodeTransformer):
    """Replaces `np.array(values, dtype=…)` with `values`."""

    def visit_Call(self, node: ast.Call) -> ast.AST:
        """Unwrap an array; leave other calls, which are no literals."""
        arguments = _arguments(node, ("object", "dtype")) if ast.unparse(node.func) in _ARRAYS else {}
        return self.visit(arguments["object"]) if "object" in arguments else node


def _plain(value: Any, node: ast.expr) -> Any:
    """Convert tuples to lists; sets, bytes and complex numbers are errors."""
    if value is None or isinstance(value, int | float | str):
        return value
    if isinstance(value, list | tuple):
        return [_plain(item, node) for item in value]
    if not isinstance(value, dict):
        raise _unexpected(node, "plain numbers, strings and lists")
    if not all(isinstance(key, str | int) for key in value):
        raise _unexpected(node, "a mapping with strings or integers as keys")
    return {key: _plain(item, node) for key, item in value.items()}


def _vector(values: Any, node: ast.expr) -> tuple[float, ...]:
    numeric = isinstance(values, list) and all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
    if not numeric or not all(isfinite(v) for v in values):
        raise _unexpected(node, "finite numbers")
    return tuple(float(v) for v in values)


# The statements that a table's function may have in addition to the table itself.
_UNWRAP = "if isinstance(action, np.ndarray):\n    action = int(action.item())"
_RETURNS = ("return mapping[action]", "return action.astype(np.float32)", "return action")


def read_table(function: ast.FunctionDef) -> Table:
    """Read the choices that a function of one `action` describes: a literal `mapping`, or `action[i] += number`.

    Raises:
        InvalidConfig: the function does anything else.
    """
    rows: list[tuple[float, ...]] = []
    offsets: dict[int, float] = {}
    for statement in function.body:
        text = ast.unparse(statement)
        if isinstance(statement, ast.AugAssign):
            index, number = _offset(statement)
            offsets[index] = offsets.get(index, 0.0) + number
        elif isinstance(statement, ast.Assign) and ast.unparse(statement.targets[0]) == "mapping" and not rows:
            rows = _rows(statement.value)
        elif text not in (_UNWRAP, *_RETURNS) and not _is_text(statement):
            raise _unexpected(statement, f"a table of choices in {function.name}")
    returned = ast.unparse(function.body[-1])
    if returned not in _RETURNS or (returned == _RETURNS[0]) != bool(rows) or (rows and offsets):
        raise InvalidConfig(f"{function.name} returns no table of choices: {_short(returned)}")
    return Rows(tuple(rows)) if rows else Offsets(tuple(sorted(offsets.items())))


def _offset(statement: ast.AugAssign) -> tuple[int, float]:
    target, number = statement.target, read_literal(statement.value)
    if (
        isinstance(statement.op, ast.Add)
        and isinstance(target, ast.Subscript)
        and ast.unparse(target.value) == "action"
        and isinstance(number, int | float)
    ):
        index = read_literal(target.slice)
        if _is_count(index, 0):
            return index, float(number)
    raise _unexpected(statement, "action[i] += number")


def _rows(node: ast.expr) -> list[tuple[float, ...]]:
    mapping = read_literal(node)
    if not isinstance(mapping, dict) or not mapping or list(mapping) != list(range(len(mapping))):
        raise _unexpected(node, "a mapping from 0, 1, 2, … to lists of numbers")
    return [_vector(values, node) for values in mapping.values()]


def _is_text(statement: ast.stmt) -> bool:
    """Whether the statement is a docstring."""
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)


def _unexpected(source: ast.AST | str, expected: str) -> InvalidConfig:
    text = source if isinstance(source, str) else ast.unparse(source)
    return InvalidConfig(f"expected {expected}, got {_short(text)}")


def _short(text: str, limit: int = 100) -> str:
    text = " ".join(text.split())
    return repr(text if len(text) <= limit else text[: limit - 1] + "…")
