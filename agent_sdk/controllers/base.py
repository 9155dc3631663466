"""Protocol and base class of controllers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Protocol

from agent_sdk.bus.sample import SampleView
from topics.messages import Manifest

Values = dict[str, float | None]
"""Values by actuator, in its unit; None relinquishes it; actuators that are not named keep their value."""


class ControllerProtocol(Protocol):
    """Interface that a controller class has to implement; its first argument is the node's manifest."""

    def act(self, sample: SampleView) -> Values:
        """Return the commands for the timestep that begins at `sample.time`."""


class Controller(ABC):
    """Base class of controllers of one node.

    Args:
        manifest: the node's points and task.

    Raises:
        InvalidConfig: the node lacks points or actions that the controller needs.
    """

    def __init__(self, manifest: Manifest) -> None:
        self.manifest = manifest

    def begin(self, sample: SampleView) -> None:  # noqa: B027  # most controllers have no state
        """Reset the state: an episode starts at `sample`, or the controller joins it there."""

    @abstractmethod
    def act(self, sample: SampleView) -> Values:
        """Return the commands for the timestep that begins at `sample.time`."""


class BaselineController(Controller):
    """Controller that commands nothing, so that baseline control stays in effect."""

    def act(self, sample: SampleView) -> Values:  # noqa: ARG002
        """Return no commands."""
        return {}
