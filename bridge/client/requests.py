"""Base of the classes of which `Bus` consists: one request, one reply."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, TypeVar

from pydantic import ValidationError

from zenostat.topics import codec, keys
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Manifest, Message

M = TypeVar("M", bound=Message)


class Requests:
    """Sends requests to the nodes of a bus."""

    @abstractmethod
    def manifest(self, node: str) -> Manifest:
        """Return a node's manifest; `NodeNotFound` if it is not on the bus."""

    @abstractmethod
    def _ask(self, topic: keys.Topic, node: str, request: Message | None, reply_type: type[M], *, name: str = "") -> M:
        """Send a request and return its reply."""


def build(message_type: type[M], **fields: Any) -> M:
    """Build a message; `InvalidConfig` lists all invalid fields."""
    try:
        return message_type(**fields)
    except ValidationError as error:
        raise InvalidConfig(codec.describe_validation_errors(error, message_type.model_fields)) from None
