"""The base of all tools: arguments as fields, a description for the model, and what the tool does."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field

from zenostat.views.mcp.content import Content
from zenostat.views.mcp.desk import Desk

Node = Annotated[str, Field(min_length=1, max_length=128, description="Name of the node, as list_nodes has it.")]
Point = Annotated[str, Field(min_length=1, max_length=128)]
Start = Annotated[
    str | None, Field(max_length=32, description="Simulated time of the first sample, such as 07-03T06:00.")
]
End = Annotated[str | None, Field(max_length=32, description="Simulated time of the last sample.")]
Hours = Annotated[float, Field(gt=0, le=7 * 24, description="Simulated hours to look ahead, at most 168.")]


class Tool(BaseModel):
    """A tool with its arguments; its docstring is the description that a model reads.

    Attributes:
        name: the tool's name.
        writes: whether it changes a building.
    """

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    name: ClassVar[str]
    writes: ClassVar[bool] = False

    def run(self, desk: Desk) -> Content:
        """Do it; `ZenostatError` if that is not possible."""
        raise NotImplementedError

    @classmethod
    def description(cls) -> str:
        """Return the description for the model, in one line."""
        return " ".join((cls.__doc__ or "").split())

    @classmethod
    def input_schema(cls) -> dict[str, Any]:
        """Return the JSON schema of the arguments."""
        schema = cls.model_json_schema()
        schema.pop("description", None)
        return schema
