"""Controllers: objects with `act(sample)`, to run in their own process or as agents in an environment."""

from zenostat.agent_sdk.controllers.agent import Agent, action_of
from zenostat.agent_sdk.controllers.base import BaselineController, Controller, ControllerProtocol, Values
from zenostat.agent_sdk.controllers.coordinator import DistrictCoordinator
from zenostat.agent_sdk.controllers.fixed import FixedSetpoints
from zenostat.agent_sdk.controllers.incremental import IncrementalRules
from zenostat.agent_sdk.controllers.loader import CONTROLLERS, load_controller
from zenostat.agent_sdk.controllers.oracle import OracleController
from zenostat.agent_sdk.controllers.parameters import make_controller
from zenostat.agent_sdk.controllers.pid import PIDController
from zenostat.agent_sdk.controllers.portable import PortableDemandLimit, PortableSetback
from zenostat.agent_sdk.controllers.random_control import RandomController
from zenostat.agent_sdk.controllers.rule_based import RuleBasedController
from zenostat.agent_sdk.controllers.setback import ScheduledSetback
from zenostat.agent_sdk.controllers.setpoint_offsets import SetpointOffsets

CONTROLLERS |= {
    "baseline": BaselineController,
    "rbc": RuleBasedController,
    "random": RandomController,
    "fixed": FixedSetpoints,
    "setback": ScheduledSetback,
    "offsets": SetpointOffsets,
    "incremental": IncrementalRules,
    "pid": PIDController,
    "oracle": OracleController,
    "coordinator": DistrictCoordinator,
    "portable-setback": PortableSetback,
    "portable-limit": PortableDemandLimit,
}

__all__ = [
    "CONTROLLERS",
    "Agent",
    "BaselineController",
    "Controller",
    "ControllerProtocol",
    "DistrictCoordinator",
    "FixedSetpoints",
    "IncrementalRules",
    "OracleController",
    "PIDController",
    "PortableDemandLimit",
    "PortableSetback",
    "RandomController",
    "RuleBasedController",
    "ScheduledSetback",
    "SetpointOffsets",
    "Values",
    "action_of",
    "load_controller",
    "make_controller",
]
