"""The base class of all messages, and the types of their fields."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

SCHEMA_VERSION = 2
"""Version of the contract; part of every key's root and of every message's encoding."""

SafeName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.\-]{0,127}$")]
"""A name that may stand as a chunk of a key: letters, digits, `_`, `.`, `-`; at most 128."""

SourceName = Annotated[str, Field(max_length=128)]
"""Who asks or writes, in its own words."""

ANONYMOUS = "anonymous"
"""Source of a write that names none."""

# Strict where strangers write: a text is no number, and true is no step.
Count = Annotated[int, Field(ge=0, strict=True)]

Priority = Annotated[int, Field(ge=1, le=16, strict=True)]

Finite = Annotated[float, Field(strict=True)]

Raw = Annotated[bytes, Field(strict=True)]

Scalar = Annotated[str, Field(strict=True)] | Annotated[bool, Field(strict=True)] | Annotated[int, Field(strict=True)]

Seed = Annotated[int, Field(ge=0, strict=True)]


class Message(BaseModel):
    """Base of everything that travels."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, ser_json_inf_nan="null")
