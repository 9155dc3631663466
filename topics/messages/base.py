"""The base class of all messages, and the types of their fields."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

SCHEMA_VERSION = 2
"""Version of the contract; part of every key's root and of every message's encoding."""

SafeName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.\-]{0,127}$")]
"""A name that can be a chunk of a key: up to 128 letters, digits, `_`, `.` and `-`."""

SourceName = Annotated[str, Field(max_length=128)]
"""Name that the sender of a request or a write gives itself."""

ANONYMOUS = "anonymous"
"""Source of a write that names none."""

# Strict, since any client may send these: a string is not a number, and true is not a step.
Count = Annotated[int, Field(ge=0, strict=True)]

Priority = Annotated[int, Field(ge=1, le=16, strict=True)]

Finite = Annotated[float, Field(strict=True)]

Raw = Annotated[bytes, Field(strict=True)]

Scalar = Annotated[str, Field(strict=True)] | Annotated[bool, Field(strict=True)] | Annotated[int, Field(strict=True)]

Seed = Annotated[int, Field(ge=0, strict=True)]


class Message(BaseModel):
    """Base class of all messages."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, ser_json_inf_nan="null")
