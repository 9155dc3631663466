"""The base class of all messages, and the types of their fields."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
)
from pydantic_core import CoreSchema
from pydantic_core.core_schema import no_info_after_validator_function

from zenostat.topics.printable import replace_controls, replace_controls_in_lines
from zenostat.topics.seed_validation import MAX_SEED

SCHEMA_VERSION = 3
"""Version of the contract; part of every key's root and of every message's encoding."""

SafeName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.\-]{0,127}$")]
"""A name that can be a chunk of a key: up to 128 letters, digits, `_`, `.` and `-`."""

SourceName = Annotated[str, Field(pattern=r"^([A-Za-z0-9_][A-Za-z0-9_.\-]{0,127})?$")]
"""Name of the sender of a request or a write, as in its key; empty: the node takes the one in the key."""

Lines = Annotated[str, AfterValidator(replace_controls_in_lines)]
"""A text that may have several lines. All other texts of messages have one."""

ANONYMOUS = "anonymous"
"""Source of a write that names none."""

# Strict, since any client may send these: a string is not a number, and true is not a step.
Count = Annotated[int, Field(ge=0, strict=True)]

Priority = Annotated[int, Field(ge=1, le=16, strict=True)]

Finite = Annotated[float, Field(strict=True)]

Raw = Annotated[bytes, Field(strict=True)]

Scalar = Annotated[str, Field(strict=True)] | Annotated[bool, Field(strict=True)] | Annotated[int, Field(strict=True)]

Seed = Annotated[int, Field(ge=0, lt=MAX_SEED + 1, strict=True)]


def _one_error(seeds: Any, validate: ValidatorFunctionWrapHandler) -> Any:
    """Validate seeds with one error, in place of one for each of their types, which names classes."""
    try:
        return validate(seeds)
    except ValidationError:
        raise ValueError("an integer from 0 to 2**64 - 1 expected, or a list with one or None for each slot") from None


Seeds = Annotated[Seed | list[Seed | None] | None, WrapValidator(_one_error)]
"""A seed for all slots of a request, or a list with one or None for each; None draws them."""

_REPLACING = (replace_controls, replace_controls_in_lines)
_NO_SCHEMAS = ("metadata", "serialization", "config", "default", "expected", "members")


def _printable(schema: Any) -> Any:
    """Return a copy of a part of a core schema in which control characters of its texts are replaced.

    Texts and truth values are strict: bytes are no text, and "off" is not false.
    """
    if isinstance(schema, list | tuple):
        return type(schema)(map(_printable, schema))
    if not isinstance(schema, dict):
        return schema
    kind = schema.get("type")
    if not isinstance(kind, str):  # a mapping of fields
        return {name: _printable(value) for name, value in schema.items()}
    if kind == "function-after" and schema["function"].get("function") in _REPLACING:
        return schema
    if kind in ("str", "bool"):
        schema = {"strict": True, **schema}
    if kind == "str" and "pattern" not in schema:  # no pattern of a message allows a control character
        return no_info_after_validator_function(replace_controls, schema)
    return {name: value if name in _NO_SCHEMAS else _printable(value) for name, value in schema.items()}


class Message(BaseModel):
    """Base class of all messages.

    A message comes from anybody, and its texts reach terminals, logs, reports and pictures. So in each of its texts,
    control characters are replaced when it is validated (`zenostat.topics.printable`); data of any type stays as it is.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, ser_json_inf_nan="null")

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the class's schema, in which each text is validated with `replace_controls`."""
        schema: CoreSchema = _printable(handler(source))
        return schema
