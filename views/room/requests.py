"""Bodies of requests from pages: their common form and types, and reading them."""

from __future__ import annotations

from typing import Annotated, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from zenostat.topics import codec
from zenostat.topics.errors import InvalidConfig

T = TypeVar("T", bound=BaseModel)

NodeName = Annotated[str, Field(max_length=128)]
Speed = Annotated[float, Field(gt=0, le=1e9)]


class RoomRequest(BaseModel):
    """A request: no further fields, no conversion of types, and finite numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


def read_body(kind: type[T], body: bytes) -> T:
    """Return a checked request; `InvalidConfig` lists what is wrong with it."""
    try:
        return kind.model_validate_json(body or b"{}")
    except ValidationError as error:
        raise InvalidConfig(codec.describe_validation_errors(error, kind.model_fields)) from None
