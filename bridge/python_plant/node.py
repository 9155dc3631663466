"""A node whose plant is a Python class: one of the user's, or one that comes with Zenostat."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from pydantic import Field, model_validator

from zenostat.bridge.alarms.rules import point_alarms, read_rules
from zenostat.bridge.faults import read_plan
from zenostat.bridge.node.fault_injection import FaultInjection
from zenostat.bridge.node.node import Node
from zenostat.bridge.node.plant import PlantFactory
from zenostat.bridge.node.server import Observer
from zenostat.bridge.node.settings import NodeSettings
from zenostat.bridge.python_plant.class_plan import plan_class
from zenostat.bridge.python_plant.plant import PythonPlant
from zenostat.bridge.python_plant.shipped import SHIPPED, shipped_plant
from zenostat.topics.codec import validated
from zenostat.topics.errors import InvalidConfig, did_you_mean
from zenostat.topics.scenario_fields import NODE_ARGUMENTS

_NULLABLE = ("deadline_s", "environment_reward")


class PlantSettings(NodeSettings):
    """The settings of a node whose plant is a Python class.

    Attributes:
        plant: `FILE.py:CLASS` or `MODULE:CLASS`.
        fmu: an FMU, in place of a class.
        grid: the file of an electric grid, or `pandapower:NAME`, in place of a class.
        plant_arguments: arguments of the class.
    """

    name: str = "plant"
    plant: str = ""
    fmu: str | None = None
    grid: str | None = None
    plant_arguments: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check_plant(self) -> PlantSettings:
        sources = [name for name in ("plant", *SHIPPED) if getattr(self, name)]
        if len(sources) != 1:
            several = f"{' and '.join(sources)} define the plant; use only one of them"
            raise ValueError(
                several if sources else "needs a plant: plant='FILE.py:CLASS', fmu='FILE.fmu' or grid='FILE'"
            )
        return self

    @property
    def plant_class(self) -> tuple[str, dict[str, Any]]:
        """The class, and its arguments."""
        for option in SHIPPED:
            if source := getattr(self, option):
                return shipped_plant(option, source, self.plant_arguments)
        return self.plant, self.plant_arguments


def read_settings(settings: Mapping[str, Any]) -> PlantSettings:
    """Validate settings; those that are None count as left out.

    Raises:
        InvalidConfig: lists all errors.
    """
    set_fields = {name: value for name, value in settings.items() if value is not None or name in _NULLABLE}
    known = list(PlantSettings.model_fields)
    if unknown := [name for name in set_fields if name not in known]:
        raise InvalidConfig("\n".join(_unknown_setting(name, known) for name in unknown))
    return validated(PlantSettings, set_fields)


def _unknown_setting(name: str, known: Sequence[str]) -> str:
    of_building = name in NODE_ARGUMENTS
    hint = "its class defines points, time and reward" if of_building else did_you_mean(name, known)
    return f"a plant of your own has no setting {name!r}; {hint}"


def plant_node(settings: PlantSettings, observer: Observer | None = None, *, program: bool = False) -> Node:
    """Return a node that is not started yet; see `zenostat.bridge.node.node.Node` for the arguments.

    Raises (on entering the node):
        UsageError, SimulatorError, BusError: see `zenostat.topics.errors`; everything that was started is closed.
    """

    def prepare() -> PlantFactory:
        plan = plan_class(*settings.plant_class, settings.unresponsive_s)
        if settings.faults is not None:  # so that its errors are reported before anything starts
            FaultInjection(read_plan(settings.faults), plan.description, settings.slots)
        if settings.alarms is not None:
            point_alarms(read_rules(settings.alarms), plan.description)
        return partial(PythonPlant, plan)

    return Node(settings, prepare, observer, program=program)
