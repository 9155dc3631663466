"""What a controller is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Protocol

from agent_sdk.bus.sample import SampleView
from topics.messages import Manifest

Values = dict[str, float | None]
"""Actuator to value in its unit; None releases it; one that is not named stays as it is."""


class ControllerProtocol(Protocol):
    """All that a class of anybody's needs to be a controller; it is made with the node's manifest."""

    def act(self, sample: SampleView) -> Values:
        """The answer to a sample; it rules the next timestep."""


class Controller(ABC):
    """A controller of one node.

    Args:
        manifest: the node's points and task.

    Raises:
        InvalidConfig: the node lacks what this controller needs.
    """

    def __init__(self, manifest: Manifest) -> None:
        self.manifest = manifest

    def begin(self, sample: SampleView) -> None:  # noqa: B027  # most controllers remember nothing
        """An episode begins at `sample`, or this controller joins it there: what was remembered is forgotten."""

    @abstractmethod
    def act(self, sample: SampleView) -> Values:
        """The answer to a sample; it rules the next timestep."""


class BaselineController(Controller):
    """The building's own control: touches nothing."""

    def act(self, sample: SampleView) -> Values:  # noqa: ARG002
        """Nothing."""
        return {}
