"""Bodies and values of requests: JSON or forms, with bare infinities; numbers and switches as clients send them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from math import isfinite, isnan
from typing import Any
from urllib.parse import parse_qs

from pydantic_core import from_json

from zenostat.topics.errors import UsageError, did_you_mean

MAX_BYTES = 1_000_000
_FORM = "application/x-www-form-urlencoded"
_SWITCH = {"true": True, "false": False}
_PLUS_INFINITY = re.compile(rb"(:\s*)\+Infinity\b")


class BadRequest(UsageError):
    """A request that is answered with status 400 and this text."""


class PeriodNotOver(UsageError):
    """A request that is valid only at the end of a test period; it is answered with status 500 and this text."""


def parse_body(body: bytes, content_type: str) -> dict[str, Any]:
    """Return the fields of a request body; an empty body has none.

    Raises:
        BadRequest: neither a JSON object nor a form, or too long.
    """
    if len(body) > MAX_BYTES:
        raise BadRequest(f"the body has {len(body)} bytes; at most {MAX_BYTES} are accepted")
    if not body.strip():
        return {}
    try:
        if content_type.partition(";")[0].strip().lower() == _FORM and not body.lstrip().startswith(b"{"):
            fields = parse_qs(body.decode("utf-8"), keep_blank_values=True, max_num_fields=10_000)
            return {name: values[0] if len(values) == 1 else values for name, values in fields.items()}
        parsed = from_json(body if b"+" not in body else _PLUS_INFINITY.sub(rb"\1Infinity", body))
    except ValueError:
        raise BadRequest("the body is neither a JSON object nor a form, in UTF-8") from None
    if not isinstance(parsed, dict):
        raise BadRequest("the body is not a JSON object")
    return parsed


def require(fields: Mapping[str, Any], name: str) -> Any:
    """Return a field's value; `BadRequest` names it if it is missing or null."""
    if fields.get(name) is None:
        raise BadRequest(f"'{name}'")
    return fields[name]


def number(value: Any, name: str) -> float:
    """Return a number, or a text of one, as float; it may be infinite.

    Raises:
        BadRequest: not a number.
    """
    try:
        if isinstance(value, bool | dict | list):
            raise ValueError
        result = float(value)
    except (TypeError, ValueError, OverflowError):
        raise BadRequest(f"Invalid value {_short(value)} for {name}. Value must be a float or integer.") from None
    if isnan(result):
        raise BadRequest(f"Invalid value nan for {name}. Value must be a float or integer.")
    return result


def positive(value: Any, name: str, *, allow_zero: bool = True) -> float:
    """Return a finite number of at least 0, or above 0; `BadRequest` for others."""
    result = number(value, name)
    if not isfinite(result) or result < 0.0 or (result == 0.0 and not allow_zero):
        least = "greater than or equal to 0" if allow_zero else "greater than 0"
        raise BadRequest(f"Invalid value {_short(value)} for {name}. Value must be finite and {least}.")
    return result


def switch(value: Any, name: str) -> bool:
    """Return the position of an `_activate` switch; `BadRequest` for other values than 0, 1, true and false."""
    if isinstance(value, bool):
        return value
    if isinstance(value, int | float) and value in (0, 1):
        return bool(value)
    if isinstance(value, str):
        if value.lower() in _SWITCH:
            return _SWITCH[value.lower()]
        with suppress(ValueError):
            if float(value) in (0.0, 1.0):
                return bool(float(value))
    raise BadRequest(f"Invalid value {_short(value)} for {name}. Value must be a boolean, 0 or 1.")


def names(value: Any, parameter: str) -> list[str]:
    """Return point names from a list, a mapping (its keys) or a single text."""
    if isinstance(value, str):
        return [value]
    if isinstance(value, Sequence | Mapping) and all(isinstance(name, str) for name in value):
        return list(dict.fromkeys(value))
    raise BadRequest(f"Invalid value {_short(value)} for {parameter}. A list of point names is expected.")


def unknown_names(unknown: Sequence[str], parameter: str) -> BadRequest:
    """Return the error for point names that do not exist."""
    listed = [name[:100] for name in unknown[:10]]
    return BadRequest(f"Invalid point name(s) {listed} in parameter {parameter}. Check lists of available points.")


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:80]}..."


def choice(value: Any, name: str, choices: Iterable[str]) -> str:
    """Return a text that is one of the choices; `BadRequest` lists similar ones."""
    if not isinstance(value, str) or value not in choices:
        raise BadRequest(
            f"Invalid value {str(value)[:80]!r} for {name}: {did_you_mean(str(value)[:80], list(choices))}"
        )
    return value


def seed(value: Any) -> int:
    """Return a seed from 0 to 2**32 - 1; `BadRequest` for any other."""
    number = positive(value, "seed")
    if number != int(number) or number >= 2**32:
        raise BadRequest(f"Invalid value {value} for seed. Value must be an integer from 0 to {2**32 - 1}.")
    return int(number)
