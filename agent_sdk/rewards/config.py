"""Base class of the rewards that a scenario can name."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, SerializerFunctionWrapHandler, model_serializer

from zenostat.agent_sdk.rewards.base import BoundReward
from zenostat.topics.file_fields import as_tuple
from zenostat.topics.messages import Manifest

Names = Annotated[tuple[str, ...], BeforeValidator(as_tuple, json_schema_input_type=str | list[str])]
"""Names of sensors or meters; a single name is also accepted."""


class RewardConfig(BaseModel, ABC):
    """A frozen, validated reward that a scenario can name; its data is what `read_reward` accepts."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    kind: str

    @abstractmethod
    def bind(self, manifest: Manifest) -> BoundReward:
        """Bind the reward to a node's points.

        Raises:
            InvalidConfig: the node does not have a point that the reward needs.
        """

    @model_serializer(mode="wrap")
    def _serialize_with_kind(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {"kind": self.kind, **dump(self)}
