"""For tests: a fake building, and conformance checks for controllers, rewards and environments of one's own."""

from agent_sdk.testing.building import FakeBuilding
from agent_sdk.testing.controllers import check_controller
from agent_sdk.testing.environment import FakeEnv
from agent_sdk.testing.environments import check_environment
from agent_sdk.testing.link import FakeLink
from agent_sdk.testing.outdoors import Climate
from agent_sdk.testing.report import ConformanceError, Report, Result
from agent_sdk.testing.rewards import check_reward
from agent_sdk.testing.thermal import Flow, Rooms, Zone

__all__ = [
    "Climate",
    "ConformanceError",
    "FakeBuilding",
    "FakeEnv",
    "FakeLink",
    "Flow",
    "Report",
    "Result",
    "Rooms",
    "Zone",
    "check_controller",
    "check_environment",
    "check_reward",
]
