"""Protocol and base class of controllers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import Any, Protocol, runtime_checkable

from numpy.typing import ArrayLike

from zenostat.bridge.client.sample import SampleView
from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Manifest

Values = dict[str, float | None]
"""Values by actuator, in its unit; None relinquishes it; actuators that are not named keep their value."""


class ControllerProtocol(Protocol):
    """Interface that a controller class has to implement; its first argument is the node's manifest."""

    def act(self, sample: SampleView) -> Values:
        """Return the commands for the timestep that begins at `sample.time`."""


class PlanBranch(Protocol):
    """A copy of the running episode, to be stepped."""

    @property
    def sample(self) -> SampleView:
        """The copy's latest sample."""

    def step(self, action: ArrayLike) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Simulate one timestep, as an environment does."""


class Planner(Protocol):
    """Interface of an environment to a planning controller; a `BuildingEnv` has it."""

    action_space: Any

    def plan(self, actions: ArrayLike, *, forecast_error: Sequence[float] = ()) -> Floats:
        """Return the reward of each timestep of several action sequences; see `BuildingEnv.plan`."""

    def branch(self, *, forecast_error: Sequence[float] = ()) -> AbstractContextManager[PlanBranch]:
        """Create a copy that continues from the present sample; see `BuildingEnv.branch`."""


@runtime_checkable
class PlanningController(ControllerProtocol, Protocol):
    """A controller that simulates its plans in branches of the environment that it controls."""

    def attach(self, planner: Planner) -> None:
        """Use this environment for the plans of the samples that follow."""


class Finder(Protocol):
    """A semantic model that can be asked for points; `zenostat.semantic.SemanticGraph` is one."""

    def find(self, pattern: str) -> Sequence[Any]:
        """Return points with `name` and `place`; see `zenostat.semantic.PATTERNS`."""


@runtime_checkable
class PortableController(ControllerProtocol, Protocol):
    """A controller that asks the semantic model of its building for the points that it needs."""

    def use_model(self, model: Finder) -> None:
        """Find the points of the building; called once, before the first sample."""


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
