"""Python text that is data: spaces, arrays and tables of choices, read from the syntax tree. Nothing is run.

Only what is listed here is understood; all else is refused with the text that was found.
"""

from __future__ import annotations

import ast
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

from topics.errors import InvalidConfig, UnknownName

_MOST_CHARACTERS = 200_000
_MOST_LEVELS = 100
_ARRAYS = ("np.array", "numpy.array", "array")
_SPACES = tuple(prefix + "{}" for prefix in ("gym.spaces.", "gymnasium.spaces.", "spaces.", ""))


@dataclass(frozen=True, slots=True)
class BoxSpec:
    """A value for each dimension, within its bounds."""

    low: tuple[float, ...]
    high: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class DiscreteSpec:
    """One of `n` choices."""

    n: int


@dataclass(frozen=True, slots=True)
class MultiDiscrete:
    """For each dimension one of so many choices."""

    nvec: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Rows:
    """What each choice means: a value for each dimension."""

    values: tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True)
class Offsets:
    """A choice means its number and what is added in its dimension."""

    added: tuple[tuple[int, float], ...]


Space = BoxSpec | DiscreteSpec | MultiDiscrete
Table = Rows | Offsets


def tree(text: str, what: str) -> ast.Module:
    """The syntax tree of `text`; `InvalidConfig` if it is no Python, or too long or too deep to be data."""
    if len(text) > _MOST_CHARACTERS:
        raise InvalidConfig(f"{what} has {len(text)} characters, at most {_MOST_CHARACTERS} are read")
    try:
        found = ast.parse(text)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise InvalidConfig(f"{what} is no Python: {error}") from None
    level: list[ast.AST] = [found]
    for _ in range(_MOST_LEVELS):
        level = [child for node in level for child in ast.iter_child_nodes(node)]
        if not level:
            return found
    raise InvalidConfig(f"{what} is nested more than {_MOST_LEVELS} levels deep")


def text_of(path: Path) -> str:
    """The text of a file of Python; it is read, not run."""
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UnknownName(f"cannot read {path}: {error}") from None


def space(text: str) -> Space:
    """The space that `text` describes: `Box(low=…, high=…)`, `DiscreteSpec(n)` or `MultiDiscrete([…])`."""
    body = tree(text.strip(), "the text of a space").body
    if len(body) != 1 or not isinstance(body[0], ast.Expr):
        raise _refused(text, "a space: Box(low=…, high=…), Discrete(n) or MultiDiscrete([…])")
    return space_of(body[0].value)


def space_of(node: ast.expr) -> Space:
    """The space of a piece of syntax."""
    if isinstance(node, ast.Call):
        called = ast.unparse(node.func)
        for kind, read in (("Box", _box), ("Discrete", _discrete), ("MultiDiscrete", _multi_discrete)):
            if called in [pattern.format(kind) for pattern in _SPACES]:
                return read(node)
    raise _refused(node, "a space: Box(low=…, high=…), Discrete(n) or MultiDiscrete([…])")


def _box(node: ast.Call) -> BoxSpec:
    said = _arguments(node, ("low", "high", "shape", "dtype"))
    if not {"low", "high"} <= set(said):
        raise _refused(node, "a Box with low= and high=")
    bounds = [literal(said[name]) for name in ("low", "high")]
    lengths = {len(bound) for bound in bounds if isinstance(bound, list)}
    lengths |= {_length(said["shape"])} if "shape" in said else set()
    if len(lengths) != 1:
        raise _refused(node, "a Box whose low, high and shape have one length")
    size = lengths.pop()
    low, high = (_vector(bound if isinstance(bound, list) else [bound] * size, node) for bound in bounds)
    for least, most in zip(low, high, strict=True):
        if not least < most:
            raise _refused(node, f"a Box whose low is below its high, not {least:g} to {most:g}")
    return BoxSpec(low, high)


def _length(node: ast.expr) -> int:
    shape = literal(node)
    if not isinstance(shape, list) or len(shape) != 1 or not _whole(shape[0], 0):
        raise _refused(node, "a shape of one dimension, as (2,)")
    return int(shape[0])


def _discrete(node: ast.Call) -> DiscreteSpec:
    said = _arguments(node, ("n",))
    count: Any = literal(said["n"]) if "n" in said else None
    if not _whole(count, 1):
        raise _refused(node, "Discrete(n) with a whole number of choices")
    return DiscreteSpec(count)


def _multi_discrete(node: ast.Call) -> MultiDiscrete:
    said = _arguments(node, ("nvec", "dtype"))
    counts = literal(said["nvec"]) if "nvec" in said else None
    if not isinstance(counts, list) or not counts or not all(_whole(n, 1) for n in counts):
        raise _refused(node, "MultiDiscrete([…]) with whole numbers of choices")
    return MultiDiscrete(tuple(counts))


def _whole(value: Any, least: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= least


def _arguments(node: ast.Call, names: Sequence[str]) -> dict[str, ast.expr]:
    """The arguments by name; those by position come in the order of `names`."""
    said: dict[str, ast.expr] = dict(zip(names, node.args, strict=False))
    known = len(node.args) <= len(names)
    for keyword in node.keywords:
        known = known and keyword.arg in names and keyword.arg not in said
        said[keyword.arg or "**"] = keyword.value
    if not known or any(isinstance(argument, ast.Starred) for argument in node.args):
        raise _refused(node, f"arguments among {', '.join(names)}, each once")
    if "dtype" in said:
        _type(said["dtype"])
    return said


def _type(node: ast.expr) -> None:
    """A number type is allowed and does not matter: values are read as they stand."""
    name = node.value if isinstance(node, ast.Constant) else ast.unparse(node)
    plain = str(name).removeprefix("np.").removeprefix("numpy.")
    if not plain.startswith(("float", "int", "uint")) or not plain.isalnum():
        raise _refused(node, "a number type, as np.float32")


def literal(node: ast.expr) -> Any:
    """Numbers, texts, lists (also written as tuples or arrays) and mappings of those."""
    if isinstance(node, ast.Constant) and (node.value is None or isinstance(node.value, int | float | str)):
        return node.value
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        number = literal(node.operand)
        if isinstance(number, int | float) and not isinstance(number, bool):
            return -number if isinstance(node.op, ast.USub) else number
    if isinstance(node, ast.List | ast.Tuple):
        return [literal(item) for item in node.elts]
    if isinstance(node, ast.Dict):
        return {_key(key, node): literal(value) for key, value in zip(node.keys, node.values, strict=True)}
    if isinstance(node, ast.Call) and ast.unparse(node.func) in _ARRAYS:
        said = _arguments(node, ("object", "dtype"))
        if "object" in said:
            return literal(said["object"])
    raise _refused(node, "plain numbers, texts and lists")


def _key(node: ast.expr | None, whole: ast.Dict) -> str | int:
    key = literal(node) if node is not None else None
    if not isinstance(key, str | int):
        raise _refused(whole, "a mapping with texts or whole numbers as keys")
    return key


def _vector(values: Any, where: ast.expr) -> tuple[float, ...]:
    plain = isinstance(values, list) and all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
    if not plain or not all(isfinite(v) for v in values):
        raise _refused(where, "finite numbers")
    return tuple(float(v) for v in values)


# The statements that a table's function may have besides the table itself.
_UNWRAPPED = "if isinstance(action, np.ndarray):\n    action = int(action.item())"
_ANSWERS = ("return mapping[action]", "return action.astype(np.float32)", "return action")


def table(function: ast.FunctionDef) -> Table:
    """The choices that a function of one `action` describes: a literal `mapping`, or `action[i] += number`.

    Raises:
        InvalidConfig: it does anything else.
    """
    rows: list[tuple[float, ...]] = []
    added: dict[int, float] = {}
    for statement in function.body:
        text = ast.unparse(statement)
        if isinstance(statement, ast.AugAssign):
            index, number = _offset(statement)
            added[index] = added.get(index, 0.0) + number
        elif isinstance(statement, ast.Assign) and ast.unparse(statement.targets[0]) == "mapping" and not rows:
            rows = _rows(statement.value)
        elif text not in (_UNWRAPPED, *_ANSWERS) and not _is_text(statement):
            raise _refused(statement, f"a table of choices in {function.name}")
    answer = ast.unparse(function.body[-1])
    if answer not in _ANSWERS or (answer == _ANSWERS[0]) != bool(rows) or (rows and added):
        raise InvalidConfig(f"{function.name} returns no table of choices: {_short(answer)}")
    return Rows(tuple(rows)) if rows else Offsets(tuple(sorted(added.items())))


def _offset(statement: ast.AugAssign) -> tuple[int, float]:
    target, number = statement.target, literal(statement.value)
    if (
        isinstance(statement.op, ast.Add)
        and isinstance(target, ast.Subscript)
        and ast.unparse(target.value) == "action"
        and isinstance(number, int | float)
    ):
        index = literal(target.slice)
        if _whole(index, 0):
            return index, float(number)
    raise _refused(statement, "action[i] += number")


def _rows(node: ast.expr) -> list[tuple[float, ...]]:
    mapping = literal(node)
    if not isinstance(mapping, dict) or not mapping or list(mapping) != list(range(len(mapping))):
        raise _refused(node, "a mapping from 0, 1, 2, … to lists of numbers")
    return [_vector(values, node) for values in mapping.values()]


def _is_text(statement: ast.stmt) -> bool:
    """A docstring."""
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)


def _refused(found: ast.AST | str, wanted: str) -> InvalidConfig:
    text = found if isinstance(found, str) else ast.unparse(found)
    return InvalidConfig(f"{wanted} expected, got {_short(text)}")


def _short(text: str, most: int = 100) -> str:
    text = " ".join(text.split())
    return repr(text if len(text) <= most else text[: most - 1] + "…")
