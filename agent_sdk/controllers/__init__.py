"""Controllers: objects with `act(sample)`, for processes of their own and for environments alike."""

from agent_sdk.controllers.agent import Agent, action_of
from agent_sdk.controllers.base import Acts, BuildingControl, Controller, Values
from agent_sdk.controllers.fixed import FixedSetpoints
from agent_sdk.controllers.incremental import IncrementalRules
from agent_sdk.controllers.loader import CONTROLLERS, load_controller
from agent_sdk.controllers.parameters import create
from agent_sdk.controllers.pid import PidControl
from agent_sdk.controllers.random_control import RandomControl
from agent_sdk.controllers.rule_based import ComfortBandRules
from agent_sdk.controllers.setback import ScheduledSetback

__all__ = [
    "CONTROLLERS",
    "Acts",
    "Agent",
    "BuildingControl",
    "ComfortBandRules",
    "Controller",
    "FixedSetpoints",
    "IncrementalRules",
    "PidControl",
    "RandomControl",
    "ScheduledSetback",
    "Values",
    "action_of",
    "create",
    "load_controller",
]
