"""What all kinds of reward have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, SerializerFunctionWrapHandler, model_serializer

from agent_sdk.rewards.base import BoundReward
from topics.messages import Manifest


def _one_or_more(value: Any) -> Any:
    return (value,) if isinstance(value, str) else value


Names = Annotated[tuple[str, ...], BeforeValidator(_one_or_more, json_schema_input_type=str | list[str])]
"""Names of sensors or meters; a single one may stand alone."""


class RewardConfig(BaseModel, ABC):
    """A reward that a scenario can name: frozen, checked, written out as `read_reward` reads it."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    kind: str

    @abstractmethod
    def bind(self, manifest: Manifest) -> BoundReward:
        """See `Reward.bind`."""

    @model_serializer(mode="wrap")
    def _with_its_kind(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {"kind": self.kind, **dump(self)}
