"""What a controller is."""

from __future__ import annotations

from abc import ABC, abstractmethod

from agent_sdk.sample import SampleView
from topics.messages import Manifest

Values = dict[str, float | None]
"""Actuator to value in its unit; None releases it; one that is not named stays as it is."""


class Controller(ABC):
    """A controller of one node.

    Args:
        manifest: the node's points.

    Raises:
        InvalidConfig: the node lacks what this controller needs.
    """

    def __init__(self, manifest: Manifest) -> None:
        self.manifest = manifest

    @abstractmethod
    def act(self, sample: SampleView) -> Values:
        """The answer to a sample; it rules the next timestep."""


class BuildingControl(Controller):
    """The building's own control: touches nothing."""

    def act(self, sample: SampleView) -> Values:  # noqa: ARG002
        """Nothing."""
        return {}
